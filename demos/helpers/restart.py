"""Checkpoints of the long demos: their options of the solver, and where a run starts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import vmdg


def files(folder: Path, every: int) -> dict[str, Any]:
    """Options of a run that writes a checkpoint every so many steps, none where that is 0."""
    return {"checkpoint": folder, "checkpoint_every": every} if every else {}


def resumed(problem: vmdg.Problem, resume: bool, *folders: Path) -> vmdg.History | None:
    """Go on from the checkpoint in the first folder.

    Args:
        problem: The problem.
        resume: Without it all checkpoints of a former run are removed.
        folders: Of checkpoints; those of later stages last, which are removed first.

    Returns:
        The table of the run; None where it starts anew.
    """
    if not resume:
        for folder in reversed(folders):
            vmdg.discard_checkpoint(problem.comm, folder)
    return vmdg.read_checkpoint(problem, folders[0])
