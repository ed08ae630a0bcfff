"""A composite fails across its fibres: periodic cells of glass in epoxy at random places.

Plane strain. The bond of the fibres fails first, then cracks run through the matrix along any
facet. With ``--directions 4 --seeds 3`` the strengths of 12 runs make an envelope from pull along
x to shear; those that ``strengths.csv`` has are not done again.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from helpers.fibre_cell import build, draw_envelope, draw_run, is_done, keep_strength, strengths
from helpers.options import run
from helpers.polycrystal import damage

import vmdg


def main(
    fibres: int = 7,
    fraction: float = 0.5,
    directions: int = 1,
    seeds: int = 1,
    seed: int = 0,
    cells: float = 2.5,
    end: float = 0.02,
    steps: int = 8,
    animate: bool = False,
    out: str = "results/fibre_cell",
    plot: bool = True,
    verbose: bool = False,
) -> np.ndarray:
    """Load every cell in every direction beyond its strength; seed, angle, stresses xx, xy there.

    Args:
        fibres: Number of fibres.
        fraction: Share of the area that they have [-].
        directions: Of the mean strain, from pull at 0 to shear at 90 degrees; 1 for pull alone.
        seeds: Number of cells.
        seed: Of the first one.
        cells: Along the radius of a fibre [-].
        end: Size of the mean strain at the end [-].
        steps: Given strains on the way.
        animate: Make films, too.
        out: Folder for pictures, histories and strengths.
        plot: Draw the pictures.
        verbose: Print the residuals of every step.
    """
    folder, loads = Path(out), np.linspace(0, end, steps + 1)[1:]
    studied = [(s, a) for s in range(seed, seed + seeds) for a in np.linspace(0, 90, directions)]
    for number, angle in (one for one in studied if not is_done(folder, *one)):
        problem = build(fibres, fraction, number, cells, angle)
        cell, snapshots, states = vmdg.PeriodicCell(problem), [], []

        def monitor(problem, cell=cell, snapshots=snapshots, states=states) -> dict[str, float]:
            if animate:
                snapshots.append(problem.step.snapshot())
            states.append(damage(problem))
            return cell.row()

        name = f"{folder}/fibre_cell_{number}_{angle:g}"
        said = {"progress": True, "show": ("stress_xx", "stress_xy"), "verbose": verbose}
        options = vmdg.SolveOptions(energy=True, csv=f"{name}.csv", **said)
        history = vmdg.solve(problem, loads, options, monitor).history
        stress = "stress_xx" if angle < 45 else "stress_xy"
        shown = "load", stress, "mises", 3
        if animate:
            vmdg.plot.animate(f"{name}.gif", problem, snapshots, history, *shown)
        if plot:
            draw_run(problem, history, stress, states, f"{name}.png")
        keep_strength(folder, number, angle, history, problem.comm)
    if plot and len(studied) > 1:
        draw_envelope(strengths(folder), folder / "envelope.png")
    return strengths(folder)


if __name__ == "__main__":
    run(main)
