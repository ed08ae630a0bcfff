"""Two stiff inclusions part from their matrix: the problem of a public cohesive-zone tour.

Prints the bonded slope, the largest and the last force beside their values for h -> 0, whether the
interface is free of penetration, and the time of the 40 load steps. Triangles of degree 2 with
curved sides need a sixth of the tour's cells for this.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from mpi4py import MPI

from parts.benchmark.common import table
from parts.options import run
from parts.two_inclusions import LAST, LAWS, PEAK, SLOPE, Run, draw, pull


def main(
    law: Annotated[str, LAWS] = "tour",
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
        law: Of the interface.
        degree: Of displacement and curved sides.
        element_size: Of the triangles [mm].
        steps: Load steps.
        repeats: Runs, of which the fastest counts.
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
        ("bonded slope [N/mm]", bonded, SLOPE, f"{bonded / SLOPE - 1:.2%}"),
        ("largest force [N]", force.max(), PEAK, f"{force.max() / PEAK - 1:.2%}"),
        ("last force [N]", force[-1], LAST, f"{force[-1] / LAST - 1:.2%}"),
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
