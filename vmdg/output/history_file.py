"""The table of a run on disk, as far as the run has come."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

from mpi4py import MPI

from ..base.parallel import raise_together
from .history import History, lines


class HistoryFile:
    """A CSV file that follows a table: whenever a run is killed, all its rows are there.

    A row is one line, written and flushed at once. A column that appears later changes the header:
    then the file is written anew beside the old one and takes its place in one move. So it does at
    the start, where a run that goes on from a checkpoint finds rows that it will do again.

    Args:
        comm: Communicator; its rank 0 writes.
        path: Of the file; None for none.
        history: The table.

    Raises:
        OSError: the file cannot be written; on all ranks.
    """

    def __init__(self, comm: MPI.Comm, path: str | Path | None, history: History):
        self._comm = comm
        self._path = None if path is None else Path(path)
        self._history = history
        self._file: TextIO | None = None
        self._columns: list[str] = []
        self._units: dict[str, str] = {}
        self._written = 0
        self._do(self._replace)

    def update(self) -> None:
        """Add the rows that have come since the last time; collective.

        Raises:
            OSError: they cannot be written; on all ranks.
        """
        self._do(self._extend)

    def _do(self, action: Callable[[], None]) -> None:
        if self._path is None:
            return
        message = None
        if self._comm.rank == 0:
            try:
                action()
            except OSError as error:
                message = (
                    f"the table {self._path} cannot be written: {error}; make room or name a file "
                    "in a folder that can be written to"
                )
        raise_together(self._comm, message, OSError)

    def _extend(self) -> None:
        rows = self._history.rows[self._written :]
        named = {name for row in rows for name in row} <= set(self._columns)
        if not named or self._history.units != self._units:
            self._replace()
            return
        csv.writer(self._file).writerows(lines(rows, self._columns))
        self._file.flush()
        self._written += len(rows)

    def _replace(self) -> None:
        self.close()
        self._path.parent.mkdir(parents=True, exist_ok=True)
        partial = self._path.with_name(f"{self._path.name}.partial")
        self._history.to_csv(partial)
        partial.replace(self._path)
        self._file = open(self._path, "a", newline="")  # closed by close()
        self._columns, self._units = self._history.columns, dict(self._history.units)
        self._written = len(self._history)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def __enter__(self) -> HistoryFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
