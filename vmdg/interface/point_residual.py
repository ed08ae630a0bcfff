"""The interface terms of (27) as a sum over points, for meshes that do not match.

With the jet j(eta) of :mod:`.jets` the terms are int j(eta).q dA, and the forces B^T.q dA:

    q = (T, H_1^T.v_1 - M, H_2^T.v_2 - M),    v_a = delta_a^T.s,  H_a = (A.N)_a,

with M of a rotating frame. Each side has its own area vector: P_2.M_2 and H_2 with
M_2 = -N_2 dS_2/dS_1, or forces would not balance where the surfaces are not parallel.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..domain.materials import Bodies
from ..forms import kinematics
from .points import PointValues
from .quadrature import InterfaceQuadrature
from .stabilization import Stabilization

Array = NDArray[np.float64]


class PointResidual:
    """q of one interface.

    Args:
        quadrature: Its points.
        u: Displacement, changed by the solver.
        bodies: Materials.
        fluid: Pressure at the points; None for none.
    """

    def __init__(
        self,
        quadrature: InterfaceQuadrature,
        u: fem.Function,
        bodies: Bodies,
        fluid: fem.Function | None = None,
    ):
        self._quadrature = quadrature
        d, geometry = quadrature.d, quadrature.geometry
        n = geometry.size(d)
        self._columns = [i * n + j for i, j in geometry.entries(d)]
        self._directions = [fem.Function(quadrature.space((d,))) for _ in range(2)]
        self._adjoint = quadrature.side_evaluators(
            u,
            bodies,
            (n, n),
            lambda body, F, N, a: kinematics.projected_traction_moduli(
                body, F, N, self._directions[a]
            ),
            "adjoint term",
            fluid=fluid,
        )

    def __call__(self, stabilization: Stabilization, values: PointValues) -> Array:
        """q (nq, jet) [MPa; N/mm for the entries of GRAD].

        Args:
            stabilization: Of the forms.
            values: At the points.
        """
        facet = self._quadrature.facet
        parts = [values.traction]
        # The kernels use the outward normal of their side, -N on side 2.
        for a, sign in enumerate((1.0, -1.0)):
            weights = stabilization.weights[facet, a]
            direction = np.einsum("pji,pj->pi", weights, values.elastic_opening)
            self._quadrature.write(self._directions[a], sign * direction)
            flux = self._adjoint[a]()[:, self._columns]
            if values.moment is not None:
                moment = values.moment.reshape(len(flux), self._quadrature.d**2)
                # M is half of the couple of a frame that turns with the mean of both sides.
                share = 2.0 * (a == 0) if self._quadrature.leads else 1.0
                flux[:, : moment.shape[1]] -= share * moment
            parts.append(flux)
        return np.concatenate(parts, axis=1)

    def energy(self, stabilization: Stabilization, values: PointValues) -> float:
        """{P.N}.s + s.tau_s.s/2 over the points, (30) [N mm; N in plane strain].

        T has the penalty whole.

        Args:
            stabilization: Of the forms.
            values: At the points.
        """
        quadrature, s = self._quadrature, values.elastic_opening
        if values.gap is None and values.rotation is None:
            penalty = np.einsum("pij,pj->pi", stabilization.tau[quadrature.facet], s)
        else:
            penalty = stabilization.norm[quadrature.facet, None] * s
        density = np.einsum("pi,pi->p", values.traction - penalty / 2, s)
        return float(density @ quadrature.weights)
