"""First stage of the interface tangent: the coefficients of (84)-(85) at the facet points."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.core.expr import Expr

from ..domain.materials import Bodies
from ..forms import kinematics, tangent
from .points import PointValues
from .quadrature import FacetQuadrature, side_evaluators
from .return_map import TurningTangent
from .stabilization import Stabilization


class StagedTangent:
    """Coefficients H, K and C of the tangent of one interface.

    Args:
        quadrature: Facet points.
        u: Displacement.
        bodies: Materials.
        damage: The law has a damage tangent C.
        turns: The frame of the law turns, so zeta also changes with the deformation gradient.
        jump: The form is (26), with the traction jump.
        fluid: Pressure at the points; None for none.
    """

    def __init__(
        self,
        quadrature: FacetQuadrature,
        u: fem.Function,
        bodies: Bodies,
        *,
        damage: bool,
        turns: bool,
        jump: bool,
        fluid: fem.Function | None = None,
    ):
        evaluators = partial(side_evaluators, quadrature, u, bodies, fluid=fluid)
        d, geometry = quadrature.d, quadrature.geometry
        n = geometry.size(d)
        self._shape, self._entries = (d, n, n), geometry.entries(d)
        self._quadrature, self._geometry = quadrature, geometry
        self._evaluate_moduli = evaluators(
            self._shape, lambda body, F, N, a: kinematics.traction_moduli(body, F, N), "H"
        )
        space = quadrature.space(self._shape)
        self._moduli = [fem.Function(space) for _ in range(2)]
        self._compliance = fem.Function(quadrature.space((d, d))) if damage else None
        fourth = quadrature.space((d, d, d, d)) if turns else None
        # The frame turns in the section: no hoop direction.
        plane = quadrature.space((d, d, d)) if turns else None
        self._turning = [fem.Function(s) for s in (plane, plane, fourth)] if turns else []
        self._jump = [fem.Function(space) for _ in range(2)] if jump else []
        self._third: list[fem.Function] = []
        # At small strain the moduli do not change with the deformation: K of (85) is zero.
        if not bodies.small:
            vectors = quadrature.space((d,))
            self._directions = [fem.Function(vectors) for _ in range(2)]
            count = len(self._entries)
            shape = (count * (count + 1) // 2,)
            self._evaluate_third = evaluators(shape, self._third_derivative, "K")
            space = quadrature.space(shape)
            self._third = [fem.Function(space) for _ in range(2)]

    def _third_derivative(self, body, F: Expr, N: Expr, a: int) -> Expr:
        K = kinematics.projected_third_derivative(body, F, N, self._directions[a])
        return kinematics.major_components(K, self._entries)

    def integrand(self, eta: Expr, du: Expr, tau: Expr) -> Expr:
        """Second stage: the bilinear integrand of (84)-(85)."""
        moduli = tuple(function("+") for function in self._moduli)
        third = None
        if self._third:
            third = tuple(
                kinematics.from_major_components(function("+"), self._entries)
                for function in self._third
            )
        geometry = self._geometry

        def flux(w: Expr) -> Expr:
            return tangent.traction_variation(geometry, w, moduli, tau)

        result = tangent.bonded_tangent(geometry, eta, du, moduli, tau, third)
        if self._compliance is not None:
            spin = self._turning[0]("+") if self._turning else None
            compliance = self._compliance("+")
            result += tangent.damage_tangent(flux(eta), flux(du), du, compliance, spin)
        if self._turning:
            _, by_traction, by_gradient = (function("+") for function in self._turning)
            result += tangent.frame_couple_tangent(eta, du, flux(du), by_traction, by_gradient)
        if self._jump:
            result += tangent.jump_tangent(geometry, eta, du, tuple(f("+") for f in self._jump))
        return result

    def traction_term(self, q: Expr, du: Expr, tau: Expr) -> Expr:
        """q.Tt(du), the change of the trial traction (84) against a test function at the points."""
        moduli = tuple(function("+") for function in self._moduli)
        return ufl.dot(q, tangent.traction_variation(self._geometry, du, moduli, tau))

    def fill(
        self,
        stabilization: Stabilization,
        values: PointValues,
        compliance: NDArray | None,
        turning: TurningTangent | None,
    ) -> None:
        """First stage: evaluate the coefficients at the current displacement.

        Args:
            stabilization: As the forms have it.
            values: At the points.
            compliance: C = d zeta/dT (nq, d, d) [mm3/N]; None keeps zeta.
            turning: Where the frame turns; None keeps the frame.
        """
        facet = self._quadrature.facet
        delta, factor = stabilization.weights[facet], None
        # v_1, v_2 with which the adjoint term of (27) or (26) tests (nq, 2, d) [mm].
        directions = np.einsum("paji,pj->pai", delta, values.slip)
        if self._jump:
            delta_s = stabilization.delta_s[facet]
            more = np.einsum("pij,pj->pi", delta_s, values.jump)
            directions += np.stack([-more, more], axis=1)
            factor = np.linalg.cholesky(delta_s).transpose(0, 2, 1)
        if self._compliance is not None:
            self._compliance.x.array[:] = 0 if compliance is None else compliance.ravel()
        for n, function in enumerate(self._turning):
            function.x.array[:] = 0 if turning is None else turning[n].ravel()
        # The kernels take the outward normal of their own side, -N on side 2.
        for a, sign in enumerate((1, -1)):
            H = self._evaluate_moduli[a]().reshape(-1, *self._shape)
            self._moduli[a].x.array[:] = _contract(sign * delta[:, a], H).ravel()
            if factor is not None:
                # [[P.N]] = P_1.N_1 + P_2.N_2 takes each side's own normal.
                self._jump[a].x.array[:] = _contract(factor, H).ravel()
        for a, sign in enumerate((1, -1) if self._third else ()):
            self._directions[a].x.array[:] = (sign * directions[:, a]).ravel()
            self._third[a].x.array[:] = self._evaluate_third[a]().ravel()


def _contract(tensor: NDArray, moduli: NDArray) -> NDArray:
    """Row-wise tensor.H, (nq, d, d) and (nq, d, n, n)."""
    points, d, *shape = moduli.shape  # a rank may have no points: no -1
    return (tensor @ moduli.reshape(points, d, math.prod(shape))).reshape(moduli.shape)
