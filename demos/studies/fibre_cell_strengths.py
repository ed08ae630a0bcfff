"""Strengths of many periodic cells of fibres: their scatter against bounds, and a failure envelope.

Loads cells of the example ``fibre_cell``: ``--seeds 10`` gives mean and scatter of the strength,
``--directions 4 --seeds 3`` an envelope of 12 runs from pull to shear. Several runs are shared by
the ranks of ``demos/run -n 2``, one by all of them; those that ``strengths.csv`` has are not done
again.
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import numpy as np
from parts.fibre_cells import Study, draw_envelope
from parts.options import run
from parts.study import shared


def main(
    fibres: int = 7,
    fraction: float = 0.5,
    directions: int = 1,
    first: float = 0.0,
    last: float = 90.0,
    friction: float = 0.0,
    seeds: int = 3,
    seed: int = 0,
    cells: float = 2.5,
    end: float = 0.02,
    steps: int = 8,
    out: str = "results/fibre_cell_strengths",
    verbose: bool = False,
) -> np.ndarray:
    """Load every cell in every direction beyond its strength; rows of its table.

    Args:
        fibres: Number of fibres.
        fraction: Share of the area that they have [-].
        directions: Of the mean strain, from the first to the last; 1 for the first alone.
        first: Direction [degrees].
        last: Direction [degrees].
        friction: Of surfaces that have parted [-].
        seeds: Number of cells.
        seed: Of the first one.
        cells: Along the radius of a fibre [-].
        end: Size of the mean strain at the end [-].
        steps: Given strains on the way.
        out: Folder for histories, strengths and the envelope.
        verbose: Print the residuals of every step.
    """
    study = Study(Path(out), fibres, fraction, friction, cells, np.linspace(0, end, steps + 1)[1:])
    angles, world = np.linspace(first, last, directions), MPI.COMM_WORLD
    asked = [(float(n), angle) for n in range(seed, seed + seeds) for angle in angles]
    runs, comm = shared(study.table.left(asked), len(asked) > 1)
    for number, angle in runs:
        study.run(int(number), angle, comm, verbose)
    world.barrier()
    rows = study.table.read()
    draw_envelope(rows, study.folder / "envelope.png")
    if world.rank == 0:
        print(study.summary())
    if left := study.table.left(asked):
        raise RuntimeError(f"runs of these seeds and angles have stopped before they fail: {left}")
    return rows


if __name__ == "__main__":
    run(main)
