"""Checks of a problem before a run: supports, standing without bonds, process zones, numbers."""
