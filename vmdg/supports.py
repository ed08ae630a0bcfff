"""Which rigid motions of which parts of a problem the prescribed displacements leave free."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .forms.geometry import Axisymmetric
from .parallel import GhostExchange, global_any, global_max
from .problem import Problem
from .topology import facet_cells

#: Eigenvalue, relative to the largest one, below which a rigid motion counts as free: what a node
#: at 1e-5 of the size of a part still resists.
_FREE = 1e-11

_AXES = "xyz"


@dataclass(frozen=True)
class LoosePart:
    """A part of a problem that can move as a rigid body.

    Attributes:
        tags: Tags of its cells.
        motions: What is free, in words.
        cells: Its cells on this rank, ghosts included.
    """

    tags: list[int]
    motions: str
    cells: NDArray[np.int32]


def loose_parts(problem: Problem, cut: NDArray[np.bool_]) -> list[LoosePart]:
    """Parts that keep a rigid motion once an interface is cut; collective.

    Args:
        problem: With all its prescribed displacements.
        cut: Facets through which nothing is held, marked on all local facets of the mesh.
    """
    mesh, comm = problem.mesh, problem.comm
    label = _parts(problem, cut)
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    here = np.unique(np.column_stack([label[:owned], problem.tags[:owned]]), axis=0)
    everywhere = np.unique(np.concatenate(comm.allgather(here)), axis=0)
    parts = np.unique(everywhere[:, 0])
    gram = comm.allreduce(_gram(problem, label, parts))
    result = []
    for part, matrix in zip(parts, gram, strict=True):
        if motions := _free_motions(matrix, problem):
            tags = everywhere[everywhere[:, 0] == part, 1].tolist()
            result.append(LoosePart(tags, motions, np.flatnonzero(label == part).astype(np.int32)))
    return result


def _parts(problem: Problem, cut: NDArray[np.bool_]) -> NDArray[np.int64]:
    """A name of its part for every local cell: its smallest global cell."""
    mesh = problem.mesh
    cells = mesh.topology.index_map(mesh.topology.dim)
    count = cells.size_local + cells.num_ghosts
    pairs = facet_cells(mesh)
    first, second = pairs[(pairs >= 0).all(axis=1) & ~cut].T
    graph = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(count, count))
    number, component = connected_components(graph, directed=False)
    label = cells.local_to_global(np.arange(count, dtype=np.int32))
    exchange = GhostExchange(mesh.comm, cells)
    while True:
        before = label.copy()
        least = np.full(number, np.iinfo(np.int64).max)
        np.minimum.at(least, component, label)
        label = least[component]
        exchange.combine(label, np.minimum)
        if not global_any(mesh.comm, not np.array_equal(label, before)):
            break
    exchange.free()
    return label


def _gram(
    problem: Problem, label: NDArray[np.int64], parts: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Sum of m m^T over this rank's prescribed dofs of every part, m the rigid motions there."""
    space = problem.space
    d = space.dofmap.index_map_bs
    part_of_node = np.zeros(space.tabulate_dof_coordinates().shape[0], dtype=np.int64)
    part_of_node[space.dofmap.list] = np.searchsorted(parts, label)[:, None]
    prescribed = problem.owned_prescribed
    node, component = prescribed // d, prescribed % d
    x = problem.mesh.geometry.x
    size = max(global_max(problem.comm, float(np.abs(x).max(initial=0.0))), np.finfo(float).tiny)
    modes = _rigid_motions(problem, space.tabulate_dof_coordinates()[node] / size, component)
    gram = np.zeros((len(parts), modes.shape[1], modes.shape[1]))
    np.add.at(gram, part_of_node[node], modes[:, :, None] * modes[:, None, :])
    return gram


def _rigid_motions(
    problem: Problem, x: NDArray[np.float64], component: NDArray[np.int32]
) -> NDArray[np.float64]:
    """One component of all rigid motions at points (n, modes): translations, then rotations."""
    d = problem.mesh.geometry.dim
    translations = np.eye(d)[component]
    if isinstance(problem.geometry, Axisymmetric):
        return translations[:, 1:]
    turns = []
    for i, j in combinations(range(d), 2):
        turn = np.zeros((d, d))
        turn[i, j], turn[j, i] = -1.0, 1.0
        turns.append(np.einsum("pk,pk->p", turn[component], x[:, :d]))
    return np.column_stack([translations, *turns])


def _free_motions(gram: NDArray[np.float64], problem: Problem) -> str:
    """Free rigid motions in words; empty where all are held."""
    values = np.linalg.eigvalsh(gram)
    free = int((values <= _FREE * max(values[-1], np.finfo(float).tiny)).sum())
    if not free:
        return ""
    d = problem.mesh.geometry.dim
    held = np.diag(gram) > _FREE * max(values[-1], np.finfo(float).tiny)
    if isinstance(problem.geometry, Axisymmetric):
        return "translation along y"
    names = [f"translation along {_AXES[k]}" for k in range(d) if not held[k]]
    if free > len(names):
        names.append("rotation")
    return ", ".join(names)
