"""The parts of the benchmark by name: what each runs, its table and its picture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mpi4py import MPI

from matplotlib.figure import Figure

from parts.bars import progress
from parts.benchmark import (
    cost,
    derivatives,
    explicit,
    intact,
    peers,
    plastic,
    precision,
    ratio,
    separate,
    small,
    step,
    switches,
    zone,
)
from parts.benchmark.common import DIMENSION, table

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


def small_part(coarse: bool, repeats: int) -> Outcome:
    """Rows of small problems, in and outside of compiled code."""
    sizes = small.SIZES[: 1 if coarse else None]
    cases = [(kinematics, n, repeats) for n in sizes for kinematics in ("small", "finite")]
    costs = [small.measure(*case) for case in progress(cases, "case")]
    return costs, table(small.HEAD, [cost.row() for cost in costs]), None


def derivatives_part(coarse: bool, repeats: int) -> Outcome:
    """Runs with and without derivatives."""
    cases = [(kind, 6 if coarse else 24, repeats) for kind in ("small", "finite")]
    costs = [derivatives.measure(*case) for case in progress(cases, "case")]
    return costs, table(derivatives.HEAD, [cost.row() for cost in costs]), None


def zone_part(coarse: bool, repeats: int) -> Outcome:
    """Krylov iterations while a zone of failure grows, in 3D."""
    cases = progress((True, False), "interpolation")
    grown = [zone.measure(bodies, 10 if coarse else 20) for bodies in cases]
    return grown, table(zone.HEAD, [one.row() for one in grown]), None


def step_part(coarse: bool, repeats: int) -> Outcome:
    """What a step does in addition to assembly and solves, by facet and cell."""
    actions = step.measure(repeats, 0.2 if coarse else 1.0)
    return actions, table(step.HEAD, step.rows(actions)), None


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


def switches_part(coarse: bool, repeats: int) -> Outcome:
    """P1 with and without what the switchboard can turn off."""
    plate = (switches.COARSE, 6) if coarse else (peers.P1, 40)
    cases = progress(switches.CASES, "switch")
    savings = [switches.measure(name, *plate, repeats) for name in cases]
    return savings, table(switches.HEAD, switches.rows(savings)), None


def kernels_part(coarse: bool, repeats: int) -> Outcome:
    """Kernels of scenes that follow each other, from an empty cache."""
    scenes = list(cost.SCENES)[: 3 if coarse else None]
    found = cost.compiled(scenes)
    return found, table(cost.HEAD_KERNELS, cost.kernel_rows(found)), None


def memory_part(coarse: bool, repeats: int) -> Outcome:
    """Peak resident size of the push-out with and without its interface."""
    peaks = cost.peaks(3, 0.3) if coarse else cost.peaks()
    rows = [(name, peak["unknowns"], peak["MiB"]) for name, peak in peaks.items()]
    share = peaks["vmdg"]["MiB"] / peaks["plain"]["MiB"]
    return peaks, table(("push-out", "unknowns", "MiB"), rows) + f"\n\nratio {share:.3f}", None


PARTS: dict[str, Callable[[bool, int], Outcome]] = {
    "precision": precision_part,
    "intact": intact_part,
    "ratio": ratio_part,
    "plastic": plastic_part,
    "separate": separate_part,
    "explicit": explicit_part,
    "small": small_part,
    "derivatives": derivatives_part,
    "zone": zone_part,
    "step": step_part,
    "peers": peers_part,
    "switches": switches_part,
    "kernels": kernels_part,
    "memory": memory_part,
}
