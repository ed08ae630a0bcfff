"""Tangent of the numerical flux of bodies whose stress is computed at points.

The traction of such a side at a facet point p is the stress of its cell, extrapolated,
P_a.N = sum_q E_pq P_q.N, and depends on u through the strain of all points q of the cell:

    d(P_a.N) = sum_q E_pq (C_q : GRAD du(X_q)).N.

:mod:`vmdg.interface.tangent` has (A_p : GRAD du(X_p)).N in its place, with the moduli of the
adjoint term, A_p = sum_q E_pq A_q of the last given load factor. The difference multiplies
the derivative of the residual by {P.N}: with d zeta = C.dT of (84) and the couple M of a rotating
frame,

    L(eta) = g(eta) - Tt(eta).C - S(eta):dM/dT.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..base.arrays import joined_axes
from ..domain.materials import Bodies
from ..domain.shapes import ShapeGradients
from ..points.facets import InterfaceFacets
from ..points.jets import FacetJets, Field
from .active import ActiveInterface
from .frame import TurningTangent

Array = NDArray[np.float64]

#: Number of matrix entries per batch of facets along a gradient.
_MOST = 60_000


class _Piece(NamedTuple):
    """Change of {P.N} on some facets by the dofs of one side."""

    side: int
    facets: NDArray[np.integer]  # The facets (f,)
    cells: NDArray[np.int32]  # Their cells on that side (f,)
    points: NDArray[np.integer]  # Points of the facets (f, p)
    flux: Array  # Change of {P.N} (f, p, d, n)


class FluxChange(NamedTuple):
    """What the flux of bodies at points changes in the tangent of an interface."""

    of: PointFlux
    load: Array  # L dA (nq, jet, d)

    def add_to(self, matrices: Array, rows: slice, B: Array, trial: Field) -> None:
        """Add to the matrices of some facets (f, m, n), whose columns are those of both sides."""
        for piece in self.of.pieces(rows, trial):
            facets, width = piece.facets - rows.start, piece.flux.shape[-1]
            # The dofs of its own side, or of both.
            first = piece.side * (matrices.shape[2] - width)
            left = self.load[piece.points].transpose(0, 1, 3, 2) @ B[facets]
            # Sums over the points of a facet and its tractions in one product.
            count, size = len(left), left.shape[1] * left.shape[2]
            left, flux = (part.reshape(count, size, part.shape[-1]) for part in (left, piece.flux))
            matrices[facets, :, first : first + width] += left.transpose(0, 2, 1) @ flux

    def along(self, gradient: Array) -> Array:
        """The change times E.X, conjugate to jets at the points (nq, jet)."""
        result = np.zeros(self.load.shape[:2])
        for piece in self.of.all_pieces(partial(FacetJets.uniform, gradient=gradient)):
            result[piece.points] += (self.load[piece.points] @ piece.flux)[..., 0]
        return result

    def adjoint_along(
        self, gradient: Array, trial: Field
    ) -> Iterator[tuple[NDArray[np.int32], Array]]:
        """Cells and forces (f, n) on a field in them: the transposed change times E.X."""
        tractions = self.of.active.point_tangent.jets.of_gradient(gradient) @ self.load
        for piece in self.of.all_pieces(trial):
            forces = np.einsum("fpi,fpin->fn", tractions[piece.points], piece.flux, optimize=True)
            yield piece.cells, forces


class PointFlux:
    """The part of the tangent of one interface that :class:`.PointTangent` lacks."""

    def __init__(self, active: ActiveInterface, u: fem.Function, bodies: Bodies):
        self.active, self._bodies = active, bodies.points
        space, geometry = u.function_space, active.quadrature.geometry
        self.d = active.quadrature.d
        self._degree = space.ufl_element().degree
        self._shapes = ShapeGradients(space.mesh, geometry, self._degree)
        self._facets: InterfaceFacets | None = None
        self._sides: list[tuple[int, NDArray, NDArray, Array, Array, Array]] = []

    def _take_facets(self) -> None:
        quadrature, gradients = self.active.quadrature, self.active.point_tangent.jets.gradients
        self._facets, self._sides = quadrature.facets, []
        for a, places in enumerate(quadrature.places()):
            rows = np.flatnonzero(self._bodies.has(quadrature.facets.cells[:, a]))
            if not len(rows):  # basix has no values at no points
                continue
            cells, there = quadrature.facets.cells[rows, a], places[rows]
            basis = self._bodies.element.tabulate(0, there.reshape(-1, self.d))[0]
            E = basis.reshape(*there.shape[:2], basis.shape[-1]) @ self._bodies.extrapolation
            inside = self._shapes.in_cells(cells)[0]
            self._sides.append((a, rows, cells, E, inside, gradients[rows, :, a]))

    def __call__(
        self, stabilized: Array, compliance: Array | None, turning: TurningTangent | None
    ) -> FluxChange:
        """The change at the state of a tangent.

        Args:
            stabilized: Tt dA (nq, d, jet).
            compliance: C = d zeta/dT (nq, d, d) [mm3/N]; None fixes zeta.
        """
        if self._facets is not self.active.quadrature.facets:
            self._take_facets()
        tangent, d = self.active.point_tangent, self.d
        jets, areas = tangent.jets, tangent.areas
        L = np.zeros((len(areas), jets.size, d))
        L[:, :d] = areas[:, None, None] * np.eye(d)
        if compliance is not None:
            L -= stabilized.transpose(0, 2, 1) @ compliance
        if turning is not None:
            couple = turning[1].reshape(-1, d * d, d)
            for side, leads in enumerate(self.active.quadrature.leads.T):
                first = d + side * len(jets.entries)
                L[:, first : first + d * d] -= (2 * leads * areas)[:, None, None] * couple
        return FluxChange(self, L)

    def all_pieces(self, trial: Field) -> Iterator[_Piece]:
        count = max(_MOST // (2 * (self.active.point_tangent.jets.nodes * self.d) ** 2), 1)
        for start in range(0, len(self.active.facets.facets), count):
            yield from self.pieces(slice(start, start + count), trial)

    def pieces(self, facets: slice, trial: Field) -> Iterator[_Piece]:
        """{P.N} by a field, on those sides of some facets that are at points."""
        for number, (_, rows, *_) in enumerate(self._sides):
            some = slice(*np.searchsorted(rows, (facets.start, facets.stop)))
            if some.start < some.stop:
                yield self._piece(number, some, trial)

    def _piece(self, number: int, some: slice, trial: Field) -> _Piece:
        quadrature, jets = self.active.quadrature, self.active.point_tangent.jets
        a, rows, cells, E, inside, there = self._sides[number]
        chosen, of = rows[some], cells[some]
        points = quadrature.points_of_facet[chosen]
        if trial is FacetJets.displacement:
            inner, outer = (self._gradient_entries(G[some]) for G in (inside, there))
        else:
            first = self.d + a * len(jets.entries)
            inner = outer = trial(jets, chosen).matrix[:, :1, first : first + len(jets.entries)]
        change = self._flux_change(of, E[some], inner, outer)
        weights = self.active.stabilization.weights[chosen, a]
        # Of side 2 with the normal of side 1, and its own area.
        normal = _normal_rows((1 - 2 * a) * quadrature.outward[a][points], jets.entries)
        flux = np.einsum("fij,fpje->fpie", weights, normal) @ change
        return _Piece(a, chosen, of, points, flux)

    def _gradient_entries(self, gradients: Array) -> Array:
        """Entries of GRAD w by the dofs of cells (f, points, entries, n)."""
        return joined_axes(self.active.point_tangent.jets.gradient_entries(gradients), 3)

    def _flux_change(
        self, cells: NDArray[np.int32], E: Array, inside: Array, there: Array
    ) -> Array:
        """sum_q E_pq C_q : GRAD w(X_q) - A_p : GRAD w(X_p) by dofs (f, p, entries, n), from entries
        of GRAD w in the cells and on the facets."""
        current = _combined(E, self._bodies.flux_moduli_in(cells) @ inside)
        return current - _combined(E, self._bodies.frozen_in(cells)) @ there


def _combined(E: Array, values: Array) -> Array:
    """sum_q E_pq X_q (f, p, ...); as one product of matrices, several times as fast as einsum."""
    return (E @ joined_axes(values, 2)).reshape(*E.shape[:2], *values.shape[2:])


def _normal_rows(N: Array, entries: list[tuple[int, int]]) -> Array:
    """P -> P.N for the entries of P (..., d, entries)."""
    d = N.shape[-1]
    rows = np.zeros((*N.shape, len(entries)))
    for number, (i, j) in enumerate(entries[: d * d]):
        rows[..., i, number] = N[..., j]
    return rows
