"""Interfaces between any two groups, their classes, and the points where three bodies meet."""

from __future__ import annotations

import numpy as np
import pytest
from support.checks import gather
from support.scenes import everywhere, tag_cells, unit_box

import vmdg
from vmdg.meshes import polycrystal

BODY = vmdg.NeoHookean(E=1000.0, nu=0.3)
BOND = vmdg.Debonding(strength=5.0, critical_gap=0.05)


def three_bodies(comm, cell: str):
    """Unit box with one body below and two above; the three meet at (.5, .5) and above it."""
    mesh = unit_box(comm, cell, 4)
    tags = tag_cells(
        mesh, {3: everywhere, 1: lambda x: x[1] < 0.5, 2: lambda x: (x[1] > 0.5) & (x[0] < 0.5)}
    )
    return mesh, tags


def problem_of(mesh, tags, interfaces) -> vmdg.Problem:
    """Pulled apart in a direction in which all three boundaries open."""
    bodies = dict.fromkeys((1, 2, 3), BODY)
    problem = vmdg.Problem(mesh, tags, bodies, interfaces, kinematics="small")
    problem.dirichlet(lambda x: np.isclose(x[1], 0), 0.0)
    left, right = (lambda x, e=e: np.isclose(x[1], 1) & (np.abs(x[0] - e) < 0.3) for e in (0, 1))
    pull = [0.0] * (mesh.geometry.dim - 2)
    problem.dirichlet(left, lambda t: (-0.2 * t, 0.2 * t, *pull))
    problem.dirichlet(right, lambda t: (0.2 * t, 0.2 * t, *pull))
    return problem


def test_classes_of_boundaries(comm):
    """Misorientation parts the boundaries into two interfaces, which are all of them."""
    mesh, tags, facets = polycrystal(8, 1, element_size=0.1, comm=comm)
    angles = np.radians(np.r_[0, 3, 8, 20, 41, 62, 77, 84, 88])
    c, s, zero = np.cos(angles), np.sin(angles), 0 * angles
    turns = np.moveaxis(np.array([[c, -s, zero], [s, c, zero], [zero, zero, zero + 1]]), 2, 0)

    def low(a, b):
        assert (a < b).all()
        return vmdg.misorientation(turns[a], turns[b]) < 15

    interfaces = [
        vmdg.Interface(between=low, law=vmdg.Bonded()),
        vmdg.Interface(between=lambda a, b: ~low(a, b), law=vmdg.Bonded()),
        vmdg.Interface(facets.find("boundary"), law=vmdg.Bonded()),
    ]
    bodies = {
        tag: vmdg.Cubic(C11=168.4e3, C12=121.4e3, C44=75.4e3, rotation=turns[tag])
        for tag in range(1, 9)
    }
    two = vmdg.Problem(mesh, tags, bodies, interfaces[:2], kinematics="small")
    parts = [gather(comm, part.tags) for part in two.step.activation.facets]
    apart = np.abs(np.degrees(angles[parts[0][:, 0]] - angles[parts[0][:, 1]]))
    assert (np.minimum(apart, 90 - apart) < 15).all()
    one = vmdg.Problem(mesh, tags, bodies, interfaces[2:], kinematics="small")
    assert min(map(len, parts)) > 5
    assert sum(map(len, parts)) == len(gather(comm, one.step.activation.facets[0].facets))


def test_misorientation():
    """Turns that a crystal does not notice are none; others are their angle."""
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    half = np.diag([1.0, -1, -1])
    c, s = np.cos(np.pi / 3), np.sin(np.pi / 3)
    sixth = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    one = np.eye(3)
    for symmetry, angles in {
        "cubic": (0, 0, 30),
        "hexagonal": (30, 0, 0),
        "orthorhombic": (90, 0, 60),
        "triclinic": (90, 180, 60),
    }.items():
        found = [vmdg.misorientation(one, turn, symmetry) for turn in (quarter, half, sixth)]
        assert found == pytest.approx(angles, abs=1e-5)
        back = vmdg.misorientation([quarter, half, sixth], [one] * 3, symmetry)
        assert back == pytest.approx(angles, abs=1e-5)
    with pytest.raises(ValueError, match="symmetry = 'round' must be one of"):
        vmdg.misorientation(one, one, "round")
    with pytest.raises(ValueError, match=r"shapes \(2, 2\) and \(3, 3\)"):
        vmdg.misorientation(np.eye(2), one)


def test_wrong_classes(comm):
    """A rule that gives no truth values, or chooses nothing; words other than "all"."""
    mesh, tags = three_bodies(comm, "triangle")
    wrong = {
        "must return True or False for each pair": lambda a, b: a + b,
        "it fails: division": lambda a, b: 1 / 0,
        "the function is true for no two adjacent groups": lambda a, b: a > b,
    }
    for message, rule in wrong.items():
        with pytest.raises(ValueError, match=message):
            problem_of(mesh, tags, [vmdg.Interface(between=rule, law=BOND)])
    with pytest.raises(ValueError, match="between = 'grains' must be two different tags, 'all'"):
        vmdg.Interface(between="grains", law=BOND)
