"""The interface terms of (27) as a sum over points, where meshes match or not.

With the jet j(eta) of :mod:`.jets` the terms are int j(eta).q dA, and the forces B^T.q dA:

    q = (T, H_1^T.v_1 - M, H_2^T.v_2 - M),    v_a = delta_a^T.s,  H_a = (A.N)_a,

with M of a rotating frame, and with the traction jump of (26) -+delta_s.[[P.N]] in v_a. Each side
has its own area vector: P_2.M_2 and H_2 with M_2 = -N_2 dS_2/dS_1, or forces would not balance
where the surfaces are not parallel.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..domain.materials import Bodies
from ..forms import kinematics
from ..points.points import Points, SideEvaluators
from .stabilization import Stabilization
from .values import PointValues

Array = NDArray[np.float64]


def adjoint_directions(
    stabilization: Stabilization, values: PointValues, facet: NDArray[np.int32], jump: bool
) -> Array:
    """v_1 and v_2 of the adjoint term of (27), with the traction jump of (26) (nq, 2, d) [mm]."""
    weights = stabilization.weights[facet].swapaxes(2, 3)
    directions = (weights @ values.elastic_opening[:, None, :, None])[..., 0]
    if jump:
        more = np.einsum("pij,pj->pi", stabilization.delta_s[facet], values.jump)
        directions += np.stack([-more, more], axis=1)
    return directions


class PointResidual:
    """q of one interface.

    Args:
        fluid: Pressure at the points; None for none.
    """

    def __init__(
        self,
        quadrature: Points,
        u: fem.Function,
        bodies: Bodies,
        jump: bool = False,
        fluid: fem.Function | None = None,
    ):
        self._quadrature, self._jump = quadrature, jump
        self._u, self._bodies, self._fluid = u, bodies, fluid
        d, geometry = quadrature.d, quadrature.geometry
        self._n = n = geometry.size(d)
        self._columns = [i * n + j for i, j in geometry.entries(d)]
        self._directions = [fem.Function(quadrature.space((d,))) for _ in range(2)]

    def compile(self) -> None:
        """Compile the kernels now; collective."""
        _ = self._adjoint

    @cached_property
    def _adjoint(self) -> SideEvaluators:
        return self._quadrature.side_evaluators(
            self._u,
            self._bodies,
            (self._n, self._n),
            lambda body, F, N, a: kinematics.projected_traction_moduli(
                body, F, N, self._directions[a]
            ),
            "adjoint term",
            fluid=self._fluid,
        )

    def __call__(self, stabilization: Stabilization, values: PointValues) -> Array:
        """q (nq, jet) [MPa; N/mm for the entries of GRAD]."""
        parts = [values.traction]
        directions = adjoint_directions(stabilization, values, self._quadrature.facet, self._jump)
        # The kernels use the outward normal of their side, -N on side 2.
        for a, sign in enumerate((1.0, -1.0)):
            self._quadrature.write(self._directions[a], sign * directions[:, a])
            flux = self._adjoint[a]()[:, self._columns]
            if values.moment is not None:
                moment = values.moment.reshape(len(flux), self._quadrature.d**2)
                # M is half of the couple of a frame that turns with the mean of both sides.
                share = 2.0 * self._quadrature.leads[:, a, None]
                flux[:, : moment.shape[1]] -= share * moment
            parts.append(flux)
        return np.concatenate(parts, axis=1)

    def energy(self, stabilization: Stabilization, values: PointValues) -> float:
        """{P.N}.s + s.tau_s.s/2 over the points, (30) [N mm; N in plane strain].

        T has the penalty whole.
        """
        quadrature, s = self._quadrature, values.elastic_opening
        penalty = np.einsum("pij,pj->pi", stabilization.penalty[quadrature.facet], s)
        density = np.einsum("pi,pi->p", values.traction - penalty / 2, s)
        if self._jump:
            delta_s = stabilization.delta_s[quadrature.facet]
            density -= np.einsum("pi,pij,pj->p", values.jump, delta_s, values.jump) / 2
        return float(density @ quadrature.weights)
