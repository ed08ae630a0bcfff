"""Rows of a table that is spread over the ranks, found by their keys."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray


def look_up(
    comm: MPI.Comm,
    keys: NDArray[np.int64],
    rows: NDArray[np.float64],
    wanted: NDArray[np.int64],
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Rows with the keys that this rank wants, whichever rank has them; collective.

    Rows and questions meet on the rank ``key % size``, so that no rank sees more than its share of
    the table.

    Args:
        comm: The ranks.
        keys: Of this rank's rows (n,), not negative, each one on one rank only.
        rows: This rank's part of the table (n, width).
        wanted: Keys (m,); several ranks may want the same.

    Returns:
        Whether the table has each key (m,), and the rows of those that it has, in their order.
    """
    to_table = _Mail(comm, keys % comm.size)
    table_keys, table = to_table.send(keys), to_table.send(rows)
    order = np.argsort(table_keys, kind="stable")
    table_keys, table = table_keys[order], table[order]
    questions = _Mail(comm, wanted % comm.size)
    asked = questions.send(wanted)
    place = np.searchsorted(table_keys, asked)
    there = place < len(table_keys)
    there[there] = table_keys[place[there]] == asked[there]
    answers = np.zeros((len(asked), rows.shape[1]))
    answers[there] = table[place[there]]
    found = questions.reply(there.astype(np.int8)) > 0
    return found, questions.reply(answers)[found]


class _Mail:
    """Sends one item a row to given ranks, and answers back.

    Args:
        comm: The ranks.
        destination: Rank to which each row goes (n,).
    """

    def __init__(self, comm: MPI.Comm, destination: NDArray[np.int64]):
        self._comm = comm
        self._order = np.argsort(destination, kind="stable")
        self._out = np.bincount(destination, minlength=comm.size)
        self._in = np.empty_like(self._out)
        comm.Alltoall(self._out, self._in)

    def send(self, values: NDArray) -> NDArray:
        """The rows (n, ...) that all ranks sent here, ordered by rank."""
        return self._exchange(values[self._order], self._out, self._in)

    def reply(self, values: NDArray) -> NDArray:
        """One answer for every row that came with :meth:`send`; here: answers to this rank's."""
        result = np.empty((len(self._order), *values.shape[1:]), dtype=values.dtype)
        result[self._order] = self._exchange(values, self._in, self._out)
        return result

    def _exchange(self, values: NDArray, send: NDArray, receive: NDArray) -> NDArray:
        values = np.ascontiguousarray(values)
        result = np.empty((int(receive.sum()), *values.shape[1:]), dtype=values.dtype)
        # Whole rows as one item: counts stay small where the rows of many facets are wide.
        width = values.dtype.itemsize * int(np.prod(values.shape[1:]))
        row = MPI.BYTE.Create_contiguous(width).Commit()
        try:
            self._comm.Alltoallv([values, send, row], [result, receive, row])
        finally:
            row.Free()
        return result
