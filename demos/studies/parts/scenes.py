"""The examples, whose scenes studies take: scripts in the folder above that of the studies."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2]))

import fibre_cell
import fibre_matrix
import pushout
import tutorial_law

__all__ = [
    "fibre_cell",
    "fibre_matrix",
    "pushout",
    "tutorial_law",
]
