"""Periodic cells of crystals whose boundaries can fail: a table of many."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import process_time

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

import vmdg
from parts.scenes import polycrystal
from parts.study import Table, reports

#: Share of its strength below which a cell has parted: nothing but rounding and grains that rub.
PARTED = 1e-3

COLUMNS = (
    "seed",
    "unknowns",
    "boundaries",
    "facets",
    "rows",
    "factorizations",
    "residuals",
    "failed",
    "jumps",
    "seconds",
    "strength [MPa]",
    "strain at the peak",
    "strain where parted",
    "stress at the end [MPa]",
)


@dataclass(frozen=True)
class Study:
    """Runs that differ in the places and orientations of the grains."""

    folder: Path  # For the table and histories
    dimension: int  # 2 or 3
    grains: int  # Their number
    spread: float  # Of their sizes
    cells: float  # Along the mean size of a grain
    loads: NDArray[np.float64]  # Mean strains (n,)
    trace: bool  # Follow the path back at a snap, or else jump

    @property
    def table(self) -> Table:
        """What runs have found."""
        names = ("dimension", "grains", "spread", "cells", "trace")
        key = {n: getattr(self, n) for n in names} | {"end": self.loads[-1]}
        return Table(self.folder / "cells.csv", key, COLUMNS)

    def run(self, seed: int, comm: MPI.Comm, verbose: bool) -> None:
        """Stretch a cell to the end, and add its row to the table; collective."""
        start, solid = process_time(), self.dimension == 3
        given = self.grains, seed, solid, self.spread, self.cells, comm
        problem = polycrystal.make_problem(*given)
        cell, table = vmdg.PeriodicCell(problem), self.folder / f"polycrystal_{seed}.csv"
        path = polycrystal.path_options(solid, self.trace)
        said = {"progress": reports(comm), "verbose": verbose, "csv": table}
        options = vmdg.SolveOptions(**path, **said)
        try:
            result = vmdg.solve(problem, self.loads, options, lambda _: cell.row())
        except vmdg.StepFailure as failure:
            if comm.rank == 0:
                print(f"seed {seed}: {failure}")
            return
        row = seed, *size_of(problem), *found(result, process_time() - start)
        if comm.rank == 0:
            self.table.add(*row)
        comm.barrier()

    def summary(self) -> str:
        """Means and standard deviations over the seeds."""
        rows = self.table.read()
        lines = [f"{len(rows)} cells of {self.grains} grains"]
        for name, column in zip(COLUMNS[1:], rows.T[1:], strict=True):
            known = column[np.isfinite(column)]
            if len(known):
                scatter = known.std(ddof=len(known) > 1)
                lines.append(f"  {name}: {known.mean():.4g} +- {scatter:.2g} of {len(known)}")
        return "\n".join(lines)


def size_of(problem: vmdg.Problem) -> tuple[int, int, int]:
    """Unknowns, boundaries between two grains, facets of all of them; collective."""
    dofs = problem.space.dofmap
    tags = np.concatenate([facets.tags for facets in problem.step.activation.facets])
    tags = np.concatenate(problem.comm.allgather(tags))
    unknowns = dofs.index_map.size_global * dofs.index_map_bs
    return unknowns, len(np.unique(np.sort(tags, axis=1), axis=0)), len(tags)


def found(result: vmdg.Result, seconds: float) -> tuple[float, ...]:
    """Columns from the rows of the run on; no strain where it has not parted."""
    history, counts = result.history, result.counts
    strain, stress = history["strain_xx"], history["stress_xx"]
    above = np.flatnonzero(np.abs(stress) > PARTED * stress.max())[-1]
    parted = strain[above + 1] if above + 1 < len(stress) else np.nan
    work = len(history), counts.factorizations, counts.residuals, len(result.failures)
    jumps = np.count_nonzero(history["jump_steps"])
    return *work, jumps, seconds, stress.max(), strain[stress.argmax()], parted, stress[-1]
