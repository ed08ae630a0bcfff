"""A polycrystal breaks along its grain boundaries: a periodic cell of cubic crystals, each turned.

Plane strain, nickel. The cell is stretched along x, free of stress across. Every boundary between
two grains can fail: those between grains that are turned by less than 15 degrees against each
other are twice as strong. Damage begins where stiff and soft directions meet, spreads to junctions
of three grains, and one crack crosses the cell from image to image, bridged by grains that lock.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from helpers.options import run
from helpers.polycrystal import CellMonitor, build, draw_damage

import vmdg
from vmdg.plot import animate as write_film


def main(
    grains: int = 50,
    seed: int = 0,
    spread: float = 0.0,
    cells: float = 6.0,
    end: float = 0.005,
    steps: int = 10,
    animate: bool = False,
    out: str = "results/polycrystal",
    plot: bool = True,
    verbose: bool = False,
) -> vmdg.History:
    """Stretch the cell beyond its strength; the history of the run.

    Args:
        grains: Number of grains.
        seed: Of their places and orientations: the same seed gives the same cell.
        spread: Of their sizes, standard deviation of the logarithm; .35 for grown grains [-].
        cells: Along the mean size of a grain [-].
        end: Mean strain at the end [-].
        steps: Given strains on the way.
        animate: Make a film of the run, too.
        out: Folder for picture and history.
        plot: Draw the picture.
        verbose: Print the residuals of every step.
    """
    problem = build(grains, seed, spread, cells)
    monitor = CellMonitor(problem, animate)
    shown = {"progress": True, "show": ("stress_xx",), "verbose": verbose}
    options = vmdg.SolveOptions(energy=True, csv=f"{out}/history.csv", **shown)
    history = vmdg.solve(problem, np.linspace(0, end, steps + 1)[1:], options, monitor).history
    names = "strain_xx", "stress_xx"
    if animate:
        write_film(f"{out}/polycrystal.gif", problem, monitor.snapshots, history, *names, "xx", 20)
    if plot:
        figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
        vmdg.plot.curve(history, *names, ax=axes[0], origin=True, color="black")
        peak = int(np.argmax(history["stress_xx"]))
        draw_damage(axes[1], problem, monitor.states[peak], f"{history['strain_xx'][peak]:.2%}")
        vmdg.plot.stress(problem, "xx", magnify=10, ax=axes[2], edges=0)
        if problem.comm.rank == 0:
            figure.savefig(Path(out) / "polycrystal.png", dpi=130)
    if problem.comm.rank == 0:
        print(f"strength {history['stress_xx'].max():.4g} MPa; results are in {out}")
    return history


if __name__ == "__main__":
    run(main)
