"""Delamination tests with published numbers: DCB in 2D and 3D, ENF, MMB, peel, cycles; one table.

`--case NAME` runs one of them, all without it. Modes I, II and mixed by the criterion of
Benzeggagh and Kenane, default options: no penalty, no artificial stiffness, no viscosity. The
published results are those of fracture mechanics (VCCT) or of tests; formulas of beam theory and
sources stand in ``parts/delamination``.
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from parts.delamination.beams import Run
from parts.delamination.cases import CASES, Case, Row, measure, table
from parts.delamination.fatigue import SHARE, WITHOUT_SLOPE, WITHOUT_SPEED, of_history, paris
from parts.options import run

import vmdg

#: Axes of cases whose load does not begin at zero.
LABELS = {"crack": ("crack [mm]", "N/mm"), "cycles": ("cycles", "N")}


def curves(ax: plt.Axes, case: Case, history: vmdg.History) -> None:
    """Load over motion against published values and beam theory."""
    along = case.motion in LABELS
    motion, load = (np.append(0.0, history[column]) for column in (case.motion, case.force))
    ax.plot(motion[along:], load[along:], label="vmdg")
    if "peak load" in case.published:
        ax.axhline(case.published["peak load"], color="k", ls=":", lw=1, label="published peak")
    if len(case.curve):
        ax.plot(*np.transpose(case.curve), "ko", ms=4, mfc="none", label="published")
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
    ax.set(xlabel="crack [mm]", ylabel="width [mm]", title="front")
    ax.grid(lw=0.3)


def release(ax: plt.Axes, history: vmdg.History) -> None:
    """Energy release rates of opening and shear over the crack."""
    for name, mode in (("mode_1", "I"), ("mode_2", "II")):
        ax.plot(history["crack"], history[name], label=f"$J_{{{mode}}}$")
    ax.set(xlabel="crack [mm]", ylabel="N/mm", title="energy release rate")
    ax.legend()
    ax.grid(lw=0.3)


def growth(ax: plt.Axes, history: vmdg.History) -> None:
    """Growth of a crack over its energy release rate, and the same without vmdg."""
    share, speed = paris(of_history(history))
    ax.loglog(share, 1e6 * speed, "o", mfc="none", label="vmdg")
    speed = WITHOUT_SPEED * (share / SHARE) ** WITHOUT_SLOPE
    ax.loglog(share, 1e6 * speed, "k--", lw=1, label="without vmdg")
    ax.set(xlabel="$G/G_c$", ylabel="$da/dN$ [nm]", title="growth")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")
    ax.legend()
    ax.grid(lw=0.3, which="both")


def draw(case: Case, ran: Run) -> plt.Figure:
    """Load over motion; the front in 3D, growth by cycles, energy released in peel, else length."""
    figure, (force, crack) = plt.subplots(1, 2, figsize=(9.5, 3.6), layout="constrained")
    curves(force, case, ran.history)
    if ran.points:
        force.plot(*np.transpose(ran.points), "C0x", label="vmdg, first growth")
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
    crack.set(xlabel="opening or deflection [mm]", ylabel="crack [mm]", title="crack")
    crack.grid(lw=0.3)
    return figure


def overview(folder: Path) -> plt.Figure:
    """Load over motion of all cases whose tables are in the folder."""
    there = {name: folder / f"{name}.csv" for name in CASES if (folder / f"{name}.csv").is_file()}
    rows = -(-len(there) // 4)
    figure, axes = plt.subplots(rows, 4, figsize=(13, 2.6 * rows), squeeze=False)
    labels = {}
    for ax, (name, file) in zip(axes.flat, there.items(), strict=False):
        curves(ax, CASES[name], vmdg.History.from_csv(file))
        ax.set_title(CASES[name].title, fontsize=8)
        handles, texts = ax.get_legend_handles_labels()
        labels |= dict(zip(texts, handles, strict=True))
    for ax in axes.flat[len(there) :]:
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
        out: Folder for table and pictures; one of them shows all cases that were run there.
        plot: Draw a picture of every case.
        verbose: Print the residuals of every step.
    """
    names = list(CASES) if case == "all" else [case]
    if unknown := set(names) - set(CASES):
        raise ValueError(f"case = {unknown.pop()!r} must be all or one of {', '.join(CASES)}")
    rows: list[Row] = []
    Path(out).mkdir(parents=True, exist_ok=True)
    for name in names:
        result, lines = measure(name, CASES[name], verbose)
        rows += lines
        if MPI.COMM_WORLD.rank == 0:
            result.history.to_csv(Path(out) / f"{name}.csv")
            if plot:
                draw(CASES[name], result).savefig(Path(out) / f"{name}.png", dpi=110)
            (Path(out) / "delamination.md").write_text(table(rows) + "\n")
    if MPI.COMM_WORLD.rank == 0:
        if plot:
            overview(Path(out)).savefig(Path(out) / "overview.png", dpi=80)
        print(table(rows))
        print(f"results are in {out}")
    return rows


if __name__ == "__main__":
    run(main)
