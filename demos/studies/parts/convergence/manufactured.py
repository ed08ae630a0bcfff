"""Exact solutions at finite strain of two neo-Hookean bodies (86) that share an interface.

Every solution gives the displacement u_a of each body a as a UFL expression of X. The body force
f_a = -DIV P_a(I + GRAD u_a) follows by differentiation, so it is exact. Two bodies need more: u and
P.N must be continuous on the interface although the moduli jump. :func:`kinked` builds such pairs
for any interface, contrast and dimension.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import ufl
from dolfinx.mesh import Mesh
from ufl.core.expr import Expr

import vmdg
from vmdg.forms import kinematics
from vmdg.forms.kinematics import Body


def _body(material: vmdg.NeoHookean) -> Body:
    return Body(material, {name: ufl.as_ufl(v) for name, v in material.parameters.items()})


def stress(material: vmdg.NeoHookean, u: Expr) -> Expr:
    """P(I + GRAD u) (d, d) [MPa]."""
    F = ufl.variable(ufl.Identity(len(u)) + ufl.grad(u))
    return kinematics.first_piola(_body(material), F)


def body_force(material: vmdg.NeoHookean, u: Expr) -> Expr:
    """f = -DIV P (d,) [N/mm3]."""
    return -ufl.div(stress(material, u))


@dataclass(frozen=True)
class Exact:
    """An exact solution on a mesh."""

    u: tuple[Expr, Expr]  # Displacement of body 1 and of body 2 (d,) [mm]
    traction: Expr  # P.N on the interface, N out of body 1 (d,) [MPa]


def _one_material(material: vmdg.NeoHookean, u: Expr, level: Expr) -> Exact:
    n = ufl.grad(level)
    return Exact((u, u), ufl.dot(stress(material, u), n) / ufl.sqrt(ufl.dot(n, n)))


def sheared(
    mesh: Mesh, materials: Sequence[vmdg.NeoHookean], level: Expr, d: float = 1.01
) -> Exact:
    """Solution (i): u = (0, d X Y), one material, plane."""
    X, Y = ufl.SpatialCoordinate(mesh)
    return _one_material(materials[0], ufl.as_vector([ufl.as_ufl(0.0), d * X * Y]), level)


def bent(
    mesh: Mesh,
    materials: Sequence[vmdg.NeoHookean],
    level: Expr,
    H: float = 2.0,
    L: float = 1.0,
    R0: float = 5.5,
    psi: float = 0.2,
) -> Exact:
    """Solution (ii): a block H x L [mm] bent to the angle psi without change of volume, plane.

    phi = r (cos, sin)(Y psi/L), r^2 = R0^2 + (2 X - H) L/psi, so J = r' r psi/L = 1; one material.
    """
    X, Y = ufl.SpatialCoordinate(mesh)
    r = ufl.sqrt(R0**2 + (2 * X - H) * L / psi)
    inner, angle = (R0**2 - H * L / psi) ** 0.5, Y * psi / L
    u = ufl.as_vector([r * ufl.cos(angle) - inner - X, r * ufl.sin(angle) - Y])
    return _one_material(materials[0], u, level)


def kinked(mesh: Mesh, materials: Sequence[vmdg.NeoHookean], level: Expr) -> Exact:
    """Two materials in equilibrium across the surface level(X) = 0: u_a = u_0 + level w_a.

    u is continuous whatever w_a is, and so are its tangential derivatives, hence the cofactor
    c = cof(F_0).n of the surface, n = GRAD level (of any length). Let t be the traction wanted on
    it, P.n = t. For (86), with a = F_a.n and J n.n = a.c,

        P.n = mu a + (lambda (J - 1) - mu/J) c,

    so mu J n.n = t.c - (lambda (J - 1) - mu/J) c.c, a quadratic equation with one positive root:

        (mu n.n + lambda c.c) J^2 - (t.c + lambda c.c) J - mu c.c = 0.

    Then a = (t - (lambda (J - 1) - mu/J) c)/mu and w_a = (a - F_0.n)/n.n make P_a.n = t on the
    surface exactly. u_0 and t are free, so the fields are as smooth as the level: any contrast,
    any surface, plane or 3D. Here u_0 stretches, shears and bends, and t is about a quarter of the
    softer shear modulus and varies along the surface.
    """
    d = mesh.geometry.dim
    X = ufl.SpatialCoordinate(mesh)
    u_0, n = _base(X), ufl.grad(level)
    F_0 = ufl.Identity(d) + ufl.grad(u_0)
    c, nn = ufl.dot(ufl.cofac(F_0), n), ufl.dot(n, n)
    cc = ufl.dot(c, c)
    softer = min(material.parameters["mu"] for material in materials)
    t = softer * (1 + 0.3 * ufl.sin(2 * X[1])) * ufl.as_vector([0.25, 0.15, 0.1][:d])
    tc = ufl.dot(t, c)
    u = []
    for material in materials:
        mu, lmbda = material.parameters["mu"], material.parameters["lmbda"]
        p, q = mu * nn + lmbda * cc, tc + lmbda * cc
        J = (q + ufl.sqrt(q**2 + 4 * p * mu * cc)) / (2 * p)
        a = (t - (lmbda * (J - 1) - mu / J) * c) / mu
        u.append(u_0 + level * (a - ufl.dot(F_0, n)) / nn)
    return Exact(tuple(u), t / ufl.sqrt(nn))


def _base(X: Expr) -> Expr:
    """u_0 (d,) [mm]."""
    if len(X) == 2:
        x, y = X
        return ufl.as_vector([0.1 * ufl.sin(2 * y) + 0.1 * x, 0.15 * y + 0.1 * ufl.cos(2 * x + y)])
    x, y, z = X
    bend = 0.1 * x * (1 + y) - 0.05 * z * z
    return ufl.as_vector([0.1 * x + 0.1 * y * z, 0.1 * y + 0.1 * x * z, bend])
