"""Tangent (84)-(85) of the interface, staged: its coefficients are values at facet points.

Stage one evaluates H_a = (A.N)_a and K_a = Xi_a:(delta_a^T s (x) N) of every side at the facet
points (:mod:`forms.kinematics`); stage two is the bilinear form below with those values as
Functions. Written by ``ufl.derivative`` of (27) instead, the same form gives kernels of 40,000
lines in 3D.
"""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from .geometry import Geometry
from .residual import SIDES, opening, penalty, section_gradients


def flux_variation(geometry: Geometry, w: Expr, moduli: tuple[Expr, Expr]) -> Expr:
    """h(w) = {(A : GRAD w).N} = sum_a delta_a.H_a : GRAD w_a, (d,) [MPa].

    Args:
        geometry: Gives GRAD w, (n, n).
        w: Test or trial function.
        moduli: delta_a.H_a of both sides, (d, n, n).
    """
    i, j, m = ufl.indices(3)
    return sum(
        ufl.as_vector(value[m, i, j] * geometry.gradient(w)(side)[i, j], m)
        for value, side in zip(moduli, SIDES, strict=True)
    )


def traction_variation(geometry: Geometry, w: Expr, moduli: tuple[Expr, Expr], tau: Expr) -> Expr:
    """Tt(w) = h(w) + tau_s.g(w), the numerical interface flux of (84)."""
    return flux_variation(geometry, w, moduli) + penalty(tau, opening(w))


def geometric_term(geometry: Geometry, eta: Expr, du: Expr, third: tuple[Expr, Expr]) -> Expr:
    """{(GRAD eta : Xi : GRAD du).N}.s of (85) = sum_a GRAD eta_a : K_a : GRAD du_a."""
    i, j, k, m = ufl.indices(4)
    return sum(
        geometry.gradient(eta)(side)[i, j] * value[i, j, k, m] * geometry.gradient(du)(side)[k, m]
        for value, side in zip(third, SIDES, strict=True)
    )


def bonded_tangent(
    geometry: Geometry,
    eta: Expr,
    du: Expr,
    moduli: tuple[Expr, Expr],
    tau: Expr,
    third: tuple[Expr, Expr] | None,
) -> Expr:
    """Second to fifth terms of (85): the derivative of (27) with zeta held."""
    terms = ufl.dot(opening(eta), traction_variation(geometry, du, moduli, tau)) + ufl.dot(
        flux_variation(geometry, eta, moduli), opening(du)
    )
    if third is None:
        return terms
    return terms + geometric_term(geometry, eta, du, third)


def jump_tangent(geometry: Geometry, eta: Expr, du: Expr, moduli: tuple[Expr, Expr]) -> Expr:
    """-[[(GRAD eta : A).N]].delta_s.[[(A : GRAD du).N]] of the linearized (26).

    Args:
        geometry: Gives GRAD, (n, n).
        eta: Test function.
        du: Trial function.
        moduli: L^T.H_1 and -L^T.H_2 with L.L^T = delta_s, (d, n, n).
    """
    return -ufl.dot(flux_variation(geometry, eta, moduli), flux_variation(geometry, du, moduli))


def damage_tangent(
    test: Expr, trial: Expr, du: Expr, compliance: Expr, spin: Expr | None = None
) -> Expr:
    """-Tt(eta).d zeta, eq. (84), with C = d zeta/dT the consistent tangent of the return map.

    d zeta = C.Tt(du) + Z:(GRAD du_1 + GRAD du_2); Z where the law's frame turns with F. The frame
    turns in the section of an axisymmetric body: GRAD is that of the section there.

    Args:
        test: Tt(eta).
        trial: Tt(du).
        du: Trial function.
        compliance: C (d, d).
        spin: Z (d, d, d).
    """
    change = ufl.dot(compliance, trial)
    if spin is not None:
        i, j, m = ufl.indices(3)
        both = section_gradients(du)
        change += ufl.as_vector(spin[m, i, j] * both[i, j], m)
    return -ufl.dot(test, change)


def frame_couple_tangent(
    eta: Expr, du: Expr, trial: Expr, by_traction: Expr, by_gradient: Expr
) -> Expr:
    """Derivative of ``residual.frame_couple``: -S(eta):(dM/dT.Tt(du) + dM/dS:S(du)).

    S(w) = GRAD w_1 + GRAD w_2; dM/dT (d, d, d) and dM/dS (d, d, d, d) from the points, ``trial`` is
    Tt(du).
    """
    i, j, k, m = ufl.indices(4)
    left, right = section_gradients(eta), section_gradients(du)
    return -left[i, j] * (by_traction[i, j, m] * trial[m] + by_gradient[i, j, k, m] * right[k, m])
