"""The state of a run on disk, to go on from after a crash, on any number of ranks."""
