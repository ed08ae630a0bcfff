"""The broken space: continuous inside every body, discontinuous across cut facets only."""

from __future__ import annotations

from collections.abc import Iterable

import basix
import numpy as np
from dolfinx import cpp, fem, la
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from .. import compat
from ..base.graph import components
from ..base.parallel import global_any, global_sum, group_maxima, index_map_of
from ..domain.topology import facet_cells, local_facets
from ..points.facets import InterfaceFacets


def broken_space(
    mesh: Mesh, degree: int, cut: NDArray[np.int32], scalar: bool = False
) -> fem.FunctionSpace:
    """Lagrange space, of vectors by default, that may jump across the facets ``cut``: (8)-(9), and
    (43).

    Every pair (cell, dof) at a dof of a cut facet is a node of a graph. The uncut interior facets
    connect the graph nodes shared by their two cells, and each connected component becomes one dof.
    This handles cracks that end inside a body: around the tip the cells stay connected, so the tip
    has a single dof.

    In parallel a component is named by its smallest (global cell, dof) and belongs to the rank that
    owns this cell; names are exchanged between owners and ghosts of cells until nothing changes.

    Returns:
        A space with the dofs of the continuous one and the duplicates on the cut facets.
    """
    shape = () if scalar else (mesh.geometry.dim,)
    space = fem.functionspace(mesh, ("Lagrange", degree, shape))
    if not global_any(mesh.comm, len(cut) > 0):
        return space
    pairs = facet_cells(mesh)
    dofs = space.dofmap.index_map
    split = np.zeros(dofs.size_local + dofs.num_ghosts, dtype=bool)
    split[fem.locate_dofs_topological(space, mesh.topology.dim - 1, cut)] = True
    nodes = split[space.dofmap.list]
    component = _components(space, nodes, split, cut, pairs)
    global_dofs, size_local = _number(space, nodes, split, component)

    return renumbered(space, global_dofs, size_local)[0]


def renumbered(
    space: fem.FunctionSpace,
    numbers: NDArray[np.int64],
    size_local: int,
    more: NDArray[np.int64] | None = None,
) -> tuple[fem.FunctionSpace, NDArray[np.int32]]:
    """A space with other global numbers of the dofs of every local cell (cells, dofs of a cell),
    and the local numbers in it of ``more``, dofs outside all cells, on every rank; collective.

    This rank owns ``size_local`` dofs, numbered consecutively, rank by rank.
    """
    more = np.zeros(0, dtype=np.int64) if more is None else more
    every = np.concatenate([numbers.ravel(), more])
    imap, local = index_map_of(space.mesh.comm, size_local, every)
    local, of_more = local[: numbers.size].reshape(numbers.shape), local[numbers.size :]
    dofmap = cpp.fem.DofMap(
        space.dofmap.dof_layout,
        imap,
        space.dofmap.index_map_bs,
        cpp.graph.AdjacencyList_int32(local),
        space.dofmap.bs,
    )
    return compat.function_space_with_dofmap(space, dofmap), of_more


def facet_closure(space: fem.FunctionSpace) -> NDArray[np.int32]:
    layout = space.dofmap.dof_layout
    fdim = space.mesh.topology.dim - 1
    facets = basix.topology(space.mesh.basix_cell())[fdim]
    return np.array(
        [layout.entity_closure_dofs(fdim, f) for f in range(len(facets))], dtype=np.int32
    )


def _components(
    space: fem.FunctionSpace,
    nodes: NDArray[np.bool_],
    split: NDArray[np.bool_],
    cut: NDArray[np.int32],
    pairs: NDArray[np.int32],
) -> NDArray[np.int32]:
    """Component of every node (in row-major order of ``nodes``) within this rank's cells."""
    dofs = space.dofmap.list
    kept = (pairs >= 0).all(axis=1)
    kept[cut] = False
    near = nodes.any(axis=1)
    kept &= near[pairs].all(axis=1)
    facets = np.flatnonzero(kept).astype(np.int32)
    closure = facet_closure(space)
    positions = [closure[local_facets(space.mesh, pairs[facets, a], facets)] for a in range(2)]
    values = [dofs[pairs[facets, a][:, None], positions[a]] for a in range(2)]
    same = (values[0][:, :, None] == values[1][:, None, :]) & split[values[0]][:, :, None]
    facet, i, j = np.nonzero(same)
    number = np.cumsum(nodes.ravel()).reshape(nodes.shape) - 1
    start = number[pairs[facets[facet], 0], positions[0][facet, i]]
    end = number[pairs[facets[facet], 1], positions[1][facet, j]]
    return components(start, end, int(nodes.sum()))


def _number(
    space: fem.FunctionSpace,
    nodes: NDArray[np.bool_],
    split: NDArray[np.bool_],
    component: NDArray[np.int32],
) -> tuple[NDArray[np.int64], int]:
    """Global dof of every (cell, dof), and the number owned by this rank.

    A rank owns its unsplit dofs and the components whose name is in its cells. It numbers them in
    the order of the continuous space, with duplicates next to each other: this keeps neighbours
    together, which benefits assembly, factorizations and smoothers.
    """
    mesh, dofs = space.mesh, space.dofmap.list
    cells = mesh.topology.index_map(mesh.topology.dim)
    local_cells = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    names = cells.local_to_global(local_cells)[:, None] * dofs.shape[1] + np.arange(dofs.shape[1])
    smallest = -group_maxima(mesh.comm, cells, -names, nodes, component)
    is_root = nodes & (smallest == names)
    is_root[cells.size_local :] = False

    owned = space.dofmap.index_map.size_local
    kept = ~split[:owned]
    size_local = int(kept.sum() + is_root.sum())
    first = int(mesh.comm.scan(size_local)) - size_local
    place = np.argsort(np.concatenate([np.flatnonzero(kept), dofs[is_root]]), kind="stable")
    number = np.empty(size_local, dtype=np.int64)
    number[place] = first + np.arange(size_local)
    unsplit = la.vector(space.dofmap.index_map, dtype=np.int64)
    unsplit.array[:owned][kept] = number[: kept.sum()]
    unsplit.scatter_forward()

    numbers = np.full(names.shape, -1, dtype=np.int64)
    numbers[is_root] = number[kept.sum() :]
    _, group = np.unique(smallest[nodes], return_inverse=True)
    numbers = group_maxima(mesh.comm, cells, numbers, nodes, group)
    return np.where(nodes, numbers, unsplit.array[dofs]), size_local


def node_pieces(
    space: fem.FunctionSpace, joined: Iterable[NDArray[np.int32]] = ()
) -> NDArray[np.int64]:
    """Name of the connected piece of every local node: its last node over all ranks; collective.

    A piece is a set of cells connected by nodes of the space.
    """
    dofs = space.dofmap.list
    first = dofs[:, 0]
    pairs = [first[cells] for cells in joined]
    starts = [np.repeat(first, dofs.shape[1] - 1), *(pair[:, 0] for pair in pairs)]
    ends = [dofs[:, 1:].ravel(), *(pair[:, 1] for pair in pairs)]
    return _connected(space, np.concatenate(starts), np.concatenate(ends))


def facet_pieces(
    space: fem.FunctionSpace, interfaces: Iterable[InterfaceFacets]
) -> list[NDArray[np.int64]]:
    """Name of the connected piece of some interfaces, at least one, to which each of their facets
    belongs; collective.

    Facets are connected if they share a node of the space, on either side.
    """
    closure, dofs = facet_closure(space), space.dofmap.list
    nodes = [
        np.hstack([dofs[one.cells[:, [a]], closure[one.local[:, a]]] for a in range(2)])
        for one in interfaces
    ]
    edges = np.concatenate(nodes)
    starts = np.repeat(edges[:, 0], edges.shape[1] - 1)
    name = _connected(space, starts, edges[:, 1:].ravel())
    return [name[of_facet[:, 0]] for of_facet in nodes]


def _connected(
    space: fem.FunctionSpace, starts: NDArray[np.integer], ends: NDArray[np.integer]
) -> NDArray[np.int64]:
    """Name of the connected component of every local node, for edges between them: its last node
    over all ranks; collective."""
    nodes = space.dofmap.index_map
    size = nodes.size_local + nodes.num_ghosts
    piece = components(starts, ends, size)
    names = nodes.local_to_global(np.arange(size, dtype=np.int32))[:, None]
    everywhere = np.ones_like(names, dtype=bool)
    return group_maxima(space.mesh.comm, nodes, names, everywhere, piece)[:, 0]


def count_pieces(space: fem.FunctionSpace) -> int:
    """Number of pieces of the mesh that share no node of a space, over all ranks; collective."""
    owned = np.arange(space.dofmap.index_map.size_local, dtype=np.int32)
    names = space.dofmap.index_map.local_to_global(owned)
    return int(global_sum(space.mesh.comm, (node_pieces(space)[owned] == names).sum()))


def at_owners(space: fem.FunctionSpace, vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """An assembled vector on owned dofs, with ghost contributions added; collective."""
    total = la.vector(space.dofmap.index_map, space.dofmap.index_map_bs)
    total.array[:] = vector
    total.scatter_reverse(la.InsertMode.add)
    return total.array[: space.dofmap.index_map.size_local * space.dofmap.index_map_bs]
