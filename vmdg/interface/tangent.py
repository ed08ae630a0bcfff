"""The tangent (84)-(85) of an interface at its points: D for the jets of `interface.jets`.

All material-dependent parts, H_a = (A.N)_a and K_a = Xi_a:(delta_a^T s (x) N) of each side, are
derived in UFL (:mod:`forms.kinematics`) and evaluated at the points; the remaining products of
small matrices are in tangent.c. With ``ufl.derivative`` of (27) instead, the same form gives
kernels of 40,000 lines in 3D.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray
from ufl.core.expr import Expr

from ..base.kernels import call, compile_source
from ..domain.materials import Bodies
from ..forms import kinematics
from ..forms.kinematics import Body
from ..points.jets import FacetJets
from ..points.points import Points
from .frame import TurningTangent
from .point_residual import adjoint_directions
from .stabilization import Stabilization
from .values import PointValues

Array = NDArray[np.float64]

#: Number of points or facets, and the arrays of tangent.c.
_DECLARATIONS = f"""
void point_tangents(long{", void *" * 15});
void facet_tangents(long{", void *" * 5});
void add_forces(long{", void *" * 6});
"""


class PointTangent:
    """D of one interface: its tangent is int j(eta).D.j(du) dA."""

    moduli: Array  # H_a of both sides (2, nq, d, entries) at the last evaluation [MPa]

    def __init__(
        self,
        quadrature: Points,
        u: fem.Function,
        bodies: Bodies,
        *,
        jump: bool,
        fluid: fem.Function | None = None,
    ):
        evaluator = partial(quadrature.evaluator, u, bodies, fluid=fluid)
        d, geometry = quadrature.d, quadrature.geometry
        n = geometry.size(d)
        self._quadrature, self._space = quadrature, u.function_space
        self._entries = self.jets.entries
        # All entries of GRAD in order need no copy.
        columns = [i * n + j for i, j in self._entries]
        self._columns = slice(None) if columns == list(range(n * n)) else columns
        self._jump = jump
        self._module = compile_source(
            Path(__file__).with_suffix(".c"),
            _DECLARATIONS,
            {
                "DIM": d,
                "ENTRIES": len(self._entries),
                "NODES": self.jets.nodes,
                "SLOPES": self.jets.gradients.shape[4],
                "POINTS": quadrature.points_of_facet.shape[1],
            },
            quadrature.mesh.comm,
            name="interface's tangent",
        )
        self._evaluate_moduli = evaluator((d, n, n), kinematics.traction_moduli, "H")
        # At small strain the moduli do not change with the deformation: K of (85) is zero.
        self._finite = not bodies.small
        if self._finite:
            self._directions = fem.Function(quadrature.space((d,)))
            count = len(self._entries)
            components = count * (count + 1) // 2
            self._evaluate_third = evaluator((components,), self._third_derivative, "K")

    @property
    def jets(self) -> FacetJets:
        """B at the points."""
        return self._quadrature.jets(self._space)

    @property
    def areas(self) -> Array:
        """dA (nq,) [mm2; times the thickness in plane strain]."""
        return self._quadrature.weights * float(self._quadrature.geometry.thickness)

    def _third_derivative(self, body: Body, F: Expr, N: Expr) -> Expr:
        K = kinematics.projected_third_derivative(body, F, N, self._directions)
        return kinematics.major_components(K, self._entries)

    def __call__(
        self,
        stabilization: Stabilization,
        values: PointValues,
        compliance: Array | None,
        turning: TurningTangent | None,
    ) -> tuple[Array, Array]:
        """D at the current displacement, and the numerical flux from which it is built.

        With h(w) = {(A : GRAD w).N} and Tt(w) = h(w) + tau_s.g(w), the flux of (84),

            j(eta).D.j(du) = g(eta).Tt(du) + h(eta).g(du) + {(GRAD eta : Xi : GRAD du).N}.s
                             - Tt(eta).d zeta - S(eta):(dM/dT.Tt(du) + dM/dS : S(du))
                             - [[(GRAD eta : A).N]].delta_s.[[(A : GRAD du).N]],

        the second to fifth terms of (85), then (84) with d zeta = C.Tt(du) + Z:S(du), for a
        rotating frame, with S(w) = GRAD w_1 + GRAD w_2, also that of ``residual.frame_couple``, or
        twice that of the side that leads, and
        with the traction jump that of (26). The frame of an axisymmetric body rotates in its
        section.

        Args:
            compliance: C = d zeta/dT (nq, d, d) [mm3/N]; None fixes zeta.
            turning: Z, dM/dT and dM/dS of a rotating frame; None fixes the frame.

        Returns:
            D dA (nq, jet, jet), and Tt dA (nq, d, jet).
        """
        quadrature = self._quadrature
        facet, d, size = quadrature.facet, quadrature.d, self.jets.size
        shape = 2, -1, d, quadrature.geometry.size(d) ** 2
        self.moduli = H = self._evaluate_moduli().reshape(shape)[..., self._columns]
        K = self._geometric_term(stabilization, values) if self._finite else (None, None)
        changes = (None, None, None) if compliance is None or turning is None else turning
        delta_s = stabilization.delta_s[facet] if self._jump else None
        D, traction = np.empty((len(facet), size, size)), np.empty((len(facet), d, size))
        call(
            self._module,
            "point_tangents",
            *(self.areas, stabilization.weights[facet], stabilization.penalty[facet], *H, *K),
            *(compliance, *changes, 2.0 * quadrature.leads, delta_s, D, traction),
        )
        return D, traction

    def of_facets(self, D: Array, rows: slice) -> Array:
        """Sums of B^T.D.B over the points of some facets, for displacements (f, n, n)."""
        points, values = self._quadrature.points_of_facet[rows], self.jets.values[rows]
        size = 2 * self.jets.nodes * self._quadrature.d
        matrices = np.empty((len(points), size, size))
        call(self._module, "facet_tangents", points, values, self.jets.gradients[rows], D, matrices)
        return matrices

    def add_forces(self, flux: Array, dofs: NDArray[np.int32], vector: Array) -> None:
        """Add int j(eta).flux, with dA (nq, jet), to a vector over local dofs, at nodes of cells
        (cells, nodes of a cell) [N]."""
        points, jets = self._quadrature.points_of_facet, self.jets
        nodes = dofs[self._quadrature.facets.cells]
        call(self._module, "add_forces", points, jets.values, jets.gradients, flux, nodes, vector)

    def _geometric_term(self, stabilization: Stabilization, values: PointValues) -> Array:
        """Independent components of K_a of (85) of both sides (2, nq, components) [MPa]."""
        directions = adjoint_directions(stabilization, values, self._quadrature.facet, self._jump)
        self._quadrature.write(self._directions, directions)
        return self._evaluate_third()
