"""symmetry="axisymmetric": measures, consistency of the forms, tau_s, the axis, output, errors."""

from __future__ import annotations

import numpy as np
import pytest
from support.checks import assert_residual_is_energy_derivative, gather, tangent_error
from support.problems import (
    MATERIALS,
    PRECISE,
    hold,
    revolved,
    set_displacement,
    through,
    user_energy,
)
from support.scenes import BOTTOM, OUTER, TOP, everywhere, section, tag_cells, unit_box

import vmdg
from vmdg import Mode
from vmdg.output.values import facet_scalar

STRONG = vmdg.Debonding(strength=1e5, critical_gap=1e3)
LAW = vmdg.Debonding(strength=100.0, critical_gap=0.2, friction=0.4)
OGDEN = vmdg.Ogden(c=(6300.0, 12.0, -10.0), m=(1.3, 5.0, -2.0), kappa=16000.0)


USER = vmdg.Hyperelastic(user_energy, MATERIALS[0].parameters)


# Measures


# Homogeneous states


def principal_stress(material, stretches):
    """P_i of the materials here at principal stretches, by hand."""
    J, p = np.prod(stretches), material.parameters
    if not isinstance(material, vmdg.Ogden):
        return p["mu"] * (stretches - 1 / stretches) + p["lmbda"] * (J - 1) * J / stretches
    isochoric = stretches / J ** (1 / 3)
    tau = p["kappa"] * (J**2 - 1) / 2 * np.ones(3)
    for a in range(material.terms):
        power = p[f"c{a + 1}"] / p[f"m{a + 1}"] * isochoric ** p[f"m{a + 1}"]
        tau += power - power.mean()
    return tau / stretches


@pytest.mark.parametrize(
    ("cell", "degree", "material", "law"),
    [
        ("triangle", 1, MATERIALS[0], vmdg.Bonded()),
        ("triangle", 2, OGDEN, STRONG),
        ("quadrilateral", 1, USER, STRONG),
        ("quadrilateral", 2, MATERIALS[0], vmdg.Bonded()),
    ],
    ids=["(86)", "(87)", "user", "(86) of degree 2"],
)
def test_triaxial_stretch(comm, cell, degree, material, law):
    """u = (a r, b z) at finite strain, prescribed on the surface of a rod, holds inside.

    It lies in the space, and the quadrature integrates the residual of a uniform P exactly, also
    on distorted cells: 1e-11 is the solver's tolerance. Forces and energy are those of the rod.
    """
    a, b = 0.2, -0.15
    stretches = np.array([1 + a, 1 + b, 1 + a])
    scene = section(comm, cell, (2, 3), height=1.5, distortion=0.04)
    problem = revolved(scene, law, (material, material), degree=degree)
    problem.dirichlet(scene.facet_tags.find(OUTER), lambda t: 2.0 * a * t, "x")
    hold(problem, scene, BOTTOM, component="y")
    problem.dirichlet(scene.facet_tags.find(TOP), lambda t: 1.5 * b * t, "y")
    vmdg.solve(problem, [0.5, 1.0], PRECISE)
    X = problem.space.tabulate_dof_coordinates()[:, :2]
    u = problem.u.x.array.reshape(-1, 2)
    assert np.abs(u - X * [a, b]).max(initial=0) < 1e-11
    P = principal_stress(material, stretches)
    top = problem.reaction(scene.facet_tags.find(TOP))
    outer = problem.reaction(scene.facet_tags.find(OUTER))
    assert top[1] == pytest.approx(P[1] * np.pi * 2.0**2, rel=1e-10)
    assert outer[0] == pytest.approx(P[0] * 2 * np.pi * 2.0 * 1.5, rel=1e-10)
    state = problem.state[0]
    assert state.traction == pytest.approx(state.normal * P[:2], rel=1e-9, abs=1e-9 * abs(P[0]))
    assert np.abs(problem.fine_scale(0)).max(initial=0) < 1e-11
    assert facet_scalar(problem, 0, "fine_scale").max(initial=0) < 1e-11
    # Cauchy stress P.F^T / J, the hoop stress on the axis too.
    sigma = problem.stress().x.array.reshape(-1, 3, 3)
    expected = np.diag(P * stretches / np.prod(stretches))
    assert sigma == pytest.approx(np.tile(expected, (len(sigma), 1, 1)), abs=1e-9 * abs(P[0]))


# Consistency


def put(problem, scene, move, turn=0.0):
    """Bend both bodies, move the outer one by ``move`` and turn the section a little."""
    waves = np.array([[2.0, 1.0], [-1.0, 2.0]])
    c, s = np.cos(turn), np.sin(turn)

    def field(x, tag):
        bent = x[:2] + 0.01 * np.sin(waves @ x[:2] + np.array([[1.0], [2.0]]))
        bent += (tag == 2) * np.asarray(move)[:, None] * (1 + 0.5 * x[1])
        return np.array([[c, -s], [s, c]]) @ bent - x[:2]

    set_displacement(problem.u, scene.cell_tags, field)


# Two motions of the outer body, friction, and the branch of the return map in the second motion.
MOTIONS = {
    "bonded": ((0.0005, 0.0002), (0.0008, 0.0004), 0.4, Mode.ELASTIC),
    "damaging": ((0.03, 0.01), (0.06, 0.04), 0.4, Mode.TENSION),
    "sheared": ((-0.004, 0.03), (-0.004, 0.06), 0.02, Mode.SHEAR),
    "sliding": ((-0.03, 0.15), (-0.03, 0.3), 0.4, Mode.FRICTION),
}


def moved(comm, cell, degree, motion, law=None, materials=MATERIALS, jump=False, frame="reference"):
    """Two tubes in the second of two motions, the first one committed."""
    first, second, friction, _ = MOTIONS[motion]
    law = law or vmdg.Debonding(strength=100.0, critical_gap=0.2, friction=friction)
    scene = section(comm, cell, (1, 2), (0.5, 1.2, 2.0), distortion=0.03)
    interface = {"traction_jump": jump, "frame": frame}
    problem = revolved(scene, law, materials, interface, degree=degree)
    motions = (first, 0.05), (second, 0.1)
    return through(problem, *(lambda m=m: put(problem, scene, *m) for m in motions))


@pytest.mark.parametrize(
    ("cell", "degree", "frame", "motion"),
    [
        ("triangle", 2, "reference", "damaging"),
        ("quadrilateral", 1, "corotating", "bonded"),
        ("triangle", 2, "reference", "sheared"),
        ("quadrilateral", 1, "corotating", "sliding"),
    ],
)
def test_tangent(comm, cell, degree, motion, frame):
    """The tangent is the derivative of the residual in every branch of the law."""
    problem = moved(comm, cell, degree, motion, frame=frame)
    assert tangent_error(problem) < 1e-7
    problem.step.commit()
    assert (gather(comm, problem.state[0].mode) == MOTIONS[motion][-1]).all()


@pytest.mark.parametrize(
    ("law", "jump"), [(vmdg.Bonded(), True), (LAW, False)], ids=["tie", "debonding"]
)
def test_residual_is_the_derivative_of_the_energy(comm, law, jump):
    """Bulk and interface residual = d/du of their energies with zeta held, to rounding."""
    problem = moved(comm, "quadrilateral", 1, "damaging", law, jump=jump)
    assert_residual_is_energy_derivative(problem)


@pytest.mark.parametrize(
    ("cell", "activate"), [("triangle", "all"), ("quadrilateral", "on-demand")]
)
def test_crack_across_the_axis(comm, cell, activate):
    """A rod parts at an interface that crosses the axis: P_c zeta_c/2 times the area of the disc.

    The sides are on rollers, so that the state is uniform and the damage exact.
    """
    mesh = unit_box(comm, cell, 4)
    tags = tag_cells(mesh, {1: everywhere, 2: lambda x: x[1] > 0.5})
    law = vmdg.Debonding(strength=100.0, critical_gap=0.2)
    interface = vmdg.Interface(between=(1, 2), law=law, activate=activate)
    materials = dict.fromkeys((1, 2), MATERIALS[0])
    problem = vmdg.Problem(mesh, tags, materials, [interface], symmetry="axisymmetric")
    problem.dirichlet(lambda x: np.isclose(x[0], 1), 0.0, "x")
    problem.dirichlet(lambda x: np.isclose(x[1], 0), 0.0, "y")
    problem.dirichlet(lambda x: np.isclose(x[1], 1), lambda t: t, "y")
    vmdg.solve(problem, 0.25 * np.arange(1, 11) / 10, PRECISE)
    energy = problem.energy()
    assert energy.damage == pytest.approx(np.pi * 100.0 * 0.2 / 2, rel=1e-9)


# tau_s


def gauss(n=12):
    """Gauss points and weights on (0, 1)."""
    x, w = np.polynomial.legendre.leggauss(n)
    return (x + 1) / 2, w / 2


def tau_of_square(inner, facet_outside, mu, lmbda):
    """(21)-(22) of the unit square [inner, inner + 1] x [0, 1] at F = I, from its definition."""
    r, wr = gauss()
    z, wz = gauss()
    r, z = np.meshgrid(r, z, indexing="ij")
    weights = np.outer(wr, wz) * 2 * np.pi * (inner + r)
    decay, slope = (r, 1.0) if facet_outside else (1 - r, -1.0)
    profile, change = 4 * z * (1 - z), 4 - 8 * z
    b, b_r, b_z = decay * profile, slope * profile, decay * change
    gradients = np.zeros((2, 3, 3, *r.shape))
    gradients[0, 0, 0], gradients[0, 0, 1], gradients[0, 2, 2] = b_r, b_z, b / (inner + r)
    gradients[1, 1, 0], gradients[1, 1, 1] = b_r, b_z
    strain = (gradients + gradients.swapaxes(1, 2)) / 2
    trace = np.einsum("immrz->irz", gradients)
    B = 2 * mu * np.einsum("imnrz,kmnrz,rz->ik", strain, strain, weights)
    B += lmbda * np.einsum("irz,krz,rz->ik", trace, trace, weights)
    circle = 2 * np.pi * (inner + facet_outside)
    return (2 / 3 * circle) ** 2 / circle * np.linalg.inv(B)


@pytest.mark.parametrize("inner, accuracy", [(0.0, 2e-5), (1.0, 1e-5), (30.0, 1e-11)])
def test_tau_of_two_squares(comm, inner, accuracy):
    """tau_s and delta equal (21)-(23) with their hoop terms, integrated here by many points.

    The three points of the engine are exact but for b^2/r, so the accuracy grows with the radius
    (on the axis the term of the inner cell is a polynomial, that of the outer one is not).
    """
    scene = section(comm, "quadrilateral", (1, 1), (inner, inner + 1, inner + 2))
    problem = revolved(scene, vmdg.Bonded(), interface={"safety": 4.0})
    tau = [
        tau_of_square(inner + side, side == 0, *(m.parameters[k] for k in ("mu", "lmbda")))
        for side, m in enumerate(MATERIALS)
    ]
    total = np.linalg.inv(tau[0] + tau[1])
    found = problem.stabilization[0]
    if len(found.tau):
        assert np.abs(found.tau[0] - 4 * total).max() < accuracy * np.abs(4 * total).max()
        assert np.abs(found.delta[0, 0] - total @ tau[0]).max() < accuracy
        delta_s = tau[0] @ total @ tau[1]
        assert np.abs(found.delta_s[0] - delta_s).max() < accuracy * np.abs(delta_s).max()


# The axis, output and errors


def test_axis_is_held(comm):
    """u_r = 0 on the axis whatever else is prescribed, and nothing else is held."""
    scene = section(comm, "quadrilateral", (2, 2))
    problem = revolved(scene, vmdg.Bonded(), degree=2)
    X = problem.space.tabulate_dof_coordinates()
    on_axis = np.flatnonzero(np.abs(X[:, 0]) < 1e-9)
    assert comm.allreduce(len(on_axis)) > 0
    assert (problem.loading.prescribed == 2 * on_axis).all()
    problem.dirichlet(scene.facet_tags.find(TOP), (0.3, 0.1))
    prescribed, values = problem.loading.prescribed, problem.loading.prescribed_values(1.0)
    values = dict(zip(prescribed.tolist(), values, strict=True))
    assert all(values[2 * node] == 0 for node in on_axis)
    assert all(values.get(2 * node + 1, 0.1) == 0.1 for node in on_axis)


def test_errors_at_the_door(comm):
    """Words, meshes and options that make no sense."""
    flat, solid = (unit_box(comm, cell, 2) for cell in ("quadrilateral", "hexahedron"))

    def make(mesh, symmetry="axisymmetric", **options):
        tags = tag_cells(mesh, {1: everywhere})
        return vmdg.Problem(mesh, tags, {1: MATERIALS[0]}, [], symmetry=symmetry, **options)

    with pytest.raises(ValueError, match="symmetry = 'spherical' must be one of"):
        make(flat, "spherical")
    with pytest.raises(ValueError, match="needs a 2D mesh"):
        make(solid)
    with pytest.raises(ValueError, match=r"thickness = 2\.0 has no meaning"):
        make(flat, thickness=2.0)
    with pytest.raises(ValueError, match=r"thickness = -1\.0 must be positive"):
        make(flat, None, thickness=-1.0)
    flat.geometry.x[:, 0] -= 0.25
    with pytest.raises(ValueError, match=r"nodes at x = r = -0\.25 < 0"):
        make(flat)


def test_coercive_rings(comm):
    """Flat rings, nearly incompressible: the derived tau_s leaves negative modes, "auto" none.

    Eigenvalues of the bonded tangent scaled to unit diagonal, relative to the largest; rounding
    leaves 1e-14. One rank, where the matrix is whole.
    """
    if comm.size > 1:
        pytest.skip("a dense eigenvalue problem of one rank")
    nearly = [vmdg.NeoHookean(E=E, nu=0.499) for E in (1000.0, 3000.0)]
    lowest = {}
    for safety in (1.0, "auto"):
        scene = section(comm, "quadrilateral", (1, 3), (0.95, 1.0, 1.05), 1.5)
        problem = revolved(scene, vmdg.Bonded(), nearly, interface={"safety": safety})
        matrix = problem.discretization.create_matrix()
        problem.step.assemble_residual()
        problem.discretization.assemble_tangent(matrix)
        dense = matrix[:, :]
        scale = np.sqrt(np.diag(dense))
        values = np.linalg.eigvalsh(dense / scale / scale[:, None])
        lowest[safety] = values[0] / values[-1]
        matrix.destroy()
    assert lowest[1.0] < -1e-4
    assert lowest["auto"] > -1e-12
