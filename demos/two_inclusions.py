"""Two stiff inclusions part from their matrix: the problem of a public cohesive-zone tour.

Prints the bonded slope, the largest and the last force beside their values for h -> 0, whether the
interface is free of penetration, and the time of the 40 load steps. Triangles of degree 2 with
curved sides need a sixth of the tour's cells for this.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

from _benchmark import table
from _two_inclusions import LAST, LAWS, PEAK, SLOPE, Run, draw, run


def main(
    law: str = "tour",
    degree: int = 2,
    element_size: float = 0.05,
    steps: int = 40,
    repeats: int = 1,
    out: str = "results/two_inclusions",
) -> tuple[Run, float]:
    """Run with one law of ``LAWS``; returns the run and the bonded slope [N/mm].

    The seconds are the least of ``repeats`` runs. Picture and history go to the folder ``out``.
    """
    bonded = run(LAWS["tie"], degree, element_size, steps).slope
    runs = [run(LAWS[law], degree, element_size, steps, progress=True) for _ in range(repeats)]
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
    figure = draw(best, bonded)
    if MPI.COMM_WORLD.rank == 0:
        folder = Path(out)
        folder.mkdir(parents=True, exist_ok=True)
        figure.savefig(folder / "two_inclusions.png", dpi=130)
        best.history.to_csv(folder / "history.csv")
        print(table(("", "vmdg", "h -> 0", "error"), rows))
        print(f"picture and history are in {folder}")
    return best, bonded


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--law", choices=LAWS, default="tour", help="of the interface (tour)")
    parser.add_argument("--degree", type=int, default=2, help="of displacement and sides (2)")
    parser.add_argument("--element-size", type=float, default=0.05, help="[mm] (.05)")
    parser.add_argument("--steps", type=int, default=40, help="load steps (40)")
    parser.add_argument("--repeats", type=int, default=1, help="runs, for the least time (1)")
    parser.add_argument("--out", default="results/two_inclusions", help="folder for the results")
    main(**vars(parser.parse_args()))
