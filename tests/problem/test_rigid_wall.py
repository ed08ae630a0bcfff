"""A rigid wall is one layer of stiff cells, however thin, and bears what statics say."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from support.scenes import DIMENSION, LEFT, RIGHT, two_blocks

import vmdg

E, PRESSED, FRICTION = 1000.0, 0.01, 0.3


def block_on_a_wall(comm, cell, kinematics, stiff):
    """A block, a wall so many times as stiff, friction between them; pressed, then dragged."""
    scene = two_blocks(comm, cell, 2)
    x = scene.mesh.geometry.x
    x[:, 0] = np.minimum(x[:, 0], 1 + 0.01 * (x[:, 0] - 1))  # a layer of .01 mm for block 2
    body, wall = vmdg.NeoHookean(E=E, nu=0.0), vmdg.NeoHookean(E=stiff * E, nu=0.0)
    contact = vmdg.Interface(between=(1, 2), law=vmdg.Contact(friction=FRICTION), frame="reference")
    problem = vmdg.Problem(
        scene.mesh, scene.cell_tags, {1: body, 2: wall}, [contact], kinematics=kinematics
    )
    left, right = scene.facet_tags.find(LEFT), scene.facet_tags.find(RIGHT)
    problem.dirichlet(right, 0.0)
    across = np.zeros(DIMENSION[cell] - 2)
    problem.dirichlet(left, lambda t: (PRESSED * min(t, 1), 0.03 * max(t - 1, 0), *across))
    return problem, left, right


@pytest.mark.parametrize(
    ("cell", "kinematics", "stiff"),
    [
        ("quadrilateral", "small", 1e6),
        ("quadrilateral", "finite", 1e4),
        ("tetrahedron", "finite", 1e6),
    ],
)
def test_block_on_a_wall(comm, cell, kinematics, stiff):
    """Pressed and dragged along it: E times the strain, friction times that, hardly any give."""
    problem, left, right = block_on_a_wall(comm, cell, kinematics, stiff)
    vmdg.solve(problem, [1.0])
    pressed = problem.reaction(right)
    state = problem.state[0]
    exact = E * PRESSED * (1 + (kinematics == "finite") * PRESSED / 2)
    assert pressed[0] == pytest.approx(-exact, rel=1e-3)
    assert np.abs(pressed[1:]).max() < 1e-6 * exact
    assert state.traction[:, 0] == pytest.approx(np.full(len(state.traction), -exact), rel=1e-3)
    vmdg.solve(problem, [1.5, 2.0])
    dragged = problem.reaction(right)
    assert dragged[1] == pytest.approx(FRICTION * dragged[0], rel=1e-5)
    assert dragged == pytest.approx(-problem.reaction(left), abs=1e-6 * exact)
    given = problem.space.tabulate_dof_coordinates()[:, 0] > 1 + 1e-6
    moved = problem.u.x.array.reshape(-1, DIMENSION[cell])
    assert np.abs(moved[given]).max(initial=0.0) < PRESSED / stiff


def test_too_stiff(comm):
    """Forces that drown in the rounding of a wall of 1e9 times the modulus are told, on rank 0."""
    problem, *_ = block_on_a_wall(comm, "quadrilateral", "finite", 1e9)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        vmdg.solve(problem, [1.0])
    told = [str(one.message) for one in caught if one.category is vmdg.ModelWarning]
    assert all("rounding error of the stiffest body" in text for text in told)
    assert len(told) == (comm.rank == 0)
