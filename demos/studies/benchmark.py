"""Seconds and work of vmdg against plain finite elements and other cohesive codes.

Parts, one or several by name: "precision" draws error against unknowns and processor time, "intact"
lists errors of intact interfaces where they differ most from those of plain elements, "ratio"
compares one Newton iteration, "plastic" those of plastic and elastic bodies, "separate" those of
bodies meshed separately and together, "explicit" times steps in time, "peers" runs two scenes that
other codes were given. Seconds are processor time of warm runs on one core, the least of some;
whatever is compared takes turns in one process. On one rank, but "ratio" and "explicit", which on
several tell the times of the slowest.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpi4py import MPI

from matplotlib.figure import Figure
from parts.bars import progress
from parts.benchmark import (
    explicit,
    intact,
    peers,
    plastic,
    precision,
    ratio,
    separate,
)
from parts.benchmark.common import DIMENSION, table
from parts.options import run

#: What was found, its table, and what draws it.
Outcome = tuple[Any, str, Callable[[], Figure] | None]


def precision_part(coarse: bool, repeats: int) -> Outcome:
    """Errors, seconds and work of three methods on all cells, degrees and meshes."""
    levels = precision.COARSE if coarse else precision.LEVELS
    cases = [(c, k, n) for c, d in DIMENSION.items() for k in (1, 2) for n in levels[d, k]]
    points = []
    for case in progress(cases, "mesh"):
        points += precision.measure(*case, repeats)
    text = table(precision.HEAD, precision.rows(points))
    return points, text, lambda: precision.plot(points)


def intact_part(coarse: bool, repeats: int) -> Outcome:
    """Errors of intact interfaces in rings, around cores and in shells."""
    kinds = [(c, k) for c, d in DIMENSION.items() for k in (1, 2, 3)[: 1 if coarse else 5 - d]]
    cases = progress([case for kind in kinds for case in intact.cases(*kind)], "mesh")
    found = [one for case in cases for one in intact.measure(*case, (intact.TIE, intact.BOND))]
    return found, table(intact.HEAD, intact.rows(found)), None


def ratio_part(coarse: bool, repeats: int) -> Outcome:
    """Newton iterations, direct and with multigrid in 3D, there on a mesh twice as fine too."""
    size = 0.2 if coarse else 1.0
    cases = [("2D", damage, True, size) for damage in (False, True)]
    cases += [("3D", damage, direct, size) for direct in (True, False) for damage in (False, True)]
    cases += [("3D", damage, False, 2 * size) for damage in (False, True)]
    shown = MPI.COMM_WORLD.rank == 0
    rows = [ratio.measure(*c[:3], repeats, c[3]) for c in progress(cases, "case", shown)]
    return rows, table(ratio.HEAD, map(ratio.row, rows)), None


def plastic_part(coarse: bool, repeats: int) -> Outcome:
    """Points a second, and Newton iterations of plastic bodies against those of elastic ones."""
    speeds = {
        name: [plastic.points_a_second(material, small, repeats) for small in (True, False)]
        for name, material in plastic.METALS.items()
    }
    cases = [
        (small, direct, 2 if coarse else 10, repeats, tied)
        for tied in (False, True)
        for direct in (True, False)
        for small in (True, False)
    ]
    costs = [plastic.measure(*case) for case in progress(cases, "case")]
    points = table(plastic.HEAD_POINTS, [(name, *speed) for name, speed in speeds.items()])
    text = f"{points}\n\n{table(plastic.HEAD, [list(cost.row()) for cost in costs])}"
    return (speeds, costs), text, None


def separate_part(coarse: bool, repeats: int) -> Outcome:
    """Newton iterations of bodies that are meshed separately against those of one mesh."""
    cases = [
        (cell, law, n, repeats)
        for cell, sizes in separate.SIZES.items()
        for n in ((4,) if coarse else sizes)
        for law in separate.LAWS
    ]
    costs = [separate.measure(*case) for case in progress(cases, "case")]
    return costs, table(separate.HEAD, [list(cost.row()) for cost in costs]), None


def explicit_part(coarse: bool, repeats: int) -> Outcome:
    """Explicit steps in the plane and in space, and what a large run would take."""
    shown = MPI.COMM_WORLD.rank == 0
    sizes = {"triangle": 64, "quadrilateral": 64, "hexahedron": 20}
    cases = [
        (cell, 4 if coarse else n, kinematics, law, 5 if coarse else 100, repeats)
        for cell, n in sizes.items()
        for kinematics in ("small", "finite")
        for law in explicit.LAWS
    ]
    costs = [explicit.measure(*case) for case in progress(cases, "case", shown)]
    edge = 4 if coarse else 37
    large = [
        explicit.measure("hexahedron", edge, kinematics, law, 5 if coarse else 50, repeats)
        for kinematics, law in progress([("small", "tied"), ("finite", "softening")], "run", shown)
    ]
    text = table(explicit.HEAD, [cost.row() for cost in costs])
    text += "\n\n" + table(explicit.LARGE, [cost.large_row() for cost in large])
    return costs + large, text, None


def peers_part(coarse: bool, repeats: int) -> Outcome:
    """P1 and P2, and the shear of a sliding interface."""
    if coarse:
        cases = {"P1": (peers.P1, 10, False, "small")}
    else:
        cases = {
            f"{scene.name}{', even steps' * even}, {kinematics}": (scene, 40, even, kinematics)
            for scene in (peers.P1, peers.P2)
            for even, kinematics in ((False, "small"), (True, "small"), (False, "finite"))
        }
    runs = {n: peers.run(*case, repeats) for n, case in progress(cases.items(), "scene")}
    text = table(peers.HEAD, [peers.row(name, run) for name, run in runs.items()])
    shear = peers.sliding_shear()
    return (runs, shear), f"{text}\n\nsliding shear {shear[0]:.9g} N, mu N {shear[1]:.9g} N", None


PARTS: dict[str, Callable[[bool, int], Outcome]] = {
    "precision": precision_part,
    "intact": intact_part,
    "ratio": ratio_part,
    "plastic": plastic_part,
    "separate": separate_part,
    "explicit": explicit_part,
    "peers": peers_part,
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
        parts: Some of precision, intact, ratio, plastic, separate, explicit and peers; all
            without any.
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
            draw().savefig(folder / f"{part}.png", dpi=130)
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
