"""The cell-wise bubble integral (22) from which tau_s follows."""

from __future__ import annotations

from ufl.core.expr import Expr

from .geometry import Geometry
from .kinematics import Body, acoustic_tensor, deformation_gradient


def bubble_stiffness(body: Body, geometry: Geometry, u: Expr, bubble: Expr) -> Expr:
    """Integrand of (22): GRAD b : A : GRAD b, (d, d) [MPa/mm2]."""
    A = acoustic_tensor(body, deformation_gradient(geometry.gradient(u)))
    return geometry.bubble_stiffness(A, bubble)
