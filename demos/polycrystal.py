"""A polycrystal breaks along its grain boundaries: a periodic cell of cubic crystals, each turned.

Nickel, in plane strain or, with ``--solid``, in space. The cell is stretched along x, free of
stress across. Every boundary between two grains can fail. Damage begins where stiff and soft
directions meet, spreads to the junctions of three grains, and one crack crosses the cell from image
to image, bridged by grains that lock until they are pulled out; where much breaks at once the path
leads back to smaller strains. ``--seeds 30`` makes 30 cells: the ranks of ``demos/run -n 2`` share
them, and those that ``cells.csv`` has are not done again.
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import numpy as np
from helpers.options import run
from helpers.polycrystal import Study
from helpers.study import shared


def main(
    grains: int = 50,
    seed: int = 0,
    seeds: int = 1,
    solid: bool = False,
    spread: float = 0.0,
    cells: float = 6.0,
    end: float = 0.005,
    steps: int = 20,
    trace: bool = True,
    animate: bool = False,
    out: str = "results/polycrystal",
    plot: bool = True,
    verbose: bool = False,
) -> np.ndarray:
    """Stretch every cell beyond its strength; rows of its table.

    Args:
        grains: Number of grains.
        seed: Of their places and orientations, of the first cell: the same seed, the same cell.
        seeds: Number of cells.
        solid: Cells in space.
        spread: Of their sizes, standard deviation of the logarithm; .35 for grown grains [-].
        cells: Along the mean size of a grain; 2 in space [-].
        end: Mean strain at the end [-].
        steps: Given strains on the way.
        trace: Follow the path back where it snaps; else jump to the next equilibrium, as a machine
            does, in fewer steps.
        animate: Make films of the runs, too.
        out: Folder for pictures, histories and the table.
        plot: Draw the pictures.
        verbose: Print the residuals of every step.
    """
    loads = np.linspace(0, end, steps + 1)[1:]
    study = Study(Path(out), 3 if solid else 2, grains, spread, cells, loads, trace)
    asked = [(float(n),) for n in range(seed, seed + seeds)]
    runs, comm = shared(study.table.left(asked), seeds > 1)
    for (number,) in runs:
        study.run(int(number), comm, plot, animate, verbose)
    MPI.COMM_WORLD.barrier()
    if MPI.COMM_WORLD.rank == 0:
        print(study.summary())
    if left := study.table.left(asked):
        raise RuntimeError(f"cells of these seeds have stopped before they part: {left}")
    return study.table.read()


if __name__ == "__main__":
    run(main)
