"""The cell-wise bubble integral (22) from which tau_s follows."""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from .kinematics import Body, acoustic_tensor, deformation_gradient


def bubble_stiffness(body: Body, u: Expr, bubble: Expr) -> Expr:
    """Integrand of (22): GRAD b : A : GRAD b, B_ik = b_,j A_ijkl b_,l, (d, d) [MPa/mm2]."""
    A = acoustic_tensor(body, deformation_gradient(ufl.grad(u)))
    db = ufl.grad(bubble)
    i, j, k, m = ufl.indices(4)
    return ufl.as_tensor(db[j] * A[i, j, k, m] * db[m], (i, k))
