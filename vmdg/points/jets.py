"""Jets of displacements at the facet points, as used by the interface terms, in matrix form.

The terms depend on a field w through its jet

    j(w) = (g(w), GRAD w_1, GRAD w_2),   g(w) = w_2 - w_1,

the opening and those entries of the gradients that do not vanish identically. With j = B.w for the
dofs w of the two cells at a facet, a bilinear form of jets j(eta).D.j(du) has the matrix B^T.D.B.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..forms.geometry import Axisymmetric, Geometry
from .facets import InterfaceFacets

Array = NDArray[np.float64]


class Block(NamedTuple):
    """The jets of a field on some facets."""

    blocks: NDArray[np.int32]  # Local nodes of the two cells, or the cells themselves (f, n)
    matrix: Array  # B (f, points per facet, jet, n times the components of a block)


class FacetJets:
    """The jets of displacements, and with mean dilatation those of dilatations, on all facets.

    Attributes:
        entries: (i, j) of the entries of GRAD w in a jet.
        values: Shape functions (nf, points, 2 sides, nodes).
        gradients: Their gradients (nf, points, 2 sides, nodes, d or d + 1), N/r last.
    """

    def __init__(
        self,
        space: fem.FunctionSpace,
        geometry: Geometry,
        facets: InterfaceFacets,
        shapes: Sequence[tuple[Array, Array]],
    ):
        self._d = space.mesh.geometry.dim
        self.space, self._dofs, self._facets = space, space.dofmap.list, facets
        self.index_map = space.dofmap.index_map
        self.nodes = self._dofs.shape[1]
        self.entries = geometry.entries(self._d)
        self.size = self._d + 2 * len(self.entries)
        self._hoop = isinstance(geometry, Axisymmetric)
        values, gradients = zip(*shapes, strict=True)
        self.values, self.gradients = np.stack(values, axis=2), np.stack(gradients, axis=2)

    def of_gradient(self, gradient: Array) -> Array:
        """The uniform jet of E.X: no opening, and E (n, n) on both sides."""
        entries = [gradient[entry] for entry in self.entries]
        return np.concatenate([np.zeros(self._d), entries, entries])

    def uniform(self, rows: slice | NDArray[np.integer], gradient: Array) -> Block:
        """B of the field E.X, one number on which no block depends."""
        jet, (count, points) = self.of_gradient(gradient), self.values[rows].shape[:2]
        B = np.broadcast_to(jet[:, None], (count, points, self.size, 1))
        return Block(np.zeros((count, 0), dtype=np.int32), B)

    def nodes_at(self, rows: slice | NDArray[np.integer]) -> NDArray[np.int32]:
        """Local nodes of the two cells at some facets (f, 2 nodes)."""
        return self.nodes_of(self._facets.cells[rows])

    def nodes_of(self, cells: NDArray[np.int32]) -> NDArray[np.int32]:
        """Local nodes of one or more cells in each row (f, nodes of all)."""
        return self._dofs[cells].reshape(len(cells), int(np.prod(cells.shape[1:])) * self.nodes)

    def displacement(self, rows: slice | NDArray[np.integer]) -> Block:
        """B of the displacement on some facets."""
        d, values, gradients = self._d, self.values[rows], self.gradients[rows]
        count, points, _, nodes, _ = gradients.shape
        B = np.zeros((count, points, self.size, 2, nodes, d))
        for i in range(d):
            B[:, :, i, 0, :, i] = -values[:, :, 0]
            B[:, :, i, 1, :, i] = values[:, :, 1]
        for side in range(2):
            first = d + side * len(self.entries)
            entries = slice(first, first + len(self.entries))
            B[:, :, entries, side] = self.gradient_entries(gradients[:, :, side])
        return Block(self.nodes_at(rows), B.reshape(count, points, self.size, 2 * nodes * d))

    def gradient_entries(self, gradients: Array) -> Array:
        """Entries of GRAD w by the dofs of a cell, (..., entries, nodes, d), from the gradients of
        its shape functions (..., nodes, d or d + 1)."""
        d, nodes = self._d, gradients.shape[-2]
        B = np.zeros((*gradients.shape[:-2], len(self.entries), nodes, d))
        for n, (i, j) in enumerate(self.entries[: d * d]):
            B[..., n, :, i] = gradients[..., j]
        if self._hoop:
            B[..., d * d, :, 0] = gradients[..., d]
        return B

    @cached_property
    def _columns(self) -> Array:
        """Shape functions and their gradients by rows, of products of small matrices (nf, 2 sides,
        points times 1 + slopes, nodes)."""
        both = np.concatenate([self.values[..., None], self.gradients], axis=4)
        count, points, sides, nodes, rows = both.shape
        return both.transpose(0, 2, 1, 4, 3).reshape(count, sides, points * rows, nodes)

    def of_field(self, values: Array) -> tuple[Array, Array]:
        """A displacement on both sides (nf, points, 2, d) [mm], and its entries of GRAD (nf,
        points, 2, entries), at all facets, from its values at the nodes (nodes, d)."""
        d, (count, points, _, _, slopes) = self._d, self.gradients.shape
        found = self._columns @ values[self._dofs[self._facets.cells]]
        found = found.reshape(count, 2, points, 1 + slopes, d).swapaxes(1, 2)
        G = found[..., 1 : 1 + d, :].swapaxes(3, 4).reshape(count, points, 2, d * d)
        if self._hoop:
            G = np.concatenate([G, found[..., 1 + d :, 0]], axis=3)
        return found[..., 0, :], G

    def side_forces(self, tractions: Array) -> Array:
        """Sums of tractions.eta over the points of all facets, tractions with dA on both sides (nf,
        points, 2, d), on the nodes of their cells (nf, 2 nodes, d)."""
        forces = np.einsum("fpan,fpai->fani", self.values, tractions, optimize=True)
        return forces.reshape(len(forces), 2 * self.nodes, self._d)

    def on_dilatation(self, flux: Array) -> Array:
        """What is conjugate to the dilatations of both cells (..., 2) in what is conjugate to jets
        (..., jet)."""
        count = len(self.entries)
        return flux[..., [self._d + count - 1, self._d + 2 * count - 1]]

    def dilatation(self, rows: slice) -> Block:
        """B of the dilatation, one number per cell, the last entry of GRAD."""
        cells = self._facets.cells[rows]
        B = np.zeros((len(cells), self.values.shape[1], self.size, 2))
        for side in range(2):
            B[:, :, self._d + (side + 1) * len(self.entries) - 1, side] = 1.0
        return Block(cells, B)


#: A field by its jets on some facets: :meth:`FacetJets.displacement`, :meth:`FacetJets.dilatation`.
Field = Callable[[FacetJets, slice], Block]
