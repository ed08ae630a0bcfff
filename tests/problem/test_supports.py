"""Pieces that hang on a single point are found, and told of where a step fails."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from support.problems import joined
from support.scenes import LEFT, two_blocks

import vmdg
from vmdg.checks.supports import hanging_piece, stabilize_pieces

BOND = vmdg.Debonding(strength=10.0, critical_gap=0.05)


def worn(comm, cell: str, near, left=0.0, pressed: bool = False) -> vmdg.Problem:
    """Two blocks of which the right one hangs on the points of the bond that are ``near``."""
    scene = two_blocks(comm, cell, 2)
    problem = joined(scene, BOND)
    problem.dirichlet(scene.facet_tags.find(LEFT), left)
    for active in problem.discretization.active.values():
        q = active.quadrature
        softening = np.where(near(q.points.T), 0.0, BOND.strength)
        traction = -q.normal if pressed else active.history.traction
        active.history = replace(active.history, softening=softening, traction=traction)
    return problem


@pytest.mark.parametrize(
    ("cell", "near", "free"),
    [
        ("quadrilateral", lambda x: x[1] < 0.2, "rotation"),
        ("quadrilateral", lambda x: abs(x[1] - 0.5) < 0.2, ""),
        ("quadrilateral", lambda x: x[1] < 0.5, ""),
        ("quadrilateral", lambda x: x[1] < 0, "translation along x, translation along y, rotation"),
        ("hexahedron", lambda x: x[1] < 0.2, "rotation"),
        ("hexahedron", lambda x: (x[1] < 0.2) | (x[2] < 0.2), ""),
    ],
)
def test_hanging_piece(comm, cell, near, free):
    """On one point, in 3D on points on a line, a piece can turn; not on two points apart, or on
    what is left of an edge."""
    said, d = hanging_piece(worn(comm, cell, near)), 2 if cell == "quadrilateral" else 3
    if not free:
        assert said == ""
        return
    assert said.startswith("A piece of the body of tag 2, ")
    assert f"unconstrained against {free}: " in said
    assert f"between {[1.0, 0.0, 0.0][:d]} and {[2.0, 1.0, 1.0][:d]} " in said


def test_pressed_points_hold(comm):
    """A piece whose bond is gone all over leans on what it is pressed against."""
    nowhere = {"cell": "quadrilateral", "near": lambda x: x[1] < 0}
    assert hanging_piece(worn(comm, **nowhere))
    assert not hanging_piece(worn(comm, **nowhere, pressed=True))


def test_held_where_it_comes_to_rest(comm):
    """A block on one point goes along with it, unstrained, and the run warns of it once.

    Without that stiffness rounding says whether the tangent has a negative eigenvalue, and a step
    fails.
    """
    problem = worn(comm, "quadrilateral", lambda x: x[1] < 0.2, lambda t: (0.0, t))
    told = "A piece .* unconstrained against rotation: .* From load factor 0 on, a small"
    with pytest.warns(vmdg.ModelWarning, match=told) if comm.rank == 0 else nullcontext() as said:
        assert stabilize_pieces(problem)
        options = vmdg.SolveOptions(unstable="trace")
        history = vmdg.solve(problem, [0.05, 0.1, 0.15], options).history
        assert not stabilize_pieces(problem)
    assert comm.rank > 0 or len(said) == 1
    assert np.isin([0.05, 0.1, 0.15], history["load"]).all()
    point = problem.state[0]
    assert abs(point.opening[point.softening == 0]).max(initial=0.0) < 1e-12
    assert problem.energy().stored == pytest.approx(0.0, abs=1e-12)


@pytest.mark.filterwarnings("ignore::vmdg.ModelWarning")  # of the load and the drag
def test_told_where_a_step_fails(comm):
    """The failure of a step names the piece, which has been held from the first attempt on."""
    problem = worn(comm, "quadrilateral", lambda x: x[1] < 0.2)
    problem.body_force(lambda t: np.array([0.0, 100 * t]))
    options = vmdg.SolveOptions(max_cuts=0, max_iterations=0)
    told = "residuals: .* N.\\) A piece of .* unconstrained against rotation"
    with pytest.raises(vmdg.StepFailure, match=told):
        vmdg.solve(problem, [1.0], options)
    assert problem.step.scales.held


def test_supports_given_later_count(comm):
    """What is known of a problem's supports is forgotten with the next one."""
    scene = two_blocks(comm, "quadrilateral", 2)
    problem = joined(scene, vmdg.Bonded())
    left = scene.facet_tags.find(LEFT)
    problem.dirichlet(left, lambda t: 1e-3 * t, "x")
    for _ in range(2):
        with pytest.raises(ValueError, match="against translation along y: the solution"):
            vmdg.solve(problem, [1.0])
    problem.dirichlet(left, 0.0, "y")
    assert vmdg.solve(problem, [1.0]).history["load"] == [1.0]
