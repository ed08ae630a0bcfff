"""The pressure of a fluid between the crack faces of an interface, at its points."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..domain.materials import Bodies
from ..forms import kinematics
from .points import PointValues
from .quadrature import InterfaceQuadrature
from .return_map import apply
from .stabilization import Stabilization


class Fluid:
    """A fluid between the crack faces of an interface.

    Args:
        quadrature: Points of the interface.
        u: Displacement, changed by the solver.
        bodies: Materials.

    Attributes:
        pressure: Pressure at the points, set by the loads [MPa].
        share: Fraction of the pressure that acts at the points (nq,); never modified in place.
    """

    def __init__(self, quadrature: InterfaceQuadrature, u: fem.Function, bodies: Bodies):
        self.pressure = fem.Function(quadrature.space(()), name="fluid")
        self.share = np.ones(len(quadrature.weights))
        self._quadrature = quadrature
        self._area = None
        if not bodies.small:
            self._area = quadrature.side_evaluators(
                u,
                bodies,
                (quadrature.d,),
                lambda body, F, N, a: kinematics.area_vector(body, F, N),
                "current area",
            )

    def intrusion(self, values: PointValues, stabilization: Stabilization) -> NDArray[np.float64]:
        """{J F^-T.N}.s, by which the volume between the faces exceeds that of the gap (nq,) [mm].

        The fluid fills the gap zeta = g - s: its work is p d(volume between the faces) minus p d({J
        F^-T.N}.s), so that energies balance for nonzero elastic opening s.
        """
        mean = self._quadrature.normal
        if self._area is not None:
            # The kernels use the outward normal of their side, -N on side 2.
            delta = stabilization.weights[self._quadrature.facet]
            mean = apply(delta[:, 0], self._area[0]()) - apply(delta[:, 1], self._area[1]())
        return np.einsum("pi,pi->p", mean, values.elastic_opening)
