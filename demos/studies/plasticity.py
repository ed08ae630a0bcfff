"""Plastic bodies with interfaces: necking, Cook's membrane, shells, debonding; one table.

`--case NAME` runs one of them, all without it. Ties are compared with one body on the same mesh,
debonding with closed forms of plasticity, both with published numbers where there are any.
Formulas and sources stand in ``parts/plasticity``.
"""

from __future__ import annotations

from collections.abc import Callable
from math import log2

import matplotlib.pyplot as plt
import numpy as np
from parts.options import run
from parts.plasticity import arms, membrane, necking, shells
from parts.plasticity.rows import Row, measured, table
from parts.tables import report

Drawing = Callable[[plt.Axes], None]
Result = tuple[list[Row], dict[str, Drawing]]


def bar(coarse: bool) -> Result:
    """A bar of two halves that necks at their interface."""
    rows, runs = necking.necking(coarse)

    def draw(ax: plt.Axes) -> None:
        styles = {"one body": "k-", "tied": "C0o", "bonded": "C1.", "refined": "k:"}
        for name, history in runs.items():
            motion, force = (np.append(0.0, history[column]) for column in ("load", "force"))
            ax.plot(motion, force, styles[name], ms=3, mfc="none", label=name)
        ax.set(xlabel="motion of each end [mm]", ylabel="force [kN]")

    return rows, {"Necking bar of two halves": draw}


def cook(coarse: bool) -> Result:
    """Cook's membrane of two parts."""
    return membrane.cook(coarse), {}


def tubes(coarse: bool) -> Result:
    """A spherical shell and a tube with a tied interface in their plastic zone.

    The zone ends between two cells of every mesh, since the kink in a cell would set the order.
    """
    front = (shells.M + shells.B) / 2
    shapes = {"sphere": shells.Shell(True, 0.3), "tube, nu = 0.4999": shells.Shell(False, 0.4999)}
    counts = (2, 4) if coarse else (2, 4, 8, 16)
    rows, errors = [], {}
    for name, shape in shapes.items():
        runs = {
            tied: [shells.press(shape, n, tied, front) for n in counts] for tied in (True, False)
        }
        for tied, label in ((True, "tied"), (False, "one body")):
            errors[f"{name.partition(',')[0]}, {label}"] = [run.error for run in runs[tied]]
        ours, plain = runs[True][-1], runs[False][-1]
        end = float(shape.displacement(np.array(shape.inner), front))
        rows += [
            Row(name, "widening [mm]", ours.widening, end, "Hill 1950", ours.mesh),
            Row(name, "plastic radius [mm]", ours.front, front, "Hill 1950", ours.mesh),
            Row(name, "error of u [-]", ours.error, plain.error, "one body, same mesh", ours.mesh),
        ]
        rates = [log2(run[-2].error / run[-1].error) for run in runs.values()]
        rows.append(Row(name, "order of u [-]", *rates, "one body, same meshes", ours.mesh))
    shape = shells.Shell(False, 0.3)
    found, mesh = shells.limit(shape, 8)
    exact, source = shape.pressure(shape.outer), "2 Y/sqrt(3) ln(b/a)"
    rows.append(Row("tube, nu = 0.3", "limit pressure [MPa]", found, exact, source, mesh))

    def draw(ax: plt.Axes) -> None:
        for i, (name, values) in enumerate(errors.items()):
            ax.loglog(counts, values, f"C{i // 2}{'o' if i % 2 == 0 else '-'}", label=name)
        ax.set_xticks(counts, [str(n) for n in counts], minor=False)
        ax.set_xticks([], minor=True)
        ax.set(xlabel="cells across the wall", ylabel="relative error of the displacement")

    return rows, {"Shells under pressure": draw}


def void(coarse: bool) -> Result:
    """A rigid inclusion from which its matrix debonds, in spherical symmetry."""
    last = shells.BOND.critical_gap
    gaps = np.linspace(0.0, last, 11)[1:-2]
    traction, opening, mesh = shells.pull_off(8 if coarse else 16, gaps)
    exact = [shells.debonding(gap) for gap in gaps]
    rows = []
    for i in (1, 4, 7):
        where, source = f"inclusion, gap {gaps[i]:g} mm", "closed form"
        rows += [
            Row(where, "traction [MPa]", traction[i], exact[i][1], source, mesh),
            Row(where, "opening [mm]", opening[i], gaps[i], source, mesh),
        ]

    def draw(ax: plt.Axes) -> None:
        motion, bond, front = np.transpose([shells.debonding(g) for g in np.linspace(0, last, 99)])
        ax.plot(np.append(0, motion), np.append(0, bond), "k-", label="closed form")
        ax.plot([where for where, _, _ in exact], traction, "C0o", mfc="none", label="vmdg")
        ax.set(xlabel="motion of the outer surface [mm]", ylabel="traction of the bond [MPa]")
        other = ax.twinx()
        other.spines.right.set_visible(True)
        ax.plot([], "C1--", lw=1, label="radius of the plastic zone")
        other.plot(motion, front, "C1--", lw=1)
        other.set_ylabel("radius of the plastic zone [mm]", color="C1")
        other.set_ylim(0, 3.5)

    return rows, {"A plastic matrix debonds from a rigid sphere": draw}


def opened(coarse: bool) -> Result:
    """Plastic arms that moments bend apart, with bonds of two strengths."""
    strengths = (30.0,) if coarse else (30.0, 60.0)
    size, cells, growth = (1.0, 2, 2.0) if coarse else (0.5, 3, 3.0)
    theory = arms.critical_moment()
    rows, runs = [], {}
    for strength in strengths:
        history, mesh = arms.open_by_moments(size, cells, growth, strength)
        runs[strength] = history
        steady = history["crack"] > arms.CRACK + growth / 2
        moment = float(history["moment"][steady].mean())
        name = f"plastic arms, {strength:g} MPa"
        rows.append(Row(name, "moment [N]", moment, theory, "J integral", mesh))

    def draw(ax: plt.Axes) -> None:
        for i, (strength, history) in enumerate(runs.items()):
            label = f"bond of {strength:g} MPa"
            ax.plot(history["crack"] - arms.CRACK, history["moment"], f"C{i}.-", ms=3, label=label)
        ax.axhline(theory, color="k", ls="--", lw=1, label="J integral")
        elastic = arms.elastic_moment()
        ax.axhline(elastic, color="k", ls=":", lw=1, label="if the arms were elastic")
        ax.set(xlabel="growth of the crack [mm]", ylabel="moment per width [N]")

    return rows, {"Plastic arms bent apart": draw}


CASES: dict[str, Callable[[bool], Result]] = {
    "necking": bar,
    "cook": cook,
    "shells": tubes,
    "inclusion": void,
    "arms": opened,
}


def draw(drawings: dict[str, Drawing]) -> plt.Figure:
    """A panel for every case that has curves."""
    columns = min(len(drawings), 2)
    lines = -(-len(drawings) // columns)
    size = {"figsize": (4.9 * columns, 3.7 * lines), "layout": "constrained"}
    figure, axes = plt.subplots(lines, columns, squeeze=False, **size)
    for ax, (title, drawing) in zip(axes.flat, drawings.items(), strict=False):
        drawing(ax)
        ax.set_title(title)
        ax.grid(lw=0.3)
        ax.legend()
    for ax in axes.flat[len(drawings) :]:
        ax.set_axis_off()
    return figure


def main(
    case: str = "all", coarse: bool = False, out: str = "results/plasticity", plot: bool = True
) -> list[Row]:
    """Run the cases; the lines of the table.

    Args:
        case: Name of one, or "all".
        coarse: Coarse meshes.
        out: Folder for table and picture.
        plot: Draw the picture.
    """
    names = list(CASES) if case == "all" else [case]
    if unknown := set(names) - set(CASES):
        raise ValueError(f"case = {unknown.pop()!r} must be all or one of {', '.join(CASES)}")
    rows: list[Row] = []
    drawings: dict[str, Drawing] = {}
    for name in names:
        found, shown = measured(CASES[name], coarse)
        rows += found
        drawings |= shown
    report(out, "plasticity", table(rows), draw(drawings) if plot and drawings else None)
    return rows


if __name__ == "__main__":
    run(main)
