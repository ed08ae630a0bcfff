"""Mesh partitions that balance both bodies and interfaces between ranks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx.cpp.graph import AdjacencyList_int32, AdjacencyList_int64
from dolfinx.graph import partitioner
from numpy.typing import NDArray

#: Communicator, number of parts, graph of the cells, whether ghosts are wanted; parts of the cells.
GraphPartitioner = Callable[[MPI.Comm, int, Any, bool], Any]

Weigh = Callable[[NDArray[np.int64], NDArray[np.int32]], NDArray[np.int32]]


def weighted(weigh: Weigh) -> GraphPartitioner:
    """A graph partitioner with cell weights.

    DOLFINx's partitioners take no weights. So a cell of weight w is given w - 1 leaves, graph nodes
    connected to the cell only: parts with equal numbers of nodes have equal weights, and minimising
    cut edges keeps leaves and cell together. For ``create_cell_partitioner`` of DOLFINx.

    Args:
        weigh: Integer weights of the cells, at least 1, from the neighbours of this rank's cells
            and their offsets.
    """

    def partition(comm: MPI.Comm, parts: int, graph: Any, ghosting: bool) -> Any:
        cells = len(graph.offsets) - 1
        leaves = weigh(graph.array, graph.offsets) - 1
        found = partitioner()(comm, parts, with_leaves(comm, graph, leaves), ghosting)
        offsets = found.offsets[: cells + 1]
        return AdjacencyList_int32(found.array[: offsets[-1]], offsets)

    return partition


def with_leaves(comm: MPI.Comm, graph: Any, leaves: NDArray[np.int32]) -> AdjacencyList_int64:
    """The graph with this number of leaves at every node; the leaves of a rank follow its nodes."""
    nodes, new = len(leaves), int(leaves.sum())
    counts = np.array(comm.allgather((nodes, new)))
    before = np.concatenate([np.zeros((1, 2), dtype=np.int64), np.cumsum(counts, axis=0)])
    first = before[comm.rank].sum()
    neighbours = np.asarray(graph.array)
    owner = np.searchsorted(before[:, 0], neighbours, side="right") - 1
    parents = np.repeat(np.arange(nodes), leaves)
    names = np.arange(new) + nodes
    begins = np.concatenate([np.repeat(np.arange(nodes), np.diff(graph.offsets)), parents, names])
    ends = np.concatenate([neighbours + before[owner, 1], first + names, first + parents])
    order = np.argsort(begins, kind="stable")
    offsets = np.concatenate([[0], np.cumsum(np.bincount(begins, minlength=nodes + new))])
    return AdjacencyList_int64(ends[order].astype(np.int64), offsets.astype(np.int32))


def between_bodies(tags: NDArray[np.int32], weight: int) -> Weigh:
    """Give cells next to another body a weight, all others weight 1.

    Args:
        tags: Bodies of all cells, in the order in which one rank passes them to ``create_mesh``.
        weight: Weight of cells at interfaces.

    Raises:
        ValueError: a weight below 1.
    """
    if weight < 1:
        raise ValueError(f"between_bodies: weight = {weight} must be at least 1")

    def weigh(neighbours: NDArray[np.int64], offsets: NDArray[np.int32]) -> NDArray[np.int32]:
        count = np.diff(offsets)
        cells = np.repeat(np.arange(len(count)), count)
        weights = np.ones(len(count), dtype=np.int32)
        weights[cells[tags[cells] != tags[neighbours]]] = weight
        return weights

    return weigh


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
