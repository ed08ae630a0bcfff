"""Plastic bodies with interfaces: necking, Cook's membrane, shells, debonding; one table.

`--case NAME` runs one of them, all without it. Ties are compared with one body on the same mesh,
debonding with closed forms of plasticity, both with published numbers where there are any.
Formulas and sources stand in ``parts/plasticity``.
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
from parts.options import run
from parts.plasticity.cases import CASES, Drawing
from parts.plasticity.rows import Row, measured, table


def draw(drawings: dict[str, Drawing]) -> plt.Figure:
    """A panel for every case that has curves."""
    columns = min(len(drawings), 2)
    lines = -(-len(drawings) // columns)
    size = {"figsize": (4.9 * columns, 3.7 * lines), "layout": "constrained"}
    figure, axes = plt.subplots(lines, columns, squeeze=False, **size)
    for ax, (title, drawing) in zip(axes.flat, drawings.items(), strict=False):
        drawing(ax)
        ax.set_title(title, size=10)
        ax.grid(lw=0.3)
        ax.legend(fontsize=8)
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
    if MPI.COMM_WORLD.rank == 0:
        Path(out).mkdir(parents=True, exist_ok=True)
        (Path(out) / "plasticity.md").write_text(table(rows) + "\n")
        if plot and drawings:
            draw(drawings).savefig(Path(out) / "plasticity.png", dpi=110)
        print(table(rows))
        print(f"results are in {out}")
    return rows


if __name__ == "__main__":
    run(main)
