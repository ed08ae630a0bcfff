"""The examples, whose scenes studies take: scripts in the folder above that of the studies."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2]))

import fibre_cell
import fibre_matrix
import measured_beam
import measured_images
import polycrystal
import pushout
import tearing
import tutorial_law

__all__ = [
    "fibre_cell",
    "fibre_matrix",
    "measured_beam",
    "measured_images",
    "polycrystal",
    "pushout",
    "tearing",
    "tutorial_law",
]
