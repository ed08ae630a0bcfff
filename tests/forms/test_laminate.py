"""Laminates: energies and stiffnesses of their plies, several of them in one layer of cells."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.scenes import everywhere, two_blocks

import vmdg
from vmdg.meshes import plates

PLY = {"E": (147e3, 10.6e3, 9.8e3), "nu": (0.33, 0.31, 0.4), "G": (5.45e3, 5.1e3, 3.9e3)}
#: An unsymmetric stack, so that B is there too.
ANGLES, THICKNESS = (0, 20, 20, 0, -20, 90), (0.1, 0.2, 0.1, 0.15, 0.15, 0.3)


def ply(angle: float = 0.0) -> vmdg.Orthotropic:
    return vmdg.Orthotropic(**PLY, angle=angle)


def stack(bottom: float = 0.0, **options) -> vmdg.Laminate:
    return vmdg.Laminate([ply(angle) for angle in ANGLES], THICKNESS, bottom, **options)


def reduced(angle: float) -> np.ndarray:
    """Stiffness of a ply in plane stress, turned by the formulas of Jones 1999, 2.6 (3, 3)."""
    (E1, E2, _), nu12, G12 = PLY["E"], PLY["nu"][0], PLY["G"][0]
    scale = 1 - nu12**2 * E2 / E1
    Q11, Q22, Q12, Q66 = E1 / scale, E2 / scale, nu12 * E2 / scale, G12
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    mixed = 2 * (Q12 + 2 * Q66) * s**2 * c**2
    Q16 = (Q11 - Q12 - 2 * Q66) * s * c**3 + (Q12 - Q22 + 2 * Q66) * s**3 * c
    Q26 = (Q11 - Q12 - 2 * Q66) * s**3 * c + (Q12 - Q22 + 2 * Q66) * s * c**3
    full = np.array(
        [
            [Q11 * c**4 + mixed + Q22 * s**4, 0, Q16],
            [0, Q11 * s**4 + mixed + Q22 * c**4, Q26],
            [Q16, Q26, (Q11 + Q22 - 2 * Q12 - 2 * Q66) * s**2 * c**2 + Q66 * (s**4 + c**4)],
        ]
    )
    full[0, 1] = full[1, 0] = (Q11 + Q22 - 4 * Q66) * s**2 * c**2 + Q12 * (s**4 + c**4)
    return full


def test_plate_stiffness():
    """A, B and D of the plies."""
    z = np.concatenate([[0], np.cumsum(THICKNESS)]) - sum(THICKNESS) / 2
    for k, found in enumerate(stack().plate_stiffness(), start=1):
        expected = sum(
            reduced(angle) * (high**k - low**k) / k
            for angle, low, high in zip(ANGLES, z[:-1], z[1:], strict=True)
        )
        assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


def bent(comm, laminates, rows: int, kinematics: str = "small") -> vmdg.Problem:
    """Two plates of 1 mm, stretched, sheared, bent and twisted: strains are linear in z."""
    height = sum(THICKNESS)
    tagged = plates(comm, (0, 1, 2), (0, 1), height, rows, precrack=1)
    tie = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
    materials = dict(enumerate(laminates, start=1))
    problem = vmdg.Problem(
        tagged.mesh, tagged.cell_tags, materials, [tie], degree=2, kinematics=kinematics
    )

    def u(x, t):
        k1, k2, twist, e1, shear = 1e-3 * t * np.array([3.0, -2.0, 1.5, 2.0, -1.0])
        X, Y, Z = x
        return np.array(
            [
                (k1 * Z + e1) * X + twist * Y * Z + shear * Y,
                k2 * Y * Z + twist * X * Z,
                -(k1 * X**2 + k2 * Y**2) / 2 - twist * X * Y,
            ]
        )

    problem.dirichlet_points(everywhere, u)
    vmdg.solve(problem, [1.0], vmdg.SolveOptions(relative_tolerance=1e-12))
    return problem


@pytest.mark.parametrize("rows", [1, 2])
def test_energy_is_that_of_the_plies(comm, rows):
    """Strains linear in z: cells over all plies or half of them, or thin ones of `Orthotropic`."""
    height = sum(THICKNESS)
    below, above = stack(-height, rows=rows), stack(0.0, rows=rows)
    found = bent(comm, (below, above), rows).energy().stored
    # Every ply in layers of its own: cells of .05 mm, each of one ply.
    levels = np.concatenate([[0], np.cumsum(THICKNESS)])

    def angle(x):
        at = np.searchsorted(levels, np.where(x[2] < 0, x[2] + height, x[2])) - 1
        return np.array(ANGLES, dtype=float)[at]

    fine = vmdg.Orthotropic(**PLY, angle=angle)
    expected = bent(comm, (fine, fine), round(height / 0.05)).energy().stored
    assert found == pytest.approx(expected, rel=1e-10)


MISTAKES = [
    ({"plies": []}, ValueError, "0 plies"),
    ({"plies": [vmdg.NeoHookean(E=1, nu=0.3)]}, TypeError, "must be Ortho"),
    (
        {"plies": [vmdg.Orthotropic(**PLY, angle=lambda x: x[0])]},
        TypeError,
        "angle of a ply = .* must be one number",
    ),
    ({"thickness": (0.1, 0.1)}, ValueError, r"1 plies, and a .* shape \(2,\)"),
    ({"thickness": 0.0}, ValueError, "thickness = 0.0 must be positive"),
    ({"rows": 0}, ValueError, "rows = 0 must be at least 1"),
    ({"plies": [ply(45), ply(-45)] * 2, "rows": 2}, ValueError, "layer 0 .* row per"),
]


@pytest.mark.parametrize(("changed", "error", "message"), MISTAKES)
def test_refused(changed, error, message):
    """Plies that make no laminate."""
    with pytest.raises(error, match=message):
        vmdg.Laminate(**({"plies": [ply()], "thickness": 0.1} | changed))


def test_layers_that_do_not_fit(comm):
    """Cells across the layers, and a mesh without z, refused on every rank."""
    laminate = vmdg.Laminate([ply()], 1.0, rows=2)
    with pytest.raises(ValueError, match=r"needs layers of cells between z = .*see rows="):
        bent(comm, (laminate, laminate), 1)
    scene = two_blocks(comm, "quadrilateral", 2)
    tie = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
    with pytest.raises(ValueError, match=r"must be 3D|layers of cells"):
        vmdg.Problem(scene.mesh, scene.cell_tags, {1: laminate, 2: laminate}, [tie])
