"""The examples, whose scenes studies take: scripts in the folder above that of the studies."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2]))

import fibre_cell as fibre_cell
import fibre_matrix as fibre_matrix
import pushout as pushout
import tutorial_law as tutorial_law
