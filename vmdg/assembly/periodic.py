"""The space of a periodic cell: fluctuations that repeat, and the macroscopic gradient.

The displacement of a cell with sides a_i is

    u = H.X + w,    w(X + a_i) = w(X),    H = F_bar - I,

X from the centre of the cell. What lies opposite is the same dof of w; dofs are merged after the
space has been broken, so interfaces may cross the boundary: at a node of an interface the copy of
one side is merged with that of the same side.

Column j of H is the displacement of one more node j of no cell, q_j = l H.e_j [mm], with l the size
of the cell. All that is done to displacements of nodes can be done to these: they are prescribed,
unknown, followed along a path, and the force that works on q_j is V P_bar.e_j / l, with P_bar the
mean stress.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem, la
from dolfinx.mesh import exterior_facet_indices
from numpy.typing import NDArray

from ..base.graph import components
from ..base.parallel import global_sum
from ..domain.lattice import Lattice
from ..domain.topology import facet_cells, local_facets
from .space import facet_closure, renumbered

Array = NDArray[np.float64]


class PeriodicSpace:
    """The space of w and of the macroscopic nodes.

    Args:
        broken: Space of the whole displacement, in which opposite faces do not know each other.
        lattice: Of the cell.

    Attributes:
        lattice: As given.
        broken: As given.
        space: Of w.
        nodes: Node of ``space`` for every local node of ``broken``.
        macroscopic: Local nodes (d,) of the columns of H, on every rank; the first one owns them.
        held: Local dofs (component-wise numbers) of the one node that is held: w is known but for
            a translation.
        x: Places of the nodes of ``broken`` from the centre of the cell (n, d) [mm].
    """

    def __init__(self, broken: fem.FunctionSpace, lattice: Lattice):
        self.lattice, self.broken = lattice, broken
        mesh, imap = broken.mesh, broken.dofmap.index_map
        self._comm, self._d = mesh.comm, mesh.geometry.dim
        self.x = broken.tabulate_dof_coordinates()[:, : self._d] - lattice.centre
        numbers, size_local, columns = self._number(*_merged(broken, lattice))
        self.space, self.macroscopic = renumbered(
            broken, numbers[broken.dofmap.list], size_local, columns
        )
        self.nodes = np.zeros(imap.size_local + imap.num_ghosts, dtype=np.int32)
        self.nodes[broken.dofmap.list] = self.space.dofmap.list
        first = self._first_node(numbers)
        nodes = np.unique(self.nodes[numbers == first])
        self.held = (nodes[:, None] * self._d + np.arange(self._d, dtype=np.int32)).ravel()
        self._whole = fem.Function(broken, name="displacement")
        self._forces = np.zeros_like(self._whole.x.array)

    def _number(
        self, merged: NDArray[np.int64], names: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], int, NDArray[np.int64]]:
        """New number of every local node, how many this rank owns, and those of the columns of H.

        Args:
            merged: Global nodes that have images, ascending.
            names: The smallest of them and of their images.
        """
        comm, imap = self._comm, self.broken.dofmap.index_map
        count = imap.size_local + imap.num_ghosts
        known = imap.local_to_global(np.arange(count, dtype=np.int32))
        place = np.minimum(np.searchsorted(merged, known), len(merged) - 1)
        has_image = merged[place] == known
        name = np.where(has_image, names[place], known)
        kept = (name == known)[: imap.size_local]
        size_local = int(kept.sum()) + self._d * (comm.rank == 0)
        first = int(comm.scan(size_local)) - size_local
        numbers = la.vector(imap, dtype=np.int64)
        numbers.array[: imap.size_local][kept] = first + np.arange(kept.sum())
        numbers.scatter_forward()
        # Owners tell all what they call the nodes that have images.
        mine = np.flatnonzero(kept & has_image[: imap.size_local])
        told = comm.allgather((known[mine], numbers.array[mine]))
        owners_names, owners_numbers = (np.concatenate(parts) for parts in zip(*told, strict=True))
        order = np.argsort(owners_names)
        found = np.searchsorted(owners_names, name[has_image], sorter=order)
        numbers.array[has_image] = owners_numbers[order[found]]
        end = comm.bcast(size_local)
        return numbers.array, size_local, np.arange(end - self._d, end)

    def _first_node(self, numbers: NDArray[np.int64]) -> int:
        """Number of the node that is first along the first side, then the second, ...; collective.

        It does not depend on the partition, save for copies at a crossing of interfaces.
        """
        at = np.round(self.lattice.fractions(self.x + self.lattice.centre), 9) + 0.0
        first: tuple = (np.inf,)
        if len(at):
            order = np.lexsort([numbers, *at.T[::-1]])[0]
            first = (*at[order], numbers[order])
        return int(min(self._comm.allgather(first))[-1])

    # Macroscopic gradient

    @property
    def dofs(self) -> NDArray[np.int32]:
        """Local dofs of H (d, d): that of H_ij stands in row i, column j."""
        return self.macroscopic * self._d + np.arange(self._d, dtype=np.int32)[:, None]

    @property
    def owned_dofs(self) -> NDArray[np.int32]:
        """Those of :attr:`dofs` that this rank owns, all or none, (n, n)."""
        owns = self._comm.rank == 0
        return self.dofs if owns else np.zeros((0, 0), dtype=np.int32)

    def unit_vectors(self, dofs: NDArray[np.int32]) -> Array:
        """1 at one of some :attr:`dofs` (n,) of the first rank each, over owned dofs (n, owned)."""
        imap = self.space.dofmap.index_map
        vectors = np.zeros((len(dofs), imap.size_local * self._d))
        if self._comm.rank == 0:
            vectors[np.arange(len(dofs)), dofs] = 1.0
        return vectors

    def gradient(self, vector: Array) -> Array:
        """H (d, d) of a vector over local dofs, ghosts up to date."""
        return vector[self.dofs] / self.lattice.length

    def gradient_of_owned(self, vector: Array) -> Array:
        """H (d, d) of a vector over owned dofs; collective."""
        mine = np.zeros((self._d, self._d))
        if self._comm.rank == 0:
            mine = vector[self.dofs]
        return global_sum(self._comm, mine) / self.lattice.length

    def displacement(self, vector: Array) -> fem.Function:
        """u = H.X + w of a vector over local dofs; every call returns the same function [mm]."""
        u = self._whole.x.array.reshape(-1, self._d)
        u[:] = vector.reshape(-1, self._d)[self.nodes] + self.x @ self.gradient(vector).T
        return self._whole

    def shifts(self) -> tuple[NDArray[np.int32], Array]:
        """Nodes of ``broken`` on this rank that lie elsewhere than the owner of their node of w has
        it, and from where (n, d) to where (n, d), from the centre of the cell [mm]; collective."""
        places = fem.Function(self.space).x
        at = places.array.reshape(-1, self._d)
        at[self.nodes] = self.x
        places.scatter_forward()
        away = np.abs(at[self.nodes] - self.x).max(axis=1, initial=0.0)
        moved = np.flatnonzero(away > self.lattice.tolerance).astype(np.int32)
        return moved, np.stack([at[self.nodes[moved]], self.x[moved]])

    # Forces

    def clear_forces(self) -> Array:
        """A vector of zeros over local dofs of ``broken``, to assemble nodal forces in."""
        self._forces[:] = 0
        return self._forces

    def add_forces(self, forces: Array, vector: Array) -> None:
        """Add nodal forces f on ``broken``: on w their sums, on q_j sum_n f_n X_nj / l.

        Args:
            forces: This rank's, over its local dofs [N].
            vector: Over local dofs of ``space``; ghosts still to be added to their owners.
        """
        f, total = forces.reshape(-1, self._d), vector.reshape(-1, self._d)
        np.add.at(total, self.nodes, f)
        total[self.macroscopic] += self.x.T @ f / self.lattice.length


def _merged(
    broken: fem.FunctionSpace, lattice: Lattice
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Global nodes that have images, ascending, and the smallest of all their images; collective.

    Raises:
        ValueError: opposite faces do not match.
    """
    mesh, d, comm = broken.mesh, broken.mesh.geometry.dim, broken.mesh.comm
    mesh.topology.create_connectivity(mesh.topology.dim - 1, mesh.topology.dim)
    facets = exterior_facet_indices(mesh.topology)
    cells = facet_cells(mesh)[facets, 0]
    local = facet_closure(broken)[local_facets(mesh, cells, facets)]
    nodes = broken.dofmap.list[cells[:, None], local]
    x = broken.tabulate_dof_coordinates()[nodes, :d]
    names = broken.dofmap.index_map.local_to_global(nodes.ravel()).reshape(nodes.shape)
    names, x = (np.concatenate(parts) for parts in zip(*comm.allgather((names, x)), strict=True))
    low, high = lattice.images(x).T
    # Of a facet's nodes the image is the one at the same place from its middle.
    from_middle = x - x.mean(axis=1, keepdims=True)
    apart = np.linalg.norm(from_middle[low][:, :, None] - from_middle[high][:, None], axis=-1)
    _check_nodes(x[low], apart, lattice.tolerance)
    image = np.take_along_axis(names[high], apart.argmin(axis=2), axis=1)
    pairs = np.column_stack([names[low].ravel(), image.ravel()])
    merged, index = np.unique(pairs, return_inverse=True)
    component = components(*index.reshape(pairs.shape).T, len(merged))
    # The first of each component in ascending order is its smallest one.
    return merged, merged[np.unique(component, return_index=True)[1]][component]


def _check_nodes(x: Array, apart: Array, tolerance: float) -> None:
    nearest = apart.min(axis=2, initial=np.inf)
    bad = np.argwhere(nearest > tolerance)
    if len(bad):
        place = x[tuple(bad[0])].round(6).tolist()
        raise ValueError(
            f"Periodic: the node at {place} has no image on the opposite face, whose facets have "
            "other corners there; mesh opposite faces alike, in gmsh by "
            "gmsh.model.mesh.setPeriodic before the mesh is generated"
        )
