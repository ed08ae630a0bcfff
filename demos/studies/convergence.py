"""Convergence tables: manufactured finite-strain solutions of two bodies tied by an interface.

Every study refines one kind of mesh (triangles, quadrilaterals, tetrahedra, hexahedra, regular or
distorted, straight, inclined or curved interface) for one exact solution and one contrast of the
moduli, and reports errors and rates of the displacement, its gradient and the interface traction.
The solutions are derived in ``parts/convergence/manufactured.py``. On one core all studies take
about half an hour.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from mpi4py import MPI

from parts.benchmark.common import DIMENSION
from parts.convergence.rates import (
    Row,
    coarse_studies,
    draw,
    errors,
    full_studies,
    summary,
    table,
    write_csv,
)
from parts.options import run
from parts.tables import progress


def main(
    coarse: bool = False,
    cell: Annotated[str | None, DIMENSION] = None,
    out: str = "results/convergence",
    plot: bool = True,
) -> list[Row]:
    """Run the studies; a row each.

    Args:
        coarse: Few studies on coarse meshes.
        cell: Only the studies with cells of this type.
        out: Folder for tables, CSV and picture.
        plot: Draw the picture.
    """
    comm = MPI.COMM_WORLD
    studies = coarse_studies() if coarse else full_studies()
    studies = [study for study in studies if cell in (None, study.cell)]
    rows = []
    Path(out).mkdir(parents=True, exist_ok=True)
    for study in progress(studies, "study", shown=comm.rank == 0):
        rows.append(Row(study, [errors(study, n, comm) for n in study.levels]))
        if comm.rank == 0:
            write_csv(rows, Path(out) / "convergence.csv")
    if comm.rank == 0:
        text = f"{summary(rows)}\n\n{table(rows)}\n"
        (Path(out) / "convergence.md").write_text(text)
        if plot:
            draw(rows).savefig(Path(out) / "convergence.png")
        print(text)
        print(f"results are in {out}")
    return rows


if __name__ == "__main__":
    run(main)
