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
from ..points.points import Evaluator, Points
from .stabilization import Stabilization
from .values import PointValues

Array = NDArray[np.float64]


def adjoint_directions(
    stabilization: Stabilization, values: PointValues, facet: NDArray[np.int32], jump: bool
) -> Array:
    """v_1 and -v_2 of the adjoint term of (27), with the traction jump of (26) (2, nq, d) [mm]: the
    kernels use the outward normal of their side, -N on side 2."""
    weights = stabilization.weights[facet].swapaxes(2, 3)
    directions = (weights @ values.elastic_opening[:, None, :, None])[..., 0]
    if jump:
        more = np.einsum("pij,pj->pi", stabilization.delta_s[facet], values.jump)
        directions += np.stack([-more, more], axis=1)
    return np.stack([directions[:, 0], -directions[:, 1]])


class PointResidual:
    """q of one interface."""

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
        self._directions = fem.Function(quadrature.space((d,)))

    def compile(self) -> None:
        _ = self._adjoint

    @cached_property
    def _adjoint(self) -> Evaluator:
        return self._quadrature.evaluator(
            self._u,
            self._bodies,
            (self._n, self._n),
            lambda *given: kinematics.projected_traction_moduli(*given, self._directions),
            "adjoint term",
            self._fluid,
        )

    def __call__(self, stabilization: Stabilization, values: PointValues) -> Array:
        """q (nq, jet) [MPa; N/mm for the entries of GRAD]."""
        quadrature, d = self._quadrature, self._quadrature.d
        directions = adjoint_directions(stabilization, values, quadrature.facet, self._jump)
        quadrature.write(self._directions, directions)
        flux = self._adjoint()[:, :, self._columns]
        if values.moment is not None:
            # M is half of the couple of a frame that turns with the mean of both sides.
            share = 2.0 * quadrature.leads.T[:, :, None]
            flux[:, :, : d**2] -= share * values.moment.reshape(-1, d**2)
        return np.concatenate([values.traction, *flux], axis=1)

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
