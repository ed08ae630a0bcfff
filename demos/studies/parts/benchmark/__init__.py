"""Run time against error, and beside plain elements and other codes."""
