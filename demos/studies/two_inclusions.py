"""Two stiff inclusions separate from their matrix, a problem of J. Bleyer's Numerical Tours.

Prints the bonded slope, the largest and the last force with their values for h -> 0, penetration
of the interface, and the time of the 40 load steps. Triangles of degree 2 with curved sides need a
sixth of the cells of the published solution for this.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from mpi4py import MPI

from parts.benchmark.common import table
from parts.options import run
from parts.two_inclusions import LAST, LAWS, PEAK, SLOPE, Run, draw, pull


def error(value: float, reference: float) -> str:
    """Relative error as printed."""
    return f"{100 * (value / reference - 1):.2f} %"


def main(
    law: Annotated[str, LAWS] = "intrinsic",
    degree: int = 2,
    element_size: float = 0.05,
    steps: int = 40,
    repeats: int = 1,
    out: str = "results/two_inclusions",
    plot: bool = True,
    verbose: bool = False,
) -> tuple[Run, float]:
    """Pull with one law; the run and the bonded slope [N/mm].

    Args:
        law: Law of the interface.
        degree: Degree of the displacement and of curved sides.
        element_size: Size of the triangles [mm].
        steps: Load steps.
        repeats: Number of runs; the fastest counts.
        out: Folder for picture and history.
        plot: Draw the picture.
        verbose: Print the residuals of every step.
    """
    folder = Path(out)
    bonded = pull(LAWS["tie"], degree, element_size, steps).slope
    shown = {"progress": True, "verbose": verbose, "csv": folder / "history.csv"}
    runs = [pull(LAWS[law], degree, element_size, steps, **shown) for _ in range(repeats)]
    best = min(runs, key=lambda run: run.seconds)
    force = best.history["force"]
    rows = [
        ("bonded slope [N/mm]", bonded, SLOPE, error(bonded, SLOPE)),
        ("largest force [N]", force.max(), PEAK, error(force.max(), PEAK)),
        ("last force [N]", force[-1], LAST, error(force[-1], LAST)),
        ("slope with the law [N/mm]", best.slope, "", ""),
        ("penetration [mm]", best.penetration, 0, ""),
        ("processor time [s]", best.seconds, "", ""),
        ("unknowns", 2 * best.problem.space.dofmap.index_map.size_global, "", ""),
        ("Newton corrections", int(best.history["iterations"].sum()), "", ""),
    ]
    figure = draw(best, bonded) if plot else None
    if MPI.COMM_WORLD.rank == 0:
        if figure:
            figure.savefig(folder / "two_inclusions.png", dpi=130)
        print(table(("", "vmdg", "h -> 0", "error"), rows))
        print(f"results are in {folder}")
    return best, bonded


if __name__ == "__main__":
    run(main)
