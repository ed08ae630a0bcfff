"""A study of many runs: a file to which each adds its row, and what is left of them to be done."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Table:
    """Rows of numbers in a file: a study continues where it was stopped."""

    file: Path  # With one line a run, of all studies in this folder
    key: dict[str, float]  # What the runs of this study have in common, by column
    columns: tuple[str, ...]  # What a run adds, by name; the first ones tell which run it is

    def read(self) -> NDArray[np.float64]:
        """Rows of this study without its key, ordered by their columns (n, m)."""
        lines = self.file.read_text().splitlines()[1:] if self.file.is_file() else []
        width = len(self.key) + len(self.columns)
        rows = np.reshape([[float(v) for v in line.split(",")] for line in lines], (-1, width))
        same = np.isclose(rows[:, : len(self.key)], list(self.key.values())).all(axis=1)
        own = rows[same, len(self.key) :]
        return own[np.lexsort(own.T[::-1])]

    def left(self, runs: Sequence[tuple[float, ...]]) -> list[tuple[float, ...]]:
        """Those of some runs that have no row, each by its first columns; collective."""
        comm = MPI.COMM_WORLD
        if comm.rank == 0 and not self.file.is_file():
            self.file.parent.mkdir(parents=True, exist_ok=True)
            self.file.write_text(",".join([*self.key, *self.columns]) + "\n")
        rows = comm.bcast(self.read())
        return [run for run in runs if run not in {tuple(row[: len(run)]) for row in rows}]

    def add(self, *row: float) -> None:
        """The row of a run; on one rank."""
        with open(self.file, "a") as file:
            file.write(",".join(repr(float(v)) for v in (*self.key.values(), *row)) + "\n")


def shared(runs: Sequence[tuple[float, ...]], several: bool) -> tuple[list, MPI.Comm]:
    """The runs of this rank and its communicator: one run by all ranks, several shared by them.

    Args:
        several: Whether the study has more than one run.
    """
    world = MPI.COMM_WORLD
    return (list(runs[world.rank :: world.size]), MPI.COMM_SELF) if several else (list(runs), world)


def reports(comm: MPI.Comm) -> bool:
    """Whether a run shows its progress: of runs that ranks share, those of the first rank."""
    return comm.size > 1 or MPI.COMM_WORLD.rank == 0
