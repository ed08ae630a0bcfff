"""Interface terms of the stabilized form (27), side 1 = '+', side 2 = '-', N outward from side 1.

Signs: opening g = phi_2 - phi_1, elastic opening s = g - zeta, T = {P.N} + tau_s.s. With these (27)
is the derivative of ``energy`` below at fixed zeta, and T is lambda of (23).
"""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from .geometry import Geometry
from .kinematics import Body, projected_traction_moduli, traction

SIDES = ("+", "-")


def opening(w: Expr) -> Expr:
    """g(w) = w_2 - w_1 = -[[w]] of (3), (d,) [mm]; zero for a dilatation, a scalar."""
    return w("-") - w("+") if w.ufl_shape else ufl.zero(len(ufl.grad(w)))


def section_gradients(w: Expr) -> Expr:
    """GRAD w_1 + GRAD w_2 in the section, (d, d); zero for a dilatation."""
    gradient = ufl.grad(w)
    if not w.ufl_shape:
        return ufl.zero((len(gradient), len(gradient)))
    return gradient("+") + gradient("-")


def one_sided_tractions(
    bodies: tuple[Body, Body], geometry: Geometry, u: Expr, N: Expr
) -> tuple[Expr, Expr]:
    """P_1.N and P_2.N, both with the normal of side 1, (d,) [MPa]."""
    return tuple(
        traction(body(side), ufl.variable(geometry.deformation(u)(side)), N)
        for body, side in zip(bodies, SIDES, strict=True)
    )


def mean_traction(tractions: tuple[Expr, Expr], delta: tuple[Expr, Expr]) -> Expr:
    """{P.N} = delta_1.P_1.N + delta_2.P_2.N, the weighted flux of (23), (d,) [MPa].

    Since tau_s.(tau_1 + tau_2) = I, delta_1 + delta_2 = I.
    """
    return ufl.dot(delta[0], tractions[0]) + ufl.dot(delta[1], tractions[1])


def traction_jump(tractions: tuple[Expr, Expr]) -> Expr:
    """[[P.N]] = P_1.N_1 + P_2.N_2 = P_1.N - P_2.N of (26), zero by (51), (d,) [MPa]."""
    return tractions[0] - tractions[1]


def flux_term(eta: Expr, mean: Expr) -> Expr:
    """g(eta).{P.N}, second term of (27)."""
    return ufl.dot(opening(eta), mean)


def penalty_term(eta: Expr, tau: Expr, s: Expr) -> Expr:
    """g(eta).tau_s.s, fourth term of (27); tau_s = r I (57) where the law can fail."""
    return ufl.dot(opening(eta), ufl.dot(tau, s))


def adjoint_term(
    eta: Expr,
    bodies: tuple[Body, Body],
    geometry: Geometry,
    u: Expr,
    N: Expr,
    directions: tuple[Expr, Expr],
) -> Expr:
    """sum_a v_a.((GRAD eta_a : A_a).N); with v_a = delta_a^T.s the third term of (27)."""
    return sum(
        ufl.inner(
            projected_traction_moduli(
                body(side), ufl.variable(geometry.deformation(u)(side)), N, direction
            ),
            geometry.gradient(eta)(side),
        )
        for body, side, direction in zip(bodies, SIDES, directions, strict=True)
    )


def adjoint_directions(s: Expr, delta: tuple[Expr, Expr]) -> tuple[Expr, Expr]:
    """v_a = delta_a^T.s: the test directions of {(GRAD eta : A).N}.s in (27)."""
    return ufl.dot(s, delta[0]), ufl.dot(s, delta[1])


def jump_directions(jump: Expr, delta_s: Expr) -> tuple[Expr, Expr]:
    """v_1 = -v_2 = -delta_s.[[P.N]]: -[[(GRAD eta : A).N]].delta_s.[[P.N]] of (26)."""
    v = ufl.dot(delta_s, jump)
    return -v, v


def frame_couple(eta: Expr, moment: Expr) -> Expr:
    """-M:(GRAD eta_1 + GRAD eta_2), the work of T on the part of zeta that rotates with the frame.

    zeta = R.zeta~ follows the mid-surface; varied at fixed zeta~ instead of zeta, (27) has the
    additional term -T.(dR.zeta~), with M_ij = (zeta~ x R^T.T)_k W_kij / 2, W of
    :mod:`vmdg.interface.frame`. Without it the couple T x zeta would do work on a rotating body. In
    axisymmetry the frame rotates in the section and GRAD is that of the section.
    """
    return -ufl.inner(moment, section_gradients(eta))


def residual(
    eta: Expr,
    bodies: tuple[Body, Body],
    geometry: Geometry,
    u: Expr,
    N: Expr,
    delta: tuple[Expr, Expr],
    tau: Expr,
    zeta: Expr | None,
    delta_s: Expr | None = None,
    moment: Expr | None = None,
) -> Expr:
    """Interface integrand of (27), or of (26) where ``delta_s`` is given.

    ``zeta`` is None for a tie, ``moment`` where the frame does not rotate.
    """
    s = opening(u) if zeta is None else opening(u) - zeta
    tractions = one_sided_tractions(bodies, geometry, u, N)
    directions = adjoint_directions(s, delta)
    if delta_s is not None:
        more = jump_directions(traction_jump(tractions), delta_s)
        directions = (directions[0] + more[0], directions[1] + more[1])
    terms = (
        flux_term(eta, mean_traction(tractions, delta))
        + adjoint_term(eta, bodies, geometry, u, N, directions)
        + penalty_term(eta, tau, s)
    )
    return terms if moment is None else terms + frame_couple(eta, moment)


def energy(
    bodies: tuple[Body, Body],
    geometry: Geometry,
    u: Expr,
    N: Expr,
    delta: tuple[Expr, Expr],
    tau: Expr,
    zeta: Expr | None,
    delta_s: Expr | None = None,
) -> Expr:
    """{P.N}.s + s.tau_s.s/2 (- [[P.N]].delta_s.[[P.N]]/2), stored in the interface [N/mm].

    The energy of (30) in the signs of this module; :func:`residual` is its derivative by u at fixed
    zeta.
    """
    s = opening(u) if zeta is None else opening(u) - zeta
    tractions = one_sided_tractions(bodies, geometry, u, N)
    stored = ufl.dot(mean_traction(tractions, delta), s) + ufl.dot(s, ufl.dot(tau, s)) / 2
    if delta_s is None:
        return stored
    jump = traction_jump(tractions)
    return stored - ufl.dot(jump, ufl.dot(delta_s, jump)) / 2
