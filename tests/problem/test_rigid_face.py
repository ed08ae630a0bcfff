"""Rigid faces, loading plates: closed forms, equivalent problems, paths, stability, mistakes."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from dolfinx import fem
from support.problems import PRECISE, hold, joined, revolved
from support.scenes import LEFT, RIGHT, section, two_blocks

import vmdg

BOTTOM, TOP = 4, 5
E = (5000.0, 2000.0)
#: Without lateral strain, so that bars side by side do not touch.
BARS = tuple(vmdg.NeoHookean(E=e, nu=0.0) for e in E)
ONE = (vmdg.NeoHookean(E=5000.0, nu=0.2),) * 2
AT = (1.3, 1.0)


def at(*place: float):
    """Predicate of the points with these first coordinates."""
    return lambda x: np.all([np.isclose(x[i], c) for i, c in enumerate(place)], axis=0)


def side_by_side(comm, cell="quadrilateral", n=3, materials=BARS, **options):
    """Bars [0, 1] and [1, 2] x [0, 1] (x [0, 1]) on a smooth floor; facets by tag."""
    scene = two_blocks(comm, cell, n)
    problem = joined(scene, vmdg.Bonded(), materials, **{"kinematics": "small", **options})
    hold(problem, scene, BOTTOM, component="y")
    problem.dirichlet_points(at(1, 0), 0.0, "x")
    if scene.mesh.geometry.dim == 3:
        hold(problem, scene, 6, component="z")
    return problem, scene.facet_tags.find


def beside(problem, tag):
    dim = problem.mesh.topology.dim
    problem.mesh.topology.create_connectivity(dim, dim - 1)
    facets = problem.mesh.topology.connectivity(dim, dim - 1)
    cells = problem.discretization.bodies.cells_of[tag]
    return np.unique(np.concatenate([facets.links(cell) for cell in cells]))


def motion(problem, facets):
    """Nodes of facets on this rank, and their displacement (n, d)."""
    d = problem.mesh.geometry.dim
    chosen = fem.locate_dofs_topological(problem.space, d - 1, facets)
    x = problem.space.tabulate_dof_coordinates()[chosen, :d]
    return x, problem.u.x.array.reshape(-1, d)[chosen]


@pytest.mark.parametrize("way", ["force", "traction", "displacement"])
def test_composite_beam(comm, way):
    """An eccentric force bends two bars that are one: N = int E eps, M = int E eps x, eps linear.

    Given at a point of the plate, by a traction of its resultant, or as the displacement of that
    point with its reaction.
    """
    problem, find = side_by_side(comm, degree=2)
    x, force = AT[0] - 1, -50.0
    flexural = np.array([[sum(E), (E[1] - E[0]) / 2], [(E[1] - E[0]) / 2, sum(E) / 3]])
    strain, curvature = np.linalg.solve(flexural, [force, force * x])
    given = {"tilts": True, "at": AT}
    if way == "force":
        given["force"] = lambda t: force * t
    elif way == "displacement":
        given["displacement"] = lambda t: (strain + curvature * x) * t
    else:
        # Mean force/2 over the width of 2, and 2/3 of its slope for the moment.
        slope = 1.5 * force * x
        problem.traction(
            find(TOP), lambda x, t: t * np.stack([0 * x[0], force / 2 + slope * (x[0] - 1)])
        )
    plate = problem.rigid_face(find(TOP), "y", **given)
    vmdg.solve(problem, [1.0], PRECISE)
    assert plate.displacement() == pytest.approx(strain + curvature * x, rel=1e-9)
    assert plate.rotation() == pytest.approx(curvature, rel=1e-9)
    expected = force if way == "displacement" else 0.0
    assert problem.reaction(find(TOP))[1] == pytest.approx(expected, abs=1e-8)
    energy = problem.energy()
    assert energy.external == pytest.approx(force * (strain + curvature * x) / 2, rel=1e-8)


@pytest.mark.parametrize("component", ["x", None])
def test_quadratic(comm, component):
    """At finite strain a plate that tilts or is glued keeps Newton's convergence, and its shape."""
    scene = two_blocks(comm, "quadrilateral", 3)
    problem = joined(scene, vmdg.Bonded(), ONE)
    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0)
    end = scene.facet_tags.find(RIGHT)
    if component:
        plate = problem.rigid_face(end, "x", tilts=True, at=(2.0, 0.8), force=-80.0)
    else:
        plate = problem.rigid_face(end, force=(-80.0, 90.0))
    norms = np.array(vmdg.solve(problem, [1.0], PRECISE).residuals[0])
    assert (norms < 1).sum() >= 3
    assert (norms[1:] < 0.1 * norms[:-1] ** 2 + 1e-10)[norms[:-1] < 3].all()
    x, u = motion(problem, end)
    if component:
        assert abs(plate.rotation()) > 1e-3
        expected = plate.displacement() - plate.rotation() * (x[:, 1] - 0.8)
        assert u[:, 0] == pytest.approx(expected, abs=1e-13)
    else:
        assert u == pytest.approx(np.broadcast_to(plate.displacement(), u.shape), abs=1e-13)
    assert problem.reaction(scene.facet_tags.find(LEFT))[0] == pytest.approx(80.0, rel=1e-9)


def test_programme_that_is_not_linear(comm):
    """A plate is where it is prescribed, not where the last step leads."""
    problem, find = side_by_side(comm)
    plate = problem.rigid_face(find(TOP), "y", displacement=lambda t: -0.01 * t**2)
    history = vmdg.solve(problem, 4, monitor=lambda problem: {"way": plate.displacement()}).history
    assert history["way"] == pytest.approx(-0.01 * history["load"] ** 2, rel=1e-12)


def hinged(comm, **given):
    """A bonded bar on a smooth floor, pulled off its axis by a plate that may tilt."""
    scene = two_blocks(comm, "quadrilateral", 3)
    bond = vmdg.MixedModeDebonding(10.0, 14.0, 0.25, 0.35)
    problem = joined(scene, bond, ONE, kinematics="small")
    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0)
    end = scene.facet_tags.find(RIGHT)
    return problem, end, problem.rigid_face(end, "x", tilts=True, at=(2.0, 0.8), **given)


def test_force_and_displacement_lead_the_same_way(comm):
    """The traced path of a force on a hinged plate is that of the displacement of the hinge."""
    problem, _, plate = hinged(comm, force=lambda t: 12.0 * t)
    history = vmdg.solve(
        problem,
        [1.0],
        vmdg.SolveOptions(unstable="trace", relative_tolerance=1e-10),
        monitor=lambda problem: {"u": plate.displacement(), "tilt": plate.rotation()},
        until=lambda problem: plate.displacement() > 0.02,
    ).history
    u = history["u"]
    assert (np.diff(u) > 0).all()
    assert history["load"][-1] < 0.9 * history["load"].max()
    problem, end, plate = hinged(comm, displacement=lambda t: t)
    options = vmdg.SolveOptions(relative_tolerance=1e-10)
    led = vmdg.solve(
        problem,
        u,
        options,
        monitor=lambda problem: {"force": problem.reaction(end)[0], "tilt": plate.rotation()},
    ).history
    at = np.isin(led["load"], u)
    assert led["force"][at] == pytest.approx(12.0 * history["load"], rel=1e-3)
    assert led["tilt"][at] == pytest.approx(history["tilt"], rel=1e-3)


# Supports


def leaning(comm):
    """Two blocks in contact side by side, the left one on the floor."""
    scene = two_blocks(comm, "quadrilateral", 2)
    problem = joined(scene, vmdg.Contact(), ONE)
    hold(problem, scene, LEFT, RIGHT, component="x")
    find = scene.facet_tags.find
    problem.dirichlet(np.intersect1d(find(BOTTOM), beside(problem, 1)), 0.0, "y")
    return problem, find


def test_plate_holds_what_it_joins(comm):
    """Contact alone holds the right block up; with a plate on both the left one does."""
    problem, _ = leaning(comm)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        vmdg.solve(problem, [1.0])
    if comm.rank == 0:
        assert "only contact constrains the body of tag 2" in str(caught[0].message)
    problem, find = leaning(comm)
    problem.rigid_face(find(TOP), "y", force=-1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        vmdg.solve(problem, [1.0])


def test_plate_holds_nothing_by_itself(comm):
    """A body that only a plate touches is loose."""
    scene = two_blocks(comm, "quadrilateral", 2)
    problem = joined(scene, vmdg.Bonded(), ONE)
    hold(problem, scene, LEFT, component="x")
    problem.rigid_face(scene.facet_tags.find(TOP), "y", force=-1.0)
    with pytest.raises(ValueError, match=r"no constraint on .* against translation along y"):
        vmdg.solve(problem, [1.0])


# Mistakes

MISTAKES = {
    "rotates far": ({"tilts": True, "at": AT}, "is linear at small strain only.*one component"),
    "no point": ({"component": "y", "tilts": True}, "requires at=, the point"),
    "no such point": ({"component": "y", "at": (1.0, 1.0, 0.0)}, "must be a point of 2"),
    "both": ({"component": "y", "force": 1.0, "displacement": 1.0}, "force or displacement"),
    "vector": ({"component": "y", "force": (0.0, 1.0)}, r"has shape \(2,\), expected \(\)"),
    "number": ({"force": 1.0}, r"has shape \(\), expected \(2,\)"),
    "f(x, t)": ({"component": "y", "force": lambda x, t: x[0]}, "number, array or f"),
    "nowhere": ({"component": "w"}, "unknown component 'w'"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes(comm, mistake):
    """Arguments that do not go together are refused, on every rank."""
    problem, find = side_by_side(comm, kinematics="finite")
    given, message = MISTAKES[mistake]
    with pytest.raises(ValueError, match=message):
        problem.rigid_face(find(TOP), **given)


def test_where_it_cannot_be(comm):
    """Tags, inner facets, nodes on a line, prescribed nodes and those of two faces are refused."""
    problem, find = side_by_side(comm)
    with pytest.raises(ValueError, match="lies inside the mesh"):
        problem.rigid_face(find(3), "y")
    with pytest.raises(ValueError, match=r"along y of the node at .* is prescribed too"):
        problem.rigid_face(find(LEFT), "y")
    problem.rigid_face(find(TOP), "y", force=-70.0)
    with pytest.raises(ValueError, match=r"along y of the node at .* belongs to two rigid faces"):
        problem.rigid_face(lambda x: np.isclose(x[0], 2) & (x[1] > 0.5), "y")
    with pytest.raises(ValueError, match=r"along y of the node at .* is prescribed too"):
        problem.dirichlet(find(TOP), 0.0)
    problem.dirichlet(find(TOP), 0.0, "x")
    # What was refused is not there.
    vmdg.solve(problem, [1.0])
    assert problem.reaction(find(BOTTOM))[1] == pytest.approx(70.0, rel=1e-10)
    problem = revolved(section(comm), vmdg.Bonded())
    with pytest.raises(ValueError, match="moves along its axis only"):
        problem.rigid_face(lambda x: np.isclose(x[1], 1), "x")
