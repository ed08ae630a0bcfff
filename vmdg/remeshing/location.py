"""Where the nodes of a mesh are in another mesh of the same bodies."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from .. import compat
from ..base.parallel import gathered, global_max

Array = NDArray[np.float64]

#: By which part of its distance a node is moved towards the middle of its cell to be found: sides
#: of an interface, which have nodes at one place, do not mix.
_INWARD = 1e-5


class Location:
    """The nodes of a space in the cells of another mesh, on any ranks; collective.

    A node is looked for in the body of its own cell, by tags. Where meshes approximate a curved
    surface, it may be outside of all: then it is in the nearest cell, which is extrapolated.

    Args:
        tags: Of the local cells of the mesh of the space, ghosts included.
    """

    def __init__(
        self,
        space: fem.FunctionSpace,
        tags: NDArray[np.int32],
        mesh: Mesh,
        theirs: NDArray[np.int32],
    ):
        self._space, self._comm = space, mesh.comm
        x, inside, tag = _nodes(space, tags)
        low, high = x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)
        size = global_max(self._comm, (high - low).max(initial=0.0))
        owned = mesh.topology.index_map(mesh.topology.dim).size_local
        # For every tag: nodes here, who has them, what others ask for, where that is.
        self._parts = []
        for value in np.unique(gathered(self._comm, np.unique(tag))):
            rows = np.flatnonzero(tag == value)
            cells = np.flatnonzero(theirs[:owned] == value).astype(np.int32)
            part, parents = compat.cell_submesh(mesh, cells)
            owner, asks, here = compat.point_owners(part, inside[rows], size)
            places = self._sent([x[rows][owner == rank] for rank in range(self._comm.size)])
            self._parts.append((rows, owner, asks, parents[here], np.concatenate(places)))

    def _sent(self, arrays: list[Array]) -> list[Array]:
        return arrays if self._comm.size == 1 else self._comm.alltoall(arrays)

    def values(self, field: fem.Function) -> Array:
        """A vector field on the other mesh at the nodes, local dofs of the space; collective."""
        here = fem.Function(self._space)
        values = here.x.array.reshape(-1, self._space.dofmap.index_map_bs)
        for rows, owner, asks, cells, places in self._parts:
            found = field.eval(places, cells).reshape(len(cells), -1) if len(cells) else places
            ranks = range(self._comm.size)
            sent = self._sent([found[asks == rank] for rank in ranks])
            for rank in ranks:
                values[rows[owner == rank]] = sent[rank][:, : values.shape[1]]
        here.x.scatter_forward()
        return here.x.array


def _nodes(space: fem.FunctionSpace, tags: NDArray[np.int32]) -> tuple[Array, Array, NDArray]:
    """Owned nodes of a space (n, 3), the same moved into a cell, and the tag of that cell (n,)."""
    mesh, dofs = space.mesh, space.dofmap.list
    cells = np.repeat(np.arange(len(dofs)), dofs.shape[1])
    count = space.dofmap.index_map.size_local
    cell = np.zeros(count + space.dofmap.index_map.num_ghosts, dtype=np.intp)
    cell[dofs.ravel()] = cells
    x = space.tabulate_dof_coordinates()[:count]
    middle = mesh.geometry.x[compat.geometry_dofmap(mesh)[cell[:count]]].mean(axis=1)
    return x, x + _INWARD * (middle - x), tags[cell[:count]]
