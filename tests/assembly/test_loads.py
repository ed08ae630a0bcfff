"""Dead loads that vary in space: values, functions of place and UFL expressions agree."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from support.problems import joined
from support.scenes import EVERY_DEGREE, two_blocks

import vmdg
from vmdg.base.timers import timings, timings_since


def resultants(problem: vmdg.Problem, t: float) -> tuple[np.ndarray, float]:
    """Total external force (2,) and its moment about the origin, the same on every rank."""
    problem.loading.move(t)
    problem.u.x.array[:] = 0
    forces = -problem.step.assemble_residual().reshape(-1, 2)
    x = problem.space.tabulate_dof_coordinates()[: len(forces)]
    moment = x[:, 0] @ forces[:, 1] - x[:, 1] @ forces[:, 0]
    total = problem.comm.allreduce(np.append(forces.sum(axis=0), moment))
    return total[:2], total[2]


def make(comm, cell="triangle", degree=1):
    """Blocks [0, 1] and [1, 2] x [0, 1] without loads, and their facet tags."""
    scene = two_blocks(comm, cell, 2)
    return joined(scene, vmdg.Bonded(), degree=degree), scene


def ramp(problem):
    """The three ways to give t (1 + 2 x, y): f(x, t) and UFL."""
    X, Y = ufl.SpatialCoordinate(problem.mesh)
    t = problem.load_factor
    return [
        lambda x, t: t * np.stack([1 + 2 * x[0], x[1]]),
        ufl.as_vector([t * (1 + 2 * X), t * Y]),
    ]


@pytest.mark.parametrize(("way", "degree"), [(0, 1), (1, 2)])
def test_body_force_in_space(comm, way, degree):
    """Resultant and moment of t (1 + 2 x, y) on [0, 2] x [0, 1]; of the right half with its tag."""
    problem, _ = make(comm, degree=degree)
    problem.body_force(ramp(problem)[way])
    force, moment = resultants(problem, 3.0)
    assert force == pytest.approx([3 * 6, 3 * 1], rel=1e-12)
    assert moment == pytest.approx(3 * (1.0 - 3.0), rel=1e-12)
    problem, _ = make(comm, degree=degree)
    problem.body_force(ramp(problem)[way], tag=2)
    force, _ = resultants(problem, 1.0)
    assert force == pytest.approx([4.0, 0.5], rel=1e-12)


def test_errors_at_the_door(comm):
    """Wrong shapes and test functions are refused."""
    problem, scene = make(comm)
    facets = scene.facet_tags.find(2)
    with pytest.raises(ValueError, match=r"traction: the value has shape \(3,\)"):
        problem.traction(facets, [1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match=r"body_force: the value has shape \(3, \d+\)"):
        problem.body_force(lambda x, t: x)
    with pytest.raises(ValueError, match=r"the value has shape \(\), expected \(2,\)"):
        problem.body_force(ufl.SpatialCoordinate(problem.mesh)[0])
    with pytest.raises(ValueError, match="test or trial function"):
        problem.body_force(ufl.TestFunction(problem.space))


def at(*place: float):
    return lambda x: np.all([np.isclose(x[i], c) for i, c in enumerate(place)], axis=0)


@EVERY_DEGREE
def test_point_load(comm, degree):
    """Resultant and moment of forces at two corners, given in all ways."""
    problem, _ = make(comm, degree=degree)
    problem.point_load(at(2, 1), lambda t: (3 * t, 0.0))
    problem.point_load(at(2, 0), 5.0, "y")
    force, moment = resultants(problem, 2.0)
    assert force == pytest.approx([6.0, 5.0], rel=1e-14)
    assert moment == pytest.approx(2 * 5.0 - 1 * 6.0, rel=1e-14)


POINT_LOADS = [
    (lambda s: (s.facet_tags.find(1), 1.0, "x"), TypeError, "must be a predicate"),
    (lambda s: (at(7, 7), 1.0, "x"), ValueError, "no node is selected on any rank"),
    (
        lambda s: (at(1, 0), 1.0, "x"),
        ValueError,
        r"lies on interface 0 \(between=.* neighbouring node",
    ),
    (lambda s: (at(2, 0), 1.0, None), ValueError, r"shape \(\), expected \(2,\)"),
    (lambda s: (at(2, 0), lambda x, t: x[0], "x"), ValueError, "number, array or f"),
]


@pytest.mark.parametrize(("arguments", "error", "message"), POINT_LOADS)
def test_point_load_refused(comm, arguments, error, message):
    """Refused on every rank."""
    problem, scene = make(comm)
    with pytest.raises(error, match=message):
        problem.point_load(*arguments(scene))


def test_constant_loads_are_assembled_once(comm):
    """Whatever a run asks for them; again where a load factor, a Constant or a Function changes."""
    problem, scene = make(comm)
    weight, field = fem.Constant(problem.mesh, (0.0, -1.0)), fem.Function(problem.space)
    problem.dirichlet(scene.facet_tags.find(1), lambda t: 1e-3 * t)
    problem.body_force(weight)
    problem.body_force(field, tag=2)
    top = scene.facet_tags.find(5)

    def assembled(*loads):
        before = timings()
        vmdg.solve(problem, loads)
        done = timings_since(before)
        return sum(timing.runs for timing in done if timing.name == "assemble loads")

    assert assembled(0.5, 1.0) == 1
    assert resultants(problem, 1.0)[0] == pytest.approx([0.0, -2.0], abs=1e-12)
    assert assembled(1.5) == 0
    weight.value[:] = 0.0, -3.0
    field.x.array[:] = 1.0
    assert resultants(problem, 1.0)[0] == pytest.approx([1.0, -5.0], abs=1e-12)
    problem.traction(top, lambda t: (t, 0.0))
    forces = [resultants(problem, t)[0][0] for t in (1.0, 2.0, 1.0)]
    assert forces == pytest.approx([3.0, 5.0, 3.0])


def test_loads_that_change_on_one_rank_alone(comm):
    """The other ranks do not assemble again, and nobody waits for them."""
    problem, _ = make(comm)
    near = comm.size - 1

    def force(x, t):
        return np.stack([np.full_like(x[0], t if comm.rank == near else 1.0), 0.0 * x[0]])

    problem.body_force(force)
    before = timings()
    forces = []
    for t in (1.0, 2.0, 3.0):
        problem.loading.move(t)
        forces.append(comm.allreduce(problem.loading.vector.sum()))
    done = timings_since(before)
    assert np.diff(forces) == pytest.approx(forces[1] - forces[0])
    runs = sum(timing.runs for timing in done if timing.name == "assemble loads")
    assert runs == (3 if comm.rank == near else 1)
