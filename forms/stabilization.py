"""The cell-wise bubble integral (22) from which tau_s follows."""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from .geometry import Geometry
from .kinematics import Body, acoustic_tensor


def bubble_stiffness(body: Body, geometry: Geometry, u: Expr, bubble: Expr) -> Expr:
    """Integrand of (22): GRAD b : A : GRAD b, (d, d) [MPa/mm2].

    With mean dilatation A is that of W at F_bar: bubbles do not share the dilatation of their cell.
    """
    F = ufl.variable(body.effective(geometry.deformation(u)))
    A = acoustic_tensor(body.pointwise, F)
    return geometry.bubble_stiffness(A, bubble)
