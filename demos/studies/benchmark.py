"""Seconds and work of vmdg against plain finite elements.

Parts, one or both by name: "precision" draws error against unknowns and processor time, "ratio"
compares one Newton iteration. Seconds are processor time of warm runs on one core, the least of
some; whatever is compared takes turns in one process. On one rank, but "ratio", which on several
tells the times of the slowest.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpi4py import MPI

from matplotlib.figure import Figure
from parts.benchmark import iterations, precision
from parts.benchmark.common import DIMENSION
from parts.options import run
from parts.tables import markdown, progress, report

#: What was found, its table, and what draws it.
Outcome = tuple[Any, str, Callable[[], Figure] | None]


def precision_part(coarse: bool, repeats: int) -> Outcome:
    """Errors, seconds and work of three methods on all cells, degrees and meshes."""
    levels = precision.COARSE if coarse else precision.LEVELS
    cases = [(c, k, n) for c, d in DIMENSION.items() for k in (1, 2) for n in levels[d, k]]
    points = []
    for case in progress(cases, "mesh"):
        points += precision.measure(*case, repeats)
    text = markdown(precision.HEAD, precision.rows(points))
    return points, text, lambda: precision.plot(points)


def ratio_part(coarse: bool, repeats: int) -> Outcome:
    """Newton iterations, direct and with multigrid in 3D, there on a mesh twice as fine too."""
    size = 0.2 if coarse else 1.0
    cases = [("2D", damage, True, size) for damage in (False, True)]
    cases += [("3D", damage, direct, size) for direct in (True, False) for damage in (False, True)]
    cases += [("3D", damage, False, 2 * size) for damage in (False, True)]
    shown = MPI.COMM_WORLD.rank == 0
    rows = [iterations.with_plain(*c[:3], repeats, c[3]) for c in progress(cases, "case", shown)]
    head = (*iterations.HEAD, *rows[0].more)
    return rows, markdown(head, [cost.row() for cost in rows]), None


PARTS: dict[str, Callable[[bool, int], Outcome]] = {
    "precision": precision_part,
    "ratio": ratio_part,
}


def main(
    parts: list[str] | None = None,
    coarse: bool = False,
    repeats: int = 3,
    out: str = "results/benchmark",
    plot: bool = True,
) -> dict[str, Any]:
    """Run parts; what each has found by name.

    Args:
        parts: precision, ratio; both without any.
        coarse: Small meshes.
        repeats: Runs, of which the fastest counts.
        out: Folder for tables and pictures.
        plot: Draw the pictures.

    Raises:
        ValueError: a part that does not exist.
    """
    if unknown := set(parts or ()) - set(PARTS):
        raise ValueError(f"no part is called {', '.join(unknown)}; they are {', '.join(PARTS)}")
    found = {}
    for part in parts or PARTS:
        found[part], text, draw = PARTS[part](coarse, repeats)
        report(out, part, text, draw() if plot and draw is not None else None)
    if "precision" in found:
        with open(Path(out) / "precision.csv", "w", newline="") as file:
            lines = precision.records(found["precision"])
            writer = csv.DictWriter(file, list(lines[0]))
            writer.writeheader()
            writer.writerows(lines)
    return found


if __name__ == "__main__":
    run(main)
