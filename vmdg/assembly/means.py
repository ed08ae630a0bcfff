"""The space of a body with unknown means: a periodic cell, or generalized plane strain.

The displacement of a cell with sides a_i is

    u = H.X + w,    w(X + a_i) = w(X),    H = F_bar - I,

X from the centre of the cell. Opposite points share a dof of w; dofs are merged after the space has
been broken, so interfaces may cross the boundary: at a node of an interface, copies of the same
side are merged.

Column j of H is the displacement of an additional node j outside all cells, q_j = l H.e_j [mm],
with l the size of the cell. These displacements are treated like those of other nodes: they may be
prescribed, unknown, or followed along a path. The force conjugate to q_j is V P_bar.e_j / l, with
P_bar the mean stress.

In generalized plane strain F_33 - 1 is treated in the same way: an additional node, in periodic
cells and other bodies, has q = l (F_33 - 1) as its first displacement; the second one is fixed.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from dolfinx import fem, la
from dolfinx.mesh import exterior_facet_indices
from numpy.typing import NDArray

from ..base.graph import components
from ..base.parallel import global_sum
from ..base.tables import rounded
from ..domain.lattice import Lattice
from ..domain.topology import box_sides, facet_cells, local_facets
from .space import facet_closure, renumbered

Array = NDArray[np.float64]


class MeanSpace:
    """The space of a displacement and of nodes outside all cells, whose displacements are means.

    Attributes:
        nodes: Node of ``space`` for every local node of ``broken``.
        length: l [mm].
        entries: (i, j) of the means H_ij; (2, 2) is F_33 - 1.
        dofs: Local dofs (component-wise numbers) of the means, on every rank; owned by the first
            rank.
        anchor: Local dofs of one node of a periodic cell, whose w is determined up to a translation
            in statics.
        fixed: Local dofs that are zero in statics: :attr:`anchor`, and :attr:`spare`.
        x: Positions of the nodes of ``broken`` from the centre of the cell (n, d) [mm].
    """

    def __init__(self, broken: fem.FunctionSpace, lattice: Lattice | None, axial: bool):
        self.lattice, self.broken = lattice, broken
        mesh, imap = broken.mesh, broken.dofmap.index_map
        self._comm, self._d = mesh.comm, mesh.geometry.dim
        d = self._d
        x = broken.tabulate_dof_coordinates()[:, :d]
        self.entries = [] if lattice is None else list(product(range(d), repeat=2))
        self.entries += [(2, 2)] * axial
        columns = sorted({j for _, j in self.entries})
        none = np.zeros(0, dtype=np.int64)
        merged = (none, none) if lattice is None else _merged(broken, lattice)
        numbers, size_local, more = self._number(*merged, len(columns))
        self.space, nodes = renumbered(broken, numbers[broken.dofmap.list], size_local, more)
        of_column = dict(zip(columns, nodes * d, strict=True))
        dofs = [of_column[j] + (i if j < d else 0) for i, j in self.entries]
        self.dofs = np.array(dofs, dtype=np.int32)
        self.rows = (nodes[:, None] * d + np.arange(d, dtype=np.int32)).ravel()
        self.nodes = np.zeros(imap.size_local + imap.num_ghosts, dtype=np.int32)
        self.nodes[broken.dofmap.list] = self.space.dofmap.list
        self.spare, self.anchor = np.setdiff1d(self.rows, self.dofs), np.zeros(0, dtype=np.int32)
        self.x, self.length = x, float(np.sqrt(np.prod(box_sides(mesh)[:d])))
        if lattice is not None:
            self.x, self.length = x - lattice.centre, lattice.length
            first = np.unique(self.nodes[numbers == self._first_node(numbers)])
            self.anchor = (first[:, None] * d + np.arange(d, dtype=np.int32)).ravel()
        self.fixed = np.concatenate([self.spare, self.anchor])
        self._whole = fem.Function(broken, name="displacement")
        self._forces = np.zeros_like(self._whole.x.array)

    def _number(
        self, merged: NDArray[np.int64], names: NDArray[np.int64], more: int
    ) -> tuple[NDArray[np.int64], int, NDArray[np.int64]]:
        """New number of every local node, number of owned nodes, and numbers of the additional
        nodes."""
        comm, imap = self._comm, self.broken.dofmap.index_map
        count = imap.size_local + imap.num_ghosts
        known = imap.local_to_global(np.arange(count, dtype=np.int32))
        has_image, name = np.isin(known, merged), known.copy()
        name[has_image] = names[np.searchsorted(merged, known[has_image])]
        kept = (name == known)[: imap.size_local]
        size_local = int(kept.sum()) + more * (comm.rank == 0)
        first = int(comm.scan(size_local)) - size_local
        numbers = la.vector(imap, dtype=np.int64)
        numbers.array[: imap.size_local][kept] = first + np.arange(kept.sum())
        numbers.scatter_forward()
        # Owners broadcast the new numbers of nodes with images.
        mine = np.flatnonzero(kept & has_image[: imap.size_local])
        told = comm.allgather((known[mine], numbers.array[mine]))
        owners_names, owners_numbers = (np.concatenate(parts) for parts in zip(*told, strict=True))
        order = np.argsort(owners_names)
        found = np.searchsorted(owners_names, name[has_image], sorter=order)
        numbers.array[has_image] = owners_numbers[order[found]]
        end = comm.bcast(size_local)
        return numbers.array, size_local, np.arange(end - more, end)

    def _first_node(self, numbers: NDArray[np.int64]) -> int:
        """Number of the node that comes first along the first side, then the second, ...;
        collective.

        It is independent of the partition, except for copies at a crossing of interfaces.
        """
        at = np.round(self.lattice.fractions(self.x + self.lattice.centre), 9) + 0.0
        first: tuple = (np.inf,)
        if len(at):
            order = np.lexsort([numbers, *at.T[::-1]])[0]
            first = (*at[order], numbers[order])
        return int(min(self._comm.allgather(first))[-1])

    # Means

    @property
    def owned_dofs(self) -> NDArray[np.int32]:
        """Those of :attr:`dofs` that this rank owns, all or none."""
        return self.dofs if self._comm.rank == 0 else self.dofs[:0]

    @property
    def owned_rows(self) -> NDArray[np.int32]:
        return self.rows if self._comm.rank == 0 else self.rows[:0]

    def unit_vectors(self, dofs: NDArray[np.int32]) -> Array:
        """Unit vectors of some :attr:`dofs` (n,), numbered as on the first rank, over owned dofs
        (n, owned)."""
        imap = self.space.dofmap.index_map
        vectors = np.zeros((len(dofs), imap.size_local * self._d))
        if self._comm.rank == 0:
            vectors[np.arange(len(dofs)), dofs] = 1.0
        return vectors

    def gradient(self, vector: Array) -> Array:
        """H (n, n), n = 3 with F_33, from a vector over local dofs with updated ghosts."""
        return self.tensor(vector[self.dofs] / self.length)

    def gradient_of_owned(self, vector: Array) -> Array:
        """H (n, n) from a vector over owned dofs; collective."""
        return self.tensor(self._at_owner(vector) / self.length)

    def forces_on_means(self, vector: Array) -> Array:
        """Forces on H (n, n) from a vector of forces over owned or local dofs; collective [N
        mm]."""
        return self.tensor(self._at_owner(vector) * self.length)

    def _at_owner(self, vector: Array) -> Array:
        mine = np.zeros(len(self.dofs))
        if self._comm.rank == 0:
            mine = vector[self.dofs]
        return global_sum(self._comm, mine)

    def tensor(self, values: Array) -> Array:
        """The tensor (n, n) with these values at :attr:`entries`, zero elsewhere."""
        n = max(self._d, 1 + max(i for i, _ in self.entries))
        result = np.zeros((n, n))
        result[tuple(np.transpose(self.entries))] = values
        return result

    def displacement(self, vector: Array) -> fem.Function:
        """u = H.X + w from a vector over local dofs; every call returns the same function [mm]."""
        u, d = self._whole.x.array.reshape(-1, self._d), self._d
        u[:] = vector.reshape(-1, d)[self.nodes] + self.x @ self.gradient(vector)[:d, :d].T
        return self._whole

    def shifts(self) -> tuple[NDArray[np.int32], Array]:
        """Nodes of ``broken`` on this rank whose position differs from that on the owner of their
        node of w, with both positions (n, d) from the centre of the cell [mm]; collective."""
        places = fem.Function(self.space).x
        at = places.array.reshape(-1, self._d)
        at[self.nodes] = self.x
        places.scatter_forward()
        away = np.abs(at[self.nodes] - self.x).max(axis=1, initial=0.0)
        moved = np.flatnonzero(away > self.lattice.tolerance).astype(np.int32)
        return moved, np.stack([at[self.nodes[moved]], self.x[moved]])

    # Forces

    def clear_forces(self) -> Array:
        """A zero vector over local dofs of ``broken`` for the assembly of nodal forces."""
        self._forces[:] = 0
        return self._forces

    def add_forces(self, forces: Array, axial: float, vector: Array) -> None:
        """Add nodal forces f on ``broken``: on w their sums, on q_j sum_n f_n X_nj / l, and this
        rank's force on F_33 [N mm], to a vector before ghosts are added to owners."""
        f, total = forces.reshape(-1, self._d), vector.reshape(-1, self._d)
        np.add.at(total, self.nodes, f)
        moments = f.T @ self.x
        for dof, (i, j) in zip(self.dofs, self.entries, strict=True):
            vector[dof] += (moments[i, j] if j < self._d else axial) / self.length


def lattice_of(means: MeanSpace | None) -> Lattice | None:
    """Lattice of a periodic cell; None for a body with a surface."""
    return None if means is None else means.lattice


def _merged(
    broken: fem.FunctionSpace, lattice: Lattice
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Global nodes with images, ascending, and the smallest of all their images; collective."""
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
    # A node and its image have the same position relative to the midpoint of the facet.
    from_middle = x - x.mean(axis=1, keepdims=True)
    apart = np.linalg.norm(from_middle[low][:, :, None] - from_middle[high][:, None], axis=-1)
    _check_nodes(x[low], apart, lattice.tolerance)
    image = np.take_along_axis(names[high], apart.argmin(axis=2), axis=1)
    pairs = np.column_stack([names[low].ravel(), image.ravel()])
    merged, index = np.unique(pairs, return_inverse=True)
    component = components(*index.reshape(pairs.shape).T, len(merged))
    # The first node of each component in ascending order is the smallest.
    return merged, merged[np.unique(component, return_index=True)[1]][component]


def _check_nodes(x: Array, apart: Array, tolerance: float) -> None:
    nearest = apart.min(axis=2, initial=np.inf)
    bad = np.argwhere(nearest > tolerance)
    if len(bad):
        place = rounded(x[tuple(bad[0])])
        raise ValueError(
            f"Periodic: the node at {place} has no image on the opposite face, whose facets have "
            "other corners there; opposite faces must have the same mesh, in gmsh by "
            "gmsh.model.mesh.setPeriodic before the mesh is generated"
        )
