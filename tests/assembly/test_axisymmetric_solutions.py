"""Axisymmetric solutions against closed forms, a model in 3D and the push-out of section 7.4."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from support.checks import integral
from support.problems import PRECISE, hold, revolved
from support.scenes import BOTTOM, INNER, TOP, section

import vmdg

# Strong enough to stay bonded, and a softening far below every penalty here.
STRONG = vmdg.Debonding(strength=1e4, critical_gap=1e3)


def relative_error(problem, scene, exact) -> float:
    """L2 norm of u - exact over that of exact, in the body of revolution; exact(r, tag) = u_r."""
    mesh = scene.mesh
    r = ufl.SpatialCoordinate(mesh)[0]
    dx = ufl.Measure(
        "dx", domain=mesh, subdomain_data=scene.cell_tags, metadata={"quadrature_degree": 8}
    )
    error, size = 0, 0
    for tag in (1, 2):
        u_r = exact(r, tag)
        difference = problem.u - ufl.as_vector([u_r, 0])
        error += ufl.inner(difference, difference) * r * dx(tag)
        size += u_r**2 * r * dx(tag)
    values = [integral(problem.comm, form) for form in (error, size)]
    return float(np.sqrt(values[0] / values[1]))


def rates(errors):
    return np.log2(np.array(errors[:-1]) / errors[1:])


# Closed forms


@pytest.mark.parametrize(
    ("cell", "degree", "law"),
    [
        ("triangle", 1, STRONG),
        ("triangle", 2, vmdg.Bonded()),
        ("quadrilateral", 1, vmdg.Bonded()),
        ("quadrilateral", 2, STRONG),
    ],
)
def test_tube_under_pressure(comm, cell, degree, law):
    """Lame: u_r = A r + B / r between rigid ends, in two layers; order k + 1.

    The traction between the layers is C_1 (1 - b^2 / r^2) with C_1 = p a^2 / (b^2 - a^2); it is of
    order k at least, as every stress, and its mean better. With a factor of 4 on tau_s its errors
    are of one sign; with "auto" they are smaller and cross zero between meshes.
    """
    E, nu, p, a, b, middle = 1000.0, 0.3, 10.0, 1.0, 2.0, 1.4
    C1 = p * a**2 / (b**2 - a**2)
    A, B = (1 + nu) * (1 - 2 * nu) * C1 / E, (1 + nu) * C1 * b**2 / E
    material = vmdg.NeoHookean(E=E, nu=nu)
    displacement, traction = [], []
    for n in (2, 4, 8):
        scene = section(comm, cell, (n, n), (a, middle, b), height=0.5)
        problem = revolved(
            scene, law, (material,) * 2, {"safety": 4.0}, kinematics="small", degree=degree
        )
        hold(problem, scene, BOTTOM, TOP, component="y")
        problem.traction(scene.facet_tags.find(INNER), [p, 0.0])
        vmdg.solve(problem, [1.0], PRECISE)
        displacement.append(relative_error(problem, scene, lambda r, tag: A * r + B / r))
        expected = C1 * (1 - b**2 / middle**2)
        traction.append(abs(problem.mean(0).traction[0] / expected - 1))
    assert rates(displacement)[-1] > degree + 0.8
    assert displacement[-1] < (1e-3, 1e-5)[degree - 1]
    assert np.log2(traction[0] / traction[-1]) / 2 > degree - 0.2
    assert traction[-1] < (1e-4, 1e-7)[degree - 1]


# The same tube in 3D
