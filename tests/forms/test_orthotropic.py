"""Orthotropic bodies: moduli against the rotated compliance, and angles in all ways of giving."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.scenes import everywhere, two_blocks, unit_box

import vmdg

PLY = {"E": (161e3, 11.38e3, 9.8e3), "nu": (0.32, 0.29, 0.43), "G": (5.2e3, 4.9e3, 3.9e3)}
PAIRS = ((0, 1), (0, 2), (1, 2))
STRAIN = np.array([[3.0, 1.2, -0.7], [1.2, -2.0, 0.9], [-0.7, 0.9, 1.5]]) * 1e-3


def stiffness(angle: float) -> np.ndarray:
    """C (3, 3, 3, 3) by the inverse of the compliance on symmetric tensors, then turned."""
    S = np.zeros((6, 6))
    S[range(3), range(3)] = 1 / np.array(PLY["E"])
    for n, (i, j) in enumerate(PAIRS):
        S[i, j] = S[j, i] = -PLY["nu"][n] / PLY["E"][i]
        S[3 + n, 3 + n] = 1 / (2 * PLY["G"][n])
    basis = np.zeros((6, 3, 3))
    basis[range(3), range(3), range(3)] = 1
    for n, (i, j) in enumerate(PAIRS):
        basis[3 + n, i, j] = basis[3 + n, j, i] = math.sqrt(0.5)
    C = np.einsum("ab,aij,bkl->ijkl", np.linalg.inv(S), basis, basis)
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    Q = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return np.einsum("ia,jb,kc,ld,abcd->ijkl", Q, Q, Q, Q, C)


@pytest.mark.parametrize("kinematics", ["small", "finite"])
@pytest.mark.parametrize("angle", [0.0, 37.0, 90.0])
@pytest.mark.parametrize("cell", ["triangle", "hexahedron", "axisymmetric"])
def test_homogeneous_strain(comm, cell, angle, kinematics):
    """Cauchy stress of a body whose boundary moves by F X: C:E, pushed forward at finite strain.

    In axisymmetry axis 3 is the hoop, which stretches as r does; all nodes move as given, since
    different stresses along r and hoop are in no equilibrium.
    """
    symmetry = cell if cell == "axisymmetric" else None
    mesh = unit_box(comm, "triangle", 1) if symmetry else unit_box(comm, cell, 2)
    d = mesh.geometry.dim
    H = STRAIN + np.array([[0, 2, 0], [-2, 0, 1], [0, -1, 0]]) * 1e-3
    if kinematics == "finite":
        H *= 30
    if d == 2:
        H[2] = H[:, 2] = 0
    if symmetry:
        H[0, 1], H[2, 2] = 0, H[0, 0]
    tags = vmdg.split_cells(mesh, lambda x: x[0] - 2, "all")
    problem = vmdg.Problem(
        mesh,
        tags,
        {"all": vmdg.Orthotropic(**PLY, angle=angle)},
        [],
        kinematics=kinematics,
        symmetry=symmetry,
    )
    problem.dirichlet(everywhere, lambda x, t: t * (H[:d, :d] @ x[:d]))
    vmdg.solve(problem, [1.0], vmdg.SolveOptions(relative_tolerance=1e-12))
    F = np.eye(3) + H
    if kinematics == "small":
        expected = np.einsum("ijkl,kl->ij", stiffness(angle), (H + H.T) / 2)
    else:
        S = np.einsum("ijkl,kl->ij", stiffness(angle), (F.T @ F - np.eye(3)) / 2)
        expected = F @ S @ F.T / np.linalg.det(F)
    stress = problem.stress().x.array.reshape(-1, 3, 3)
    assert np.abs(stress - expected).max(initial=0) < 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_cubic_crystal(comm, cell):
    """Stress under homogeneous strain, in 2D that in the plane: that of the turned tensor."""
    C = np.zeros((3, 3, 3, 3))
    for i in range(3):
        C[i, i, i, i] = COPPER["C11"]
        for j in {0, 1, 2} - {i}:
            C[i, i, j, j] = COPPER["C12"]
            C[i, j, i, j] = C[i, j, j, i] = COPPER["C44"]
    mesh = unit_box(comm, cell, 1)
    d = mesh.geometry.dim
    strain = STRAIN * (np.outer([1, 1, d == 3], [1, 1, d == 3]))
    tags = vmdg.split_cells(mesh, lambda x: x[0] - 2, "all")
    c, s = math.cos(math.radians(20)), math.sin(math.radians(20))
    about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    for axes, given in ((TURN, {"rotation": TURN}), (about_z, {"angle": 20.0})):
        crystal = vmdg.Cubic(**COPPER, **given)
        problem = vmdg.Problem(mesh, tags, {"all": crystal}, [], kinematics="small")
        problem.dirichlet(everywhere, lambda x, t: strain[:d, :d] @ x[:d])
        vmdg.solve(problem, [1.0])
        turned = np.einsum("ia,jb,kc,ld,abcd->ijkl", axes, axes, axes, axes, C)
        expected = np.einsum("ijkl,kl->ij", turned, strain)
        if d == 2:
            expected[2, :2] = expected[:2, 2] = 0
        stress = problem.stress().x.array.reshape(-1, 3, 3)
        assert np.abs(stress - expected).max(initial=0) < 1e-9 * np.abs(expected).max()


#: Columns 1, 2, 3 of the crystal: turned about x by 30, then about z by 50 degrees.
TURN = np.array(
    [
        [math.cos(0.87), -math.sin(0.87) * 0.8, math.sin(0.87) * 0.6],
        [math.sin(0.87), math.cos(0.87) * 0.8, -math.cos(0.87) * 0.6],
        [0.0, 0.6, 0.8],
    ]
)
COPPER = {"C11": 168.4e3, "C12": 121.4e3, "C44": 75.4e3}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            COPPER | {"C12": 170e3},
            r"is not positive definite; it must satisfy C44 > 0, C11 > \|C12\|",
        ),
        (COPPER | {"rotation": -np.eye(3)}, "orthonormal columns"),
        (COPPER | {"rotation": TURN, "angle": 5.0}, "an angle or a rotation, not both"),
        (COPPER | {"rotation": np.eye(2)}, r"must be a matrix \(3, 3\)"),
    ],
)
def test_cubic_refused(given, message):
    """Constants that make no crystal."""
    with pytest.raises(ValueError, match=message):
        vmdg.Cubic(**given)


MISTAKES = {
    "two moduli": ({"E": (1.0, 2.0)}, TypeError, r"E = \(1.0, 2.0\) must be three numbers"),
    "a modulus in space": ({"G": np.ones((3, 4))}, TypeError, "three numbers"),
    "no modulus": ({"G": (1.0, 0.0, 1.0)}, ValueError, "G = .* must be positive"),
    "ratios mixed up": ({"nu": (4.0, 0.3, 0.3)}, ValueError, "was nu_ji given for nu_ij"),
    "no angle": ({"angle": math.nan}, ValueError, "angle = nan must be finite"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_refused(mistake):
    """Constants that make no material."""
    changed, error, message = MISTAKES[mistake]
    with pytest.raises(error, match=message):
        vmdg.Orthotropic(**(PLY | changed))


@pytest.mark.parametrize(
    ("angle", "message"),
    [
        (lambda x: x[0] * np.nan, "angle of the material of tag 1: not finite in"),
        (lambda x: x, "angle of the material of tag 1: .* one number|array with a value"),
        (np.ones(3), r"it has shape \(3,\), and there are"),
        ("steep", "array with a value for each local cell"),
    ],
    ids=["nan", "vector", "short array", "word"],
)
def test_angle_refused(comm, angle, message):
    """An angle without a value in each cell, refused on every rank."""
    scene = two_blocks(comm, "triangle", 2)
    material = vmdg.Orthotropic(**PLY, angle=angle)
    tie = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
    with pytest.raises(ValueError, match=message):
        vmdg.Problem(scene.mesh, scene.cell_tags, {1: material, 2: material}, [tie])
