"""Mesh partitions: ghosts that interfaces require, and balance of bodies and interfaces."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mpi4py import MPI

import basix
import numpy as np
from dolfinx import la
from dolfinx.cpp.graph import AdjacencyList_int32
from dolfinx.graph import partitioner
from dolfinx.mesh import to_string
from numpy.typing import NDArray

from vmdg import compat
from vmdg.base.graph import components
from vmdg.base.parallel import gathered, index_map_of

#: Communicator, number of parts, graph of the cells, whether ghosts are wanted; parts of the cells.
GraphPartitioner = Callable[[MPI.Comm, int, Any, bool], Any]

#: Communicator, number of parts, types of cells and their nodes; ranks of the cells, owners first.
CellPartitioner = Callable[[MPI.Comm, int, Any, Any], Any]


def cell_partitioner(graph_partitioner: GraphPartitioner | None = None) -> CellPartitioner:
    """A cell partitioner with the ghosts that interfaces require, for ``create_mesh`` and
    ``model_to_mesh`` of DOLFINx.

    They are those by shared facets and, where the mesh consists of several pieces that share no
    facet, all cells at the surfaces of these: a rank has the partners of its facets, wherever
    surfaces slide. They are of the order of N^(2/3) of N cells in 3D.

    Args:
        graph_partitioner: Of the graph of the cells; None for that of DOLFINx.
    """
    partition = partitioner() if graph_partitioner is None else graph_partitioner

    def destinations(comm: MPI.Comm, parts: int, kinds: Any, cells: Any) -> Any:
        cell = basix.CellType[to_string(kinds[0])]
        facets = len(basix.topology(cell)[-2])

        def with_surfaces(comm: MPI.Comm, parts: int, graph: Any, ghosting: bool) -> Any:
            found = partition(comm, parts, graph, ghosting)
            if parts == 1 or not _several_pieces(comm, graph):
                return found
            return _everywhere(found, np.diff(graph.offsets) < facets, parts)

        return compat.facet_ghost_partitioner(with_surfaces)(comm, parts, kinds, cells)

    return destinations


def _several_pieces(comm: MPI.Comm, graph: Any) -> bool:
    """Whether a distributed graph, with global numbers of neighbours, is not connected;
    collective."""
    count, neighbours = len(graph.offsets) - 1, np.asarray(graph.array)
    imap, local = index_map_of(comm, count, neighbours)
    cell = np.repeat(np.arange(count), np.diff(graph.offsets))
    piece = components(cell, local, count + imap.num_ghosts)
    # Pieces of different ranks are joined by the nodes that are ghosts of one of them.
    here = int(piece.max(initial=-1)) + 1
    counts = np.cumsum(comm.allgather(here))
    before = int(counts[comm.rank]) - here
    number = la.vector(imap, 1, dtype=np.int64)
    number.array[:] = before + piece
    number.scatter_forward()
    joined = np.column_stack([before + piece[count:], number.array[count:]])
    first, second = gathered(comm, np.unique(joined, axis=0)).T
    return bool(components(first, second, int(counts[-1])).max(initial=0) > 0)


def _everywhere(
    found: AdjacencyList_int32, chosen: NDArray[np.bool_], parts: int
) -> AdjacencyList_int32:
    """Ranks of the cells, owners first, with all others added as ghosts of some cells."""
    counts = np.diff(found.offsets)
    cell, rank = np.repeat(np.arange(len(counts)), counts), np.asarray(found.array)
    owner = rank[found.offsets[:-1]]
    more = np.flatnonzero(chosen)
    others = np.tile(np.arange(parts, dtype=np.int32), (len(more), 1))
    others = others[others != owner[more][:, None]].reshape(len(more), parts - 1)
    kept = ~chosen[cell]
    cells = np.concatenate([cell[kept], more, np.repeat(more, parts - 1)])
    ranks = np.concatenate([rank[kept], owner[more], others.ravel()]).astype(np.int32)
    order = np.argsort(cells, kind="stable")
    offsets = np.concatenate([[0], np.cumsum(np.bincount(cells, minlength=len(counts)))])
    return AdjacencyList_int32(ranks[order], offsets.astype(np.int32))


def slabs(coordinate: NDArray[np.float64]) -> GraphPartitioner:
    """A graph partitioner into slabs across one direction with equal numbers of cells.

    If a body and its interfaces extend along this direction, every part has its share of both; with
    many parts the cuts are larger than those of a graph partitioner.

    Args:
        coordinate: Coordinate of all cells along the direction [mm], in the order in which one rank
            passes them to ``create_mesh``; empty on the other ranks.
    """

    def partition(comm: MPI.Comm, parts: int, graph: Any, ghosting: bool) -> Any:
        cells = len(coordinate)
        part = np.empty(cells, dtype=np.int32)
        part[np.argsort(coordinate, kind="stable")] = np.arange(cells) * parts // max(cells, 1)
        # A cell belongs to its own part and is a ghost of those of its neighbours.
        own = np.column_stack([np.arange(cells), part])
        cell = np.repeat(np.arange(cells), np.diff(graph.offsets))
        near = np.unique(np.column_stack([cell, part[np.asarray(graph.array)]]), axis=0)
        near = near[near[:, 1] != part[near[:, 0]]] if ghosting else near[:0]
        rows = np.concatenate([own, near])
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        offsets = np.concatenate([[0], np.cumsum(np.bincount(rows[:, 0], minlength=cells))])
        return AdjacencyList_int32(rows[:, 1].astype(np.int32), offsets.astype(np.int32))

    return partition
