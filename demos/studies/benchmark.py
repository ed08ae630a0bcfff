"""Seconds and work of vmdg against plain finite elements.

Parts, one or several by name: "precision" draws error against unknowns and processor time, "ratio"
compares one Newton iteration, "separate" those of bodies meshed separately and together. Seconds
are processor time of warm runs on one core, the least of some; whatever is compared takes turns in
one process. On one rank, but "ratio", which on several tells the times of the slowest.
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
from parts.tables import markdown, progress

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


def iteration_table(costs: list[iterations.Cost]) -> str:
    """Of iterations with the same further columns."""
    return markdown((*iterations.HEAD, *costs[0].more), [cost.row() for cost in costs])


def ratio_part(coarse: bool, repeats: int) -> Outcome:
    """Newton iterations, direct and with multigrid in 3D, there on a mesh twice as fine too."""
    size = 0.2 if coarse else 1.0
    cases = [("2D", damage, True, size) for damage in (False, True)]
    cases += [("3D", damage, direct, size) for direct in (True, False) for damage in (False, True)]
    cases += [("3D", damage, False, 2 * size) for damage in (False, True)]
    shown = MPI.COMM_WORLD.rank == 0
    rows = [iterations.with_plain(*c[:3], repeats, c[3]) for c in progress(cases, "case", shown)]
    return rows, iteration_table(rows), None


def separate_part(coarse: bool, repeats: int) -> Outcome:
    """Newton iterations of bodies that are meshed separately against those of one mesh."""
    cases = [
        (cell, law, n, repeats)
        for cell, sizes in iterations.SIZES.items()
        for n in ((4,) if coarse else sizes)
        for law in iterations.LAWS
    ]
    costs = [iterations.of_separate(*case) for case in progress(cases, "case")]
    return costs, iteration_table(costs), None


PARTS: dict[str, Callable[[bool, int], Outcome]] = {
    "precision": precision_part,
    "ratio": ratio_part,
    "separate": separate_part,
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
        parts: Some of precision, ratio and separate; all without any.
        coarse: Small meshes.
        repeats: Runs, of which the fastest counts.
        out: Folder for tables and pictures.
        plot: Draw the pictures.

    Raises:
        ValueError: a part that does not exist.
    """
    if unknown := set(parts or ()) - set(PARTS):
        raise ValueError(f"no part is called {', '.join(unknown)}; they are {', '.join(PARTS)}")
    found, folder, writes = {}, Path(out), MPI.COMM_WORLD.rank == 0
    folder.mkdir(parents=True, exist_ok=True)
    for part in parts or PARTS:
        found[part], text, draw = PARTS[part](coarse, repeats)
        if not writes:
            continue
        print(f"\n{part}\n\n{text}\n")
        (folder / f"{part}.md").write_text(text + "\n")
        if plot and draw is not None:
            draw().savefig(folder / f"{part}.png")
    if "precision" in found:
        with open(folder / "precision.csv", "w", newline="") as file:
            lines = precision.records(found["precision"])
            writer = csv.DictWriter(file, list(lines[0]))
            writer.writeheader()
            writer.writerows(lines)
    if writes:
        print(f"results are in {out}")
    return found


if __name__ == "__main__":
    run(main)
