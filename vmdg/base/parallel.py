"""The one place where ranks talk: global scalars, and values exchanged between owner and ghosts."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from dolfinx.common import IndexMap
from numpy.typing import ArrayLike, NDArray

from .. import compat


def global_sum(comm: MPI.Comm, value: ArrayLike) -> NDArray:
    """Sum over ranks of a scalar or an array, the same on every rank."""
    return comm.allreduce(np.asarray(value), op=MPI.SUM)


def global_norm(comm: MPI.Comm, values: NDArray[np.float64]) -> float:
    """Euclidean norm of a vector of which every rank has its own part."""
    return float(np.sqrt(global_sum(comm, values @ values)))


def global_max(comm: MPI.Comm, value: float) -> float:
    """Largest value over ranks."""
    return comm.allreduce(value, op=MPI.MAX)


def global_any(comm: MPI.Comm, value: bool) -> bool:
    """True on every rank where it is true on one."""
    return comm.allreduce(bool(value), op=MPI.LOR)


def raise_together(
    comm: MPI.Comm, message: str | None, error: type[Exception] = ValueError
) -> None:
    """Raise ``error`` on every rank if any rank has a message; the lowest rank's is shown."""
    messages = [text for text in comm.allgather(message) if text is not None]
    if messages:
        raise error(messages[0])


class GhostExchange:
    """Combines what owner and ghosts know of the indices of an IndexMap.

    DOLFINx scatters from owner to ghosts, and back with addition or insertion only; labelling
    needs the minimum or the maximum over all ranks that hold an index.
    """

    def __init__(self, comm: MPI.Comm, index_map: IndexMap):
        self._size_local = index_map.size_local
        owners = np.asarray(index_map.owners)
        # Sorted by owner, the ghosts of one neighbour are contiguous in the messages.
        self._order = np.argsort(owners, kind="stable")
        sources, self._ghost_counts = np.unique(owners, return_counts=True)
        destinations = compat.sharing_ranks(index_map)
        self._to_owners = comm.Create_dist_graph_adjacent(destinations, sources)
        self._to_ghosts = comm.Create_dist_graph_adjacent(sources, destinations)
        self._shared_counts = np.empty(len(destinations), dtype=self._ghost_counts.dtype)
        self._to_owners.Neighbor_alltoall(self._ghost_counts, self._shared_counts)
        ghosts = np.asarray(index_map.ghosts)[self._order]
        shared = self._send(self._to_owners, ghosts, self._ghost_counts, self._shared_counts)
        self._shared = shared - index_map.local_range[0]

    @staticmethod
    def _send(graph: MPI.Comm, values: NDArray, send: NDArray, receive: NDArray) -> NDArray:
        width = int(np.prod(values.shape[1:]))
        result = np.empty((int(receive.sum()), *values.shape[1:]), dtype=values.dtype)
        graph.Neighbor_alltoallv(
            [np.ascontiguousarray(values), send * width], [result, receive * width]
        )
        return result

    def combine(self, values: NDArray, operation: np.ufunc) -> None:
        """Give owner and ghosts the ``operation`` of all their values.

        Args:
            values: One row an index, owned ones first, then ghosts; changed in place.
            operation: np.minimum or np.maximum.
        """
        ghosts = values[self._size_local :]
        received = self._send(
            self._to_owners, ghosts[self._order], self._ghost_counts, self._shared_counts
        )
        operation.at(values, self._shared, received)
        ghosts[self._order] = self._send(
            self._to_ghosts, values[self._shared], self._shared_counts, self._ghost_counts
        )

    def free(self) -> None:
        """Free the communicators; collective."""
        self._to_owners.Free()
        self._to_ghosts.Free()
