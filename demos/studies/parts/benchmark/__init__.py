"""Run time against error, plain elements and other codes."""
