"""Surface loads that depend on the displacement: fluid pressure and springs.

A pressure p acts on the deformed surface: its traction per reference area is -p J F^-T.N
(:func:`forms.kinematics.area_vector`), at small strain -p N.

Between crack faces the bond carries T = P.N + p J F^-T.N, the effective traction, which is that of
the energy W + p J. The interface terms of (27) with this energy, and the pressure on both faces as
a load, describe a fluid-filled crack; see :attr:`forms.kinematics.Body.fluid`.
"""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from .geometry import Geometry
from .kinematics import Body, area_vector


def pressure_force(eta: Expr, body: Body, geometry: Geometry, u: Expr, N: Expr, p: Expr) -> Expr:
    """p J F^-T.N.eta on a boundary, which balances the pressure [N/mm]."""
    F = ufl.variable(geometry.deformation(u))
    return p * ufl.dot(area_vector(body, F, N), eta)


def foundation(normal: Expr, tangential: Expr, N: Expr) -> Expr:
    """K = k_n N(x)N + k_t (I - N(x)N), stiffness of springs on a surface (d, d) [MPa/mm]."""
    across = ufl.outer(N, N)
    return normal * across + tangential * (ufl.Identity(len(N)) - across)


def spring_force(eta: Expr, K: Expr, u: Expr) -> Expr:
    """eta.K.u, springs of fixed direction between a surface and rigid ground."""
    return ufl.dot(eta, ufl.dot(K, u))
