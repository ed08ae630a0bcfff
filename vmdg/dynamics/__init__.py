"""Motion in time: schemes, their steps, and a run."""
