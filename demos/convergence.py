"""Convergence tables: manufactured finite-strain solutions of two bodies tied by an interface.

Every study refines one kind of mesh (triangles, quadrilaterals, tetrahedra, hexahedra, regular or
distorted, straight, inclined or curved interface) for one exact solution and one contrast of the
moduli, and reports errors and rates of the displacement, its gradient and the interface traction.
The solutions are derived in ``_manufactured.py``. On one core all studies take about half an hour.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

from _convergence import Row, coarse_studies, errors, full_studies, plot, summary, table, write_csv
from tqdm import tqdm


def main(
    coarse: bool = False, cell: str | None = None, out: str = "results/convergence"
) -> list[Row]:
    """Run the studies; tables, CSV and picture go to the folder ``out``."""
    comm = MPI.COMM_WORLD
    studies = coarse_studies() if coarse else full_studies()
    studies = [study for study in studies if cell in (None, study.cell)]
    rows = []
    Path(out).mkdir(parents=True, exist_ok=True)
    for study in tqdm(studies, unit="study", disable=comm.rank > 0):
        rows.append(Row(study, [errors(study, n, comm) for n in study.levels]))
        if comm.rank == 0:
            write_csv(rows, Path(out) / "convergence.csv")
    if comm.rank == 0:
        text = f"{summary(rows)}\n\n{table(rows)}\n"
        (Path(out) / "convergence.md").write_text(text)
        plot(rows).savefig(Path(out) / "convergence.png", dpi=130)
        print(text)
        print(f"tables and picture are in {out}")
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--coarse", action="store_true", help="few studies on coarse meshes")
    parser.add_argument("--cell", help="triangle, quadrilateral, tetrahedron or hexahedron only")
    parser.add_argument("--out", default="results/convergence", help="folder for the results")
    main(**vars(parser.parse_args()))
