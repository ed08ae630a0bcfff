"""The pressure of a fluid between the crack faces of an interface, at its points.

Its forces are sums over the points, p a_1.eta_1 + p a_2.eta_2 with the current area vectors a of
both sides, each outward and per area of side 1.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from ..base.arrays import joined_axes
from ..domain.materials import Bodies
from ..forms import kinematics
from ..points.points import Evaluator, Points
from .return_map import apply
from .stabilization import Stabilization
from .values import PointValues

Array = NDArray[np.float64]


class Fluid:
    """A fluid between the crack faces of an interface.

    Attributes:
        pressure: Pressure at the points, set by the loads [MPa].
        share: Fraction of the pressure that acts at the points (nq,); never modified in place.
    """

    def __init__(self, quadrature: Points, u: fem.Function, bodies: Bodies):
        self.pressure = fem.Function(quadrature.space(()), name="fluid")
        self.share = np.ones(len(quadrature.weights))
        self._quadrature, self._u = quadrature, u
        self._area: Evaluator | None = None
        self._area_slopes: Evaluator | None = None
        if not bodies.small:
            self._area = quadrature.evaluator(
                u, bodies, (quadrature.d,), kinematics.area_vector, "current area"
            )
            n = quadrature.geometry.size(quadrature.d)
            self._area_slopes = quadrature.evaluator(
                u,
                bodies,
                (quadrature.d, n, n),
                lambda body, F, N: ufl.diff(kinematics.area_vector(body, F, N), F),
                "slope of the current area",
            )

    @property
    def areas(self) -> Array:
        """J F^-T.N of both sides, N outward (2, nq, d)."""
        return self._quadrature.outward if self._area is None else self._area()

    def intrusion(self, values: PointValues, stabilization: Stabilization) -> Array:
        """{J F^-T.N}.s, by which the volume between the faces exceeds that of the gap (nq,) [mm].

        The fluid fills the gap zeta = g - s: its work is p d(volume between the faces) minus p d({J
        F^-T.N}.s), so that energies balance for nonzero elastic opening s.
        """
        one, two = self.areas
        delta = stabilization.weights[self._quadrature.facet]
        mean = apply(delta[:, 0], one) - apply(delta[:, 1], two)
        return np.einsum("pi,pi->p", mean, values.elastic_opening)

    def forces(self) -> Array:
        """The sum of p a.eta dA over the points, on the nodes of both cells (nf, 2 nodes,
        d) [N]."""
        quadrature = self._quadrature
        jets = quadrature.jets(self._u.function_space)
        tractions = np.stack(self.areas, axis=1) * self._pressed[:, None, None]
        return jets.side_forces(tractions[quadrature.points_of_facet])

    def tangents(self) -> Iterator[tuple[NDArray[np.int32], Array]]:
        """Cells of one side and the derivative of the forces on their nodes by the
        displacement of these (nf, n, n); none at small strain."""
        quadrature = self._quadrature
        jets, points = quadrature.jets(self._u.function_space), quadrature.points_of_facet
        d, n = quadrature.d, quadrature.geometry.size(quadrature.d)
        columns = [i * n + j for i, j in jets.entries]
        for a, slopes in enumerate(self._area_slopes() if self._area_slopes else ()):
            slopes = slopes.reshape(-1, d, n * n)[..., columns]
            slopes = (self._pressed[:, None, None] * slopes)[points]
            B = joined_axes(jets.gradient_entries(jets.gradients[:, :, a]), 3)
            moved = slopes @ B
            matrices = np.einsum("fpn,fpim->fnim", jets.values[:, :, a], moved, optimize=True)
            size = B.shape[3]
            yield quadrature.facets.cells[:, a], matrices.reshape(-1, size, size)

    @property
    def _pressed(self) -> Array:
        """p dA (nq,) [N]."""
        weights = self._quadrature.weights * float(self._quadrature.geometry.thickness)
        return weights * self.pressure.x.array[: len(weights)]
