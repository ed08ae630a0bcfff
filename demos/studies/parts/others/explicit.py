"""Steps of central differences by vmdg and by Akantu, one after the other."""

from __future__ import annotations

import os
import subprocess
from itertools import product
from pathlib import Path

from parts.benchmark.explicit import LAWS, measure

HEAD = ("hexahedra", "kinematics", "interface", "vmdg [us a cell]", "Akantu [us a cell]", "ratio")


def rows(n: int, place: Path, steps: int = 30, repeats: int = 3) -> list[tuple]:
    """Of the table below ``HEAD``, for two cubes of ``n`` cells an edge.

    Args:
        n: Cells along an edge.
        place: The Python of the other codes.
        steps: Steps between two rows of vmdg.
        repeats: Rows, of which the fastest counts.
    """
    found = []
    for finite, law in product((False, True), ("none", "softening")):
        kinematics = "finite" if finite else "small"
        ours = measure("hexahedron", n, kinematics, law, steps, repeats)
        flags = [str(int(x)) for x in (finite, LAWS[law] is not None)]
        script = Path(__file__).with_name("run_akantu_explicit.py")
        done = subprocess.run(
            [str(place), str(script), str(n), *flags],
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            check=True,
        )
        theirs = float(done.stdout.split()[-1])
        each = [1e6 * seconds / ours.cells for seconds in (ours.seconds, theirs)]
        told = (f"{value:.2f}" for value in (*each, each[1] / each[0]))
        found.append((ours.cells, kinematics, law, *told))
    return found
