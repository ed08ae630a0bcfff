"""Tangent of the numerical flux of bodies whose stress is computed at points.

The traction of such a side at a facet point p is the stress of its cell, extrapolated,
P_a.N = sum_q E_pq P_q.N, and depends on u through the strain of all points q of the cell:

    d(P_a.N) = sum_q E_pq (C_q : GRAD du(X_q)).N.

:mod:`vmdg.interface.tangent` has (A_p : GRAD du(X_p)).N in its place, with the moduli of the
adjoint term, A_p = sum_q E_pq A_q of the start of the step. The difference multiplies
the derivative of the residual by {P.N}: with d zeta = C.dT of (84) and the couple M of a rotating
frame,

    L(eta) = g(eta) - Tt(eta).C - S(eta):dM/dT.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..domain.materials import Bodies
from ..domain.shapes import ShapeGradients
from .active import ActiveInterface

Array = NDArray[np.float64]


class PointFlux:
    """The part of the tangent of one interface that :class:`.PointTangent` lacks.

    Args:
        active: The interface.
        u: Displacement.
        bodies: Materials, some of them at points.

    Attributes:
        d: Dimension.
    """

    def __init__(self, active: ActiveInterface, u: fem.Function, bodies: Bodies):
        self._active, self._bodies = active, bodies.points
        quadrature, space = active.quadrature, u.function_space
        facets, d = quadrature.facets, quadrature.d
        self.d = d
        shapes = ShapeGradients(space.mesh, quadrature.geometry, space.ufl_element().degree)
        places = quadrature.points[quadrature.points_of_facet][..., :d]
        self._sides = []
        for a in range(2):
            rows = np.flatnonzero(self._bodies.has(facets.cells[:, a]))
            if not len(rows):  # basix has no values at no points
                continue
            cells, local = facets.cells[rows, a], facets.local[rows, a]
            there = shapes.on_facets(cells, local).at(places[rows])
            reference = np.ascontiguousarray(there.reference.reshape(-1, d))
            basis = self._bodies.element.tabulate(0, reference)[0]
            basis = basis.reshape(*there.reference.shape[:2], -1)
            E = basis @ self._bodies.extrapolation
            self._sides.append((a, rows, cells, E, shapes.in_cells(cells)[0], there.gradients))

    def matrices(
        self, stabilized: Array, compliance: Array | None, couple: Array | None, most: int
    ) -> Iterator[tuple[NDArray[np.int32], NDArray[np.int32], Array]]:
        """Nodes of the rows, nodes of the columns and matrices of batches of facets.

        Args:
            stabilized: Tt dA (nq, d, jet).
            compliance: C = d zeta/dT (nq, d, d) [mm3/N]; None fixes zeta.
            couple: dM/dT of a rotating frame (nq, d d, d); None fixes the frame.
            most: Largest number of entries of the matrices of a batch.
        """
        active, quadrature = self._active, self._active.quadrature
        tangent, d = active.point_tangent, quadrature.d
        jets, areas = tangent.jets, tangent.areas
        L = np.zeros((len(areas), jets.size, d))
        L[:, :d] = areas[:, None, None] * np.eye(d)
        if compliance is not None:
            L -= stabilized.transpose(0, 2, 1) @ compliance
        if couple is not None:
            for side in range(2):
                first = d + side * len(jets.entries)
                L[:, first : first + d * d] -= areas[:, None, None] * couple
        batch = max(most // (2 * (jets.nodes * d) ** 2), 1)
        for a, rows, cells, E, inside, there in self._sides:
            for start in range(0, len(rows), batch):
                some = slice(start, start + batch)
                chosen, of = rows[some], cells[some]
                points = quadrature.points_of_facet[chosen]
                weights = active.stabilization.weights[chosen, a]
                change = self._flux_change(of, E[some], inside[some], there[some])
                flux = np.einsum(
                    "fij,fpje->fpie", weights, _normal_rows(quadrature.normal[points], jets.entries)
                )
                columns = flux @ change
                test = jets.displacement(chosen)
                left = L[points].transpose(0, 1, 3, 2) @ test.matrix
                count, size = len(of), columns.shape[1] * d
                left, columns = (a.reshape(count, size, -1) for a in (left, columns))
                yield test.blocks, jets.nodes_of(of), left.transpose(0, 2, 1) @ columns

    def _flux_change(
        self, cells: NDArray[np.int32], E: Array, inside: Array, there: Array
    ) -> Array:
        """sum_q E_pq C_q : GRAD w(X_q) - A_p : GRAD w(X_p) by dofs (f, p, entries, n)."""
        jets, bodies = self._active.point_tangent.jets, self._bodies
        G = jets.gradient_entries(inside)
        G = G.reshape(*G.shape[:3], -1)
        current = _combined(E, bodies.moduli_in(cells) @ G)
        G = jets.gradient_entries(there)
        G = G.reshape(*G.shape[:3], -1)
        frozen = _combined(E, bodies.frozen_in(cells))
        return current - frozen @ G


def _combined(E: Array, values: Array) -> Array:
    """sum_q E_pq X_q (f, p, ...); as one product of matrices, several times as fast as einsum."""
    count, points = values.shape[:2]
    return (E @ values.reshape(count, points, -1)).reshape(count, -1, *values.shape[2:])


def _normal_rows(N: Array, entries: list[tuple[int, int]]) -> Array:
    """P -> P.N for the entries of P (..., d, entries)."""
    d = N.shape[-1]
    rows = np.zeros((*N.shape, len(entries)))
    for number, (i, j) in enumerate(entries[: d * d]):
        rows[..., i, number] = N[..., j]
    return rows
