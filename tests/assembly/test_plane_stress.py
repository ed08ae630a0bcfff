"""Thin sheets: bodies and interfaces without stress out of the plane, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from support.checks import assert_residual_is_energy_derivative, modes, tangent_error
from support.problems import displace, of_two
from support.scenes import LEFT, RIGHT, two_blocks

import vmdg

E, NU, THICKNESS = 2000.0, 0.3, 2.5
STEEL = vmdg.NeoHookean(E=E, nu=NU)
PLY = vmdg.Orthotropic(E=(9000, 800, 700), nu=(0.3, 0.25, 0.4), G=(500, 400, 300), angle=25.0)
TIGHT = vmdg.SolveOptions(relative_tolerance=1e-13)


def tilted(axis: int, angle: float = 25.0) -> vmdg.Orthotropic:
    """PLY turned about another axis, or about z by its rotation."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    plane = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    rotation = np.roll(plane, axis, axis=(0, 1))
    return vmdg.Orthotropic(
        E=(9000, 800, 700), nu=(0.3, 0.25, 0.4), G=(500, 400, 300), rotation=rotation
    )


def sheet(scene, material=STEEL, law=None, **options) -> vmdg.Problem:
    """Two blocks of one material or of two, and their interface x = 1."""
    one, two = material if isinstance(material, tuple) else (material, material)
    return of_two(
        scene, vmdg.Bonded() if law is None else law, (one, two), plane="stress", **options
    )


def strained(problem, scene, gradient) -> None:
    """Prescribe u = gradient.x all around."""
    H = np.asarray(gradient)
    problem.dirichlet(lambda x: np.full(x.shape[1], True), lambda x, t: t * H @ x[:2])


def stretched(problem, scene) -> None:
    """Pull along x, free across."""
    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0, "x")
    problem.dirichlet(scene.facet_tags.find(RIGHT), lambda t: t, "x")
    problem.dirichlet(lambda x: np.isclose(x[1], 0), 0.0, "y")


def first_piola(stretch: float, J: float) -> float:
    """Of a principal stretch of the neo-Hookean material."""
    mu, lmbda = E / (2 * (1 + NU)), NU * E / ((1 + NU) * (1 - 2 * NU))
    return mu * (stretch - 1 / stretch) + lmbda * (J - 1) * J / stretch


def stress(problem) -> np.ndarray:
    """Cauchy stresses at the nodes of this rank (n, 3, 3)."""
    return problem.stress().x.array.reshape(-1, 3, 3)


@pytest.mark.parametrize("law", [vmdg.Bonded(), vmdg.Debonding(1e4, 50.0)], ids=["tie", "bond"])
def test_neo_hookean_pulled_to_twice_its_length(comm, law):
    """P_i = mu (l_i - 1/l_i) + lambda (J - 1) J/l_i, the two stretches s across by P_s = 0."""
    scene = two_blocks(comm, "quadrilateral", 1)
    bar = sheet(scene, law=law, thickness=THICKNESS)
    stretched(bar, scene)
    facets, forces = scene.facet_tags.find(RIGHT), []
    vmdg.solve(
        bar, np.linspace(0.25, 2.0, 8), TIGHT, lambda p: forces.append((p.t, p.reaction(facets)[0]))
    )
    for t, force in forces:
        stretch = 1 + t / 2
        s = brentq(lambda s, a=stretch: first_piola(s, a * s * s), 0.3, 1, xtol=1e-15)
        P = first_piola(stretch, stretch * s * s)
        assert force == pytest.approx(THICKNESS * P, rel=1e-10)
    found = stress(bar)
    np.testing.assert_allclose(found[:, 0, 0], P / s**2, rtol=1e-10)
    assert np.abs(found[:, 1:]).max(initial=0.0) < 1e-8 * E


@pytest.mark.parametrize(
    ("kinematics", "rotated"), [("small", False), ("finite", False), ("small", True)]
)
def test_orthotropic_sheet(comm, kinematics, rotated):
    """S = Q : E with Q_ab = C_ab - C_a3 C_b3/C_33 in the axes of the ply."""
    angle, H = np.radians(25.0), np.array([[0.05, 0.02], [0.01, -0.03]])
    c, s = np.cos(angle), np.sin(angle)
    axes = np.array([[c, -s], [s, c]])
    compliance = np.array([[1 / 9000, -0.3 / 9000], [-0.3 / 9000, 1 / 800]])
    Q = np.linalg.inv(compliance)
    F = np.eye(2) + H
    strain = (H + H.T) / 2 if kinematics == "small" else (F.T @ F - np.eye(2)) / 2
    local = axes.T @ strain @ axes
    S = np.diag(Q @ np.diag(local)) + 2 * 500 * local[0, 1] * (np.ones((2, 2)) - np.eye(2))
    P = axes @ S @ axes.T if kinematics == "small" else F @ axes @ S @ axes.T
    scene = two_blocks(comm, "triangle", 1)
    ply = sheet(scene, tilted(2) if rotated else PLY, kinematics=kinematics)
    strained(ply, scene, H)
    vmdg.solve(ply, [0.5, 1.0], TIGHT)
    state = ply.state[0]
    np.testing.assert_allclose(
        state.traction, state.normal @ P.T, rtol=0, atol=1e-9 * np.abs(P).max()
    )


def test_tangent(comm):
    """The residual is the derivative of the energy, the tangent that of the residual."""
    scene = two_blocks(comm, "quadrilateral", 2, distortion=0.1)
    problem = sheet(scene, law=vmdg.Debonding(40.0, 2.0, 0.3))
    problem.step.begin(1.0, 1.0)
    displace(problem, scene, 0.5)
    assert tangent_error(problem) < 1e-8
    assert (modes(problem) > 0).all()
    tied = sheet(scene)
    tied.step.begin(1.0, 1.0)
    displace(tied, scene, 0.5)
    assert_residual_is_energy_derivative(tied)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"plane": "stres"}, r"plane = 'stres' must be one of \('strain', 'gen"),
        ({"symmetry": "axisymmetric"}, "is for plane bodies"),
        ({"volumetric": "mean"}, "do not lock"),
        ({"material": vmdg.Ogden(c=(1.0,), m=(2.0,), kappa=10.0)}, "Ogden of tag 1 has no closed"),
        ({"material": tilted(0)}, "tilted out of the plane"),
    ],
)
def test_refused(comm, options, words):
    """At the door, with what to do instead."""
    scene = two_blocks(comm, "quadrilateral", 1)
    chosen = {"plane": "stress", **options}
    material = chosen.pop("material", STEEL)
    with pytest.raises(ValueError, match=words):
        vmdg.Problem(scene.mesh, scene.cell_tags, {1: material, 2: material}, [], **chosen)
    problem = sheet(scene)
    with pytest.raises(ValueError, match="changes its thickness"):
        problem.pressure(scene.facet_tags.find(RIGHT), 1.0)
