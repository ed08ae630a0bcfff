"""Strengths of many periodic cells of crystals, and the work that they take.

Stretches cells of the example ``polycrystal``; the ranks of ``demos/run -n 2`` share them, and
those that ``cells.csv`` has are not done again.
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import numpy as np
from parts.options import run
from parts.polycrystals import Study
from parts.study import shared


def main(
    grains: int = 50,
    seed: int = 0,
    seeds: int = 3,
    solid: bool = False,
    spread: float = 0.0,
    cells: float = 6.0,
    end: float = 0.005,
    steps: int = 20,
    trace: bool = True,
    out: str = "results/polycrystal_strengths",
    verbose: bool = False,
) -> np.ndarray:
    """Stretch every cell beyond its strength; rows of its table.

    Args:
        grains: Number of grains.
        seed: Of their places and orientations, of the first cell: the same seed, the same cell.
        seeds: Number of cells.
        solid: Cells in space.
        spread: Of their sizes, standard deviation of the logarithm; 0.35 for grown grains [-].
        cells: Along the mean size of a grain; 2 in space [-].
        end: Mean strain at the end [-].
        steps: Given strains on the way.
        trace: Follow the path back where it snaps; else jump to the next equilibrium, as a machine
            does, in fewer steps.
        out: Folder for histories and the table.
        verbose: Print the residuals of every step.
    """
    loads = np.linspace(0, end, steps + 1)[1:]
    study = Study(Path(out), 3 if solid else 2, grains, spread, cells, loads, trace)
    asked = [(float(n),) for n in range(seed, seed + seeds)]
    runs, comm = shared(study.table.left(asked), seeds > 1)
    for (number,) in runs:
        study.run(int(number), comm, verbose)
    MPI.COMM_WORLD.barrier()
    if MPI.COMM_WORLD.rank == 0:
        print(study.summary())
    if left := study.table.left(asked):
        raise RuntimeError(f"cells of these seeds have stopped before they part: {left}")
    return study.table.read()


if __name__ == "__main__":
    run(main)
