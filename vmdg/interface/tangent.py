"""The tangent (84)-(85) of an interface at its points: D of the jets of `interface.jets`.

Everything that depends on the material, H_a = (A.N)_a and K_a = Xi_a:(delta_a^T s (x) N) of every
side, is derived in UFL (:mod:`forms.kinematics`) and evaluated at the points; what is left are
products of small matrices. Written by ``ufl.derivative`` of (27) instead, the same form gives
kernels of 40,000 lines in 3D.
"""

from __future__ import annotations

from functools import partial
from itertools import combinations_with_replacement

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray
from ufl.core.expr import Expr

from ..domain.materials import Bodies
from ..forms import kinematics
from .jets import FacetJets
from .points import PointValues
from .quadrature import FacetQuadrature, side_evaluators
from .return_map import TurningTangent
from .stabilization import Stabilization

Array = NDArray[np.float64]


class PointTangent:
    """D of one interface: its part of the tangent is int j(eta).D.j(du) dA.

    Args:
        quadrature: Facet points.
        u: Displacement.
        bodies: Materials.
        inelastic: The law has a gap, and with it the scalar r for tau_s.
        jump: The form is (26), with the traction jump.
        fluid: Pressure at the points; None for none.

    Attributes:
        jets: B of the points.
        areas: dA (nq,) [mm2; times the thickness in plane strain].
    """

    def __init__(
        self,
        quadrature: FacetQuadrature,
        u: fem.Function,
        bodies: Bodies,
        *,
        inelastic: bool,
        jump: bool,
        fluid: fem.Function | None = None,
    ):
        evaluators = partial(side_evaluators, quadrature, u, bodies, fluid=fluid)
        d, geometry = quadrature.d, quadrature.geometry
        n = geometry.size(d)
        self.jets = FacetJets(quadrature, u.function_space)
        self.areas = quadrature.weights * float(geometry.thickness)
        self._shape, self._entries = (d, n, n), self.jets.entries
        self._quadrature, self._inelastic, self._jump = quadrature, inelastic, jump
        self._evaluate_moduli = evaluators(
            self._shape, lambda body, F, N, a: kinematics.traction_moduli(body, F, N), "H"
        )
        # At small strain the moduli do not change with the deformation: K of (85) is zero.
        self._finite = not bodies.small
        if self._finite:
            self._directions = [fem.Function(quadrature.space((d,))) for _ in range(2)]
            count = len(self._entries)
            self._component = np.zeros((count, count), dtype=int)
            for n, (p, q) in enumerate(combinations_with_replacement(range(count), 2)):
                self._component[p, q] = self._component[q, p] = n
            components = count * (count + 1) // 2
            self._evaluate_third = evaluators((components,), self._third_derivative, "K")

    def _third_derivative(self, body, F: Expr, N: Expr, a: int) -> Expr:
        K = kinematics.projected_third_derivative(body, F, N, self._directions[a])
        return kinematics.major_components(K, self._entries)

    def __call__(
        self,
        stabilization: Stabilization,
        values: PointValues,
        compliance: Array | None,
        turning: TurningTangent | None,
    ) -> tuple[Array, Array]:
        """D at the current displacement, and the numerical flux it is made with.

        With h(w) = {(A : GRAD w).N} and Tt(w) = h(w) + tau_s.g(w), the flux of (84),

            j(eta).D.j(du) = g(eta).Tt(du) + h(eta).g(du) + {(GRAD eta : Xi : GRAD du).N}.s
                             - Tt(eta).d zeta - S(eta):(dM/dT.Tt(du) + dM/dS : S(du))
                             - [[(GRAD eta : A).N]].delta_s.[[(A : GRAD du).N]],

        the second to fifth terms of (85), then (84) with d zeta = C.Tt(du) + Z:S(du), where the
        frame turns with S(w) = GRAD w_1 + GRAD w_2 also that of ``residual.frame_couple``, and with
        the traction jump that of (26). The frame of an axisymmetric body turns in its section.

        Args:
            stabilization: As the forms have it.
            values: At the points.
            compliance: C = d zeta/dT (nq, d, d) [mm3/N]; None keeps zeta.
            turning: Z, dM/dT and dM/dS where the frame turns; None keeps the frame.

        Returns:
            D dA (nq, jet, jet), and Tt dA (nq, d, jet).
        """
        quadrature, count = self._quadrature, len(self._entries)
        facet, d = quadrature.facet, quadrature.d
        sides = [slice(d + a * count, d + (a + 1) * count) for a in range(2)]
        opening, size = slice(0, d), d + 2 * count
        delta = stabilization.weights[facet]
        if self._inelastic:
            tau = stabilization.norm[facet, None, None] * np.eye(d)
        else:
            tau = stabilization.tau[facet]
        # The kernels take the outward normal of their own side, -N on side 2.
        i, j = np.array(self._entries).T
        H = [self._evaluate_moduli[a]().reshape(-1, *self._shape)[:, :, i, j] for a in range(2)]
        flux = np.zeros((len(facet), d, size))
        for a, sign in enumerate((1, -1)):
            flux[:, :, sides[a]] = sign * delta[:, a] @ H[a]
        traction = flux.copy()
        traction[:, :, opening] = tau

        D = np.zeros((len(facet), size, size))
        D[:, :, opening] = flux.transpose(0, 2, 1)
        D[:, opening] += traction
        for a, K in enumerate(self._geometric_term(stabilization, values) if self._finite else ()):
            D[:, sides[a], sides[a]] += K
        if compliance is not None:
            change = compliance @ traction
            if turning is not None:
                spin, by_traction, by_gradient = turning
                # S sees the gradients of both sides alike.
                gradients = [slice(side.start, side.start + d * d) for side in sides]
                couple = by_traction.reshape(-1, d * d, d) @ traction
                for gradient in gradients:
                    change[:, :, gradient] += spin.reshape(-1, d, d * d)
                    couple[:, :, gradient] += by_gradient.reshape(-1, d * d, d * d)
                for gradient in gradients:
                    D[:, gradient] -= couple
            D -= traction.transpose(0, 2, 1) @ change
        if self._jump:
            factor = np.linalg.cholesky(stabilization.delta_s[facet]).transpose(0, 2, 1)
            # [[P.N]] = P_1.N_1 + P_2.N_2 takes each side's own normal.
            jump = np.zeros_like(flux)
            for a in range(2):
                jump[:, :, sides[a]] = factor @ H[a]
            D -= jump.transpose(0, 2, 1) @ jump
        for matrices in (D, traction):
            matrices *= self.areas[:, None, None]
        return D, traction

    def _geometric_term(self, stabilization: Stabilization, values: PointValues) -> list[Array]:
        """K_a of (85) of both sides (nq, entries, entries) [MPa]."""
        facet = self._quadrature.facet
        # v_1, v_2 with which the adjoint term of (27) or (26) tests (nq, 2, d) [mm].
        directions = np.einsum("paji,pj->pai", stabilization.weights[facet], values.slip)
        if self._jump:
            more = np.einsum("pij,pj->pi", stabilization.delta_s[facet], values.jump)
            directions += np.stack([-more, more], axis=1)
        found = []
        for a, sign in enumerate((1, -1)):
            self._directions[a].x.array[:] = (sign * directions[:, a]).ravel()
            found.append(self._evaluate_third[a]()[:, self._component])
        return found
