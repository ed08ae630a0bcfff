"""The state of a run on disk, to continue after a crash on any number of ranks."""
