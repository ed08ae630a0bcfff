"""Delamination tests with published numbers: DCB in 2D and 3D, ENF, MMB, peel, cycles; one table.

`--case NAME` runs one of them, all without it. Modes I, II and mixed by the criterion of
Benzeggagh and Kenane, default options: no penalty, no artificial stiffness, no viscosity. The
published results are those of fracture mechanics (VCCT) or of tests; formulas of beam theory and
sources stand in ``parts/delamination``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import process_time

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from parts.delamination.beams import Run, dcb, enf, four_point
from parts.delamination.fatigue import (
    SHARE,
    WITHOUT_SLOPE,
    WITHOUT_SPEED,
    fatigue,
    of_history,
    paris,
)
from parts.delamination.laminate import ALFANO_CRISFIELD, IM7_8552, T300_977, T300_1076
from parts.delamination.mmb import CRITICAL, mmb
from parts.delamination.peel import peel
from parts.delamination.plies import D30, T300, Plates, d30, straight
from parts.options import run
from parts.tables import markdown

import vmdg

Points = Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Case:
    """A test, and published results of it."""

    title: str  # With its source
    run: Callable[[bool], Run]  # Runs it; True prints the residuals of every step
    # Values by the start of the quantity of a check
    published: dict[str, float] = field(default_factory=dict)
    curve: Points = ()  # Published points of load over motion
    # motion, force: Columns of the history
    motion: str = "load"
    force: str = "force"
    along: bool = True  # Whether the run should pass the published points


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    case: str  # Name of the case
    quantity: str  # With its unit
    computed: float  # By vmdg
    published: float | None  # None where nothing is
    theory: float | None  # Corrected beam theory, None where there is none
    rows: int  # Of the history
    factorizations: int  # Of the run
    seconds: float  # Of processor time, of this rank

    def off(self, reference: float | None) -> str:
        """Difference to a reference, in percent."""
        if reference is None:
            return ""
        return f"{reference:.4g} ({100 * (self.computed / reference - 1):+.1f} %)"


#: Krueger 2012, figures read to 3 %; the first points are printed.
MMB_20 = (
    *((1.64, 128.5), (1.8, 114), (2.2, 96), (2.55, 85), (3.0, 76), (3.3, 73), (3.6, 73.5)),
    *((4.0, 76), (4.7, 79), (5.6, 81.5), (6.5, 85), (7.4, 88), (9.0, 94)),
)
MMB_50 = (
    *((1.34, 385), (1.45, 290), (1.6, 255), (1.8, 225), (1.95, 218), (2.2, 232), (2.5, 255)),
    *((3.3, 297), (4.4, 365), (6.0, 467), (7.7, 600)),
)
MMB_80 = (
    *((1.65, 751), (1.7, 480), (1.8, 430), (1.95, 418), (2.2, 445), (2.5, 485), (3.2, 575)),
    *((4.1, 665), (5.0, 765), (6.0, 895), (6.8, 1000)),
)
#: The process zone of a bond of 1.7 MPa is as long as the beam.
WEAK = replace(ALFANO_CRISFIELD, strength=1.7)
#: Longer facets than the process zone of 60 MPa, which takes points enough in each.
COARSE = {"element_size": 1.0, "steps": 30, "end": 9.0, "rows": 2, "degree": 4}
FINE = {"element_size": 0.25, "rows": 2, "degree": 2}
TURON = {"a_0": 55.0, "length": 150.0}


def _dcb(m, **options) -> Callable[[bool], Run]:
    return lambda verbose: dcb(m=m, verbose=verbose, **options)


def _points(tested: Plates) -> dict[str, float]:
    """Published values of straight fronts, by the quantity of the table."""
    return {
        f"a = {a:g} mm: {name}": value
        for a, (opening, load) in tested.points.items()
        for name, value in (("stiffness", load / opening), ("load", load), ("opening", opening))
    }


def _mmb(ratio: float, end: float, curve: Points = ()) -> Case:
    title, published = f"MMB, $G_{{II}}/G_T$ = {ratio:g}", {}
    if ratio in CRITICAL:
        deflection, load = CRITICAL[ratio]
        title += " (Krueger 2012)"
        published = {"stiffness": load / deflection, "critical load": load}
    return Case(
        title,
        lambda verbose: mmb(ratio, end, verbose=verbose),
        published,
        curve,
        "deflection",
        "load",
    )


CASES = {
    "mmb-20": _mmb(0.2, 9.0, MMB_20),
    "mmb-50": _mmb(0.5, 7.7, MMB_50),
    "mmb-80": _mmb(0.8, 6.8, MMB_80),
    "mmb-35": _mmb(0.35, 3.5),
    "mmb-65": _mmb(0.65, 2.0),
    "dcb": Case("DCB (Alfano and Crisfield 2001)", _dcb(ALFANO_CRISFIELD, element_size=0.0625)),
    "dcb-t300": Case("DCB, T300/1076", _dcb(T300_1076, **FINE, end=2.6, steps=26, length=150.0)),
    "turon": Case(
        "DCB (Turon 2007), facets of 0.25 mm",
        _dcb(T300_977, **(FINE | TURON), end=9.0, steps=30),
        {"peak load": 62.0},
    ),
    "turon-60": Case(
        "DCB (Turon 2007), 60 MPa, 1 mm", _dcb(T300_977, **COARSE, **TURON), {"peak load": 62.0}
    ),
    "turon-26": Case(
        "DCB (Turon 2007), 26 MPa, 1 mm",
        _dcb(replace(T300_977, strength=26.0), **COARSE, **TURON),
        {"peak load": 62.0},
    ),
    "weak": Case(
        "DCB, 1.7 MPa (Alfano and Crisfield 2001)",
        _dcb(WEAK, element_size=0.5, steps=40, end=6.0, rows=2, degree=2, zone=60.0),
        {"peak load": 49.5},
    ),
    "dcb-nasa": Case(
        "DCB, experiments 71.0\N{EN DASH}80.1 N (NASA 2020)",
        _dcb(IM7_8552, **FINE, end=8.0, steps=30, length=190.0, a_0=63.5),
        {"peak load": 75.6},
    ),
    "enf-nasa": Case(
        "ENF, experiments 692\N{EN DASH}732 N (NASA 2020)",
        lambda verbose: enf(
            element_size=0.25, steps=18, end=4.95, m=IM7_8552, L=101.6, a_0=76.2, verbose=verbose
        ),
        {"peak load": 712.0},
    ),
    "4enf-nasa": Case(
        "4ENF, experiments 1555\N{EN DASH}1715 N (NASA 2020)",
        lambda verbose: four_point(verbose=verbose),
        {"peak load": 1645.0},
        motion="deflection",
        force="load",
    ),
    "fatigue": Case(
        "DCB under cycles, R = 0.1 (Davila 2018)",
        lambda verbose: fatigue(verbose=verbose),
        motion="cycles",
    ),
    "peel-90": Case(
        "peel at 90°, finite strain",
        lambda verbose: peel(90.0, verbose=verbose),
        motion="crack",
    ),
    "peel-180": Case(
        "peel at 180°, finite strain",
        lambda verbose: peel(180.0, verbose=verbose),
        motion="crack",
    ),
    "t300": Case(
        "DCB in 3D, a = 40 mm (Krueger 2008)",
        lambda verbose: straight(T300, verbose),
        _points(T300),
        list(T300.points.values()),
        along=False,
    ),
    "d30": Case(
        "DCB of ±30° and 0° plies in 3D (Krueger 2008)",
        lambda verbose: d30(verbose=verbose),
        _points(D30),
        list(D30.points.values()),
        along=False,
    ),
}


def table(rows: Sequence[Row]) -> str:
    """Markdown."""
    return markdown(
        ["case", "quantity", "computed", "published", "beam theory", "rows", "factorizations", "s"],
        [
            (
                *(r.case, r.quantity, f"{r.computed:.4g}", r.off(r.published), r.off(r.theory)),
                *(r.rows, r.factorizations, f"{r.seconds:.0f}"),
            )
            for r in rows
        ],
    )


def measure(name: str, case: Case, verbose: bool = False) -> tuple[Run, list[Row]]:
    """Run a case; the run and its lines of the table."""
    start = process_time()
    run = case.run(verbose)
    cost = len(run.history), run.factorizations, process_time() - start
    rows = []
    for check in run.checks:
        known = [v for start, v in case.published.items() if check.quantity.startswith(start)]
        published = known[0] if known else None
        theory = None if math.isnan(check.exact) else check.exact
        rows.append(Row(name, check.quantity, check.computed, published, theory, *cost))
    peak = case.published.get("peak load")
    if peak is not None and not any(row.quantity.startswith("peak load") for row in rows):
        rows.append(Row(name, "peak load [N]", run.history[case.force].max(), peak, None, *cost))
    return run, rows + [Row(name, *worst, None, *cost) for worst in _off_curve(case, run.history)]


def _off_curve(case: Case, history: vmdg.History) -> list[tuple[str, float, float]]:
    """Where the run is furthest from the published curve behind its first point."""
    if not (case.curve and case.along):
        return []
    passed = history.envelope(case.motion)
    motion, force = np.array(case.curve[1:]).T
    found = np.interp(motion, passed[case.motion], passed[case.force])
    i = int(np.abs(found / force - 1).argmax())
    return [(f"furthest from the curve, at {motion[i]:g} mm [N]", float(found[i]), float(force[i]))]


#: Axes of cases whose load does not begin at zero.
LABELS = {"crack": ("crack [mm]", "N/mm"), "cycles": ("cycles", "N")}


def curves(ax: plt.Axes, case: Case, ran: Run) -> None:
    """Load over motion against published values and beam theory."""
    history = ran.history
    along = case.motion in LABELS
    motion, load = (np.append(0.0, history[column]) for column in (case.motion, case.force))
    ax.plot(motion[along:], load[along:], label="vmdg")
    if "peak load" in case.published:
        ax.axhline(case.published["peak load"], color="k", ls=":", lw=1, label="published peak")
    if len(case.curve):
        ax.plot(*np.transpose(case.curve), "ko", ms=4, mfc="none", label="published")
    if ran.points:
        ax.plot(*np.transpose(ran.points), "C1x", label="vmdg, first growth")
    if "force_exact" in history.columns:
        ax.plot(motion, np.append(0.0, history["force_exact"]), "k--", lw=1, label="beam theory")
    label, unit = LABELS.get(case.motion, ("opening or deflection [mm]", "N"))
    ax.set(xlabel=label, ylabel=f"load [{unit}]", title=case.title)
    ax.grid(lw=0.3)


def front(ax: plt.Axes, history: vmdg.History, count: int = 8) -> None:
    """The crack front over the width, at some rows of the table."""
    names = [name for name in history.columns if name.startswith("front_")]
    across = [float(name.removeprefix("front_")) for name in names]
    for i, row in enumerate(np.linspace(0, len(history) - 1, count).astype(int)):
        lengths = [history[name][row] for name in names]
        ax.plot(lengths, across, ".-", color=plt.cm.viridis(i / count), lw=1, ms=3)
    ax.set(xlabel="crack [mm]", ylabel="width [mm]", title="crack front, dark to light as it moves")
    ax.grid(lw=0.3)


def release(ax: plt.Axes, history: vmdg.History) -> None:
    """Energy release rates of opening and shear over the crack."""
    for name, mode in (("mode_1", "I"), ("mode_2", "II")):
        ax.plot(history["crack"], history[name], label=f"$J_{{{mode}}}$")
    ax.set(xlabel="crack [mm]", ylabel="J [N/mm]", title="energy release rate (J integral)")
    ax.legend()
    ax.grid(lw=0.3)


def growth(ax: plt.Axes, history: vmdg.History) -> None:
    """Growth of a crack over its energy release rate, and the same without vmdg."""
    share, speed = paris(of_history(history))
    ax.loglog(share, 1e6 * speed, "o", mfc="none", label="vmdg")
    speed = WITHOUT_SPEED * (share / SHARE) ** WITHOUT_SLOPE
    ax.loglog(share, 1e6 * speed, "k--", lw=1, label="law along a given crack, without vmdg")
    ax.set(xlabel="$G/G_c$", ylabel="growth in a cycle [nm]", title="crack growth")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")
    ax.legend()
    ax.grid(lw=0.3, which="both")


def draw(case: Case, ran: Run) -> plt.Figure:
    """Load over motion; the front in 3D, growth by cycles, energy released in peel, else length."""
    figure, (force, crack) = plt.subplots(1, 2, figsize=(9.5, 3.6), layout="constrained")
    curves(force, case, ran)
    force.legend()
    if any(name.startswith("front_") for name in ran.history.columns):
        front(crack, ran.history)
        return figure
    if case.motion == "cycles":
        growth(crack, ran.history)
        return figure
    if case.motion == "crack":
        release(crack, ran.history)
        return figure
    crack.plot(ran.history[case.motion], ran.history["crack"], marker=".", ms=3, lw=0.5)
    crack.set(xlabel="opening or deflection [mm]", ylabel="crack [mm]", title="crack length")
    crack.grid(lw=0.3)
    return figure


def overview(runs: dict[str, Run]) -> plt.Figure:
    """Load over motion of several cases, whose runs follow the published curves."""
    rows = -(-len(runs) // 3)
    figure, axes = plt.subplots(rows, 3, figsize=(10.5, 2.7 * rows), squeeze=False)
    labels = {}
    for ax, (name, ran) in zip(axes.flat, runs.items(), strict=False):
        curves(ax, CASES[name], ran)
        ax.set_title(CASES[name].title.replace(" (", "\n("))
        ax.locator_params("x", nbins=5)
        handles, texts = ax.get_legend_handles_labels()
        labels |= dict(zip(texts, handles, strict=True))
    for ax in axes.flat[len(runs) :]:
        ax.set_axis_off()
    figure.legend(labels.values(), labels.keys(), loc="lower right", ncols=len(labels))
    figure.tight_layout(rect=(0, 0.03, 1, 1))
    return figure


def main(
    case: str = "all",
    out: str = "results/delamination",
    plot: bool = True,
    verbose: bool = False,
) -> list[Row]:
    """Run the cases; the lines of the table.

    Args:
        case: Name of one, or "all".
        out: Folder for table and pictures.
        plot: Draw a picture of every case, and one of all in the plane.
        verbose: Print the residuals of every step.
    """
    names = list(CASES) if case == "all" else [case]
    if unknown := set(names) - set(CASES):
        raise ValueError(f"case = {unknown.pop()!r} must be all or one of {', '.join(CASES)}")
    rows: list[Row] = []
    runs: dict[str, Run] = {}
    Path(out).mkdir(parents=True, exist_ok=True)
    for name in names:
        runs[name], lines = measure(name, CASES[name], verbose)
        rows += lines
        if MPI.COMM_WORLD.rank == 0:
            runs[name].history.to_csv(Path(out) / f"{name}.csv")
            if plot:
                draw(CASES[name], runs[name]).savefig(Path(out) / f"{name}.png")
            (Path(out) / "delamination.md").write_text(table(rows) + "\n")
    if MPI.COMM_WORLD.rank == 0:
        plane = {name: ran for name, ran in runs.items() if CASES[name].along}
        if plot and len(plane) > 1:
            overview(plane).savefig(Path(out) / "overview.png")
        print(table(rows))
        print(f"results are in {out}")
    return rows


if __name__ == "__main__":
    run(main)
