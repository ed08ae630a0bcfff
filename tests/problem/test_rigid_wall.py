"""A rigid wall is one layer of cells, stiff or `Rigid`, and bears what statics say."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from support.problems import of_two
from support.scenes import DIMENSION, EVERY_CELL, LEFT, RIGHT, two_blocks

import vmdg
from vmdg.meshes import blocks, with_wall

E, PRESSED, FRICTION = 1000.0, 0.01, 0.3


def block_on_a_wall(comm, cell, kinematics, stiff):
    """A block, a wall so many times as stiff or rigid, inf; pressed against it, then dragged."""
    scene = two_blocks(comm, cell, 2)
    x = scene.mesh.geometry.x
    x[:, 0] = np.minimum(x[:, 0], 1 + 0.01 * (x[:, 0] - 1))  # a layer of .01 mm for block 2
    body = vmdg.NeoHookean(E=E, nu=0.0)
    wall = vmdg.Rigid() if stiff == np.inf else vmdg.NeoHookean(E=stiff * E, nu=0.0)
    problem = of_two(
        scene,
        vmdg.Contact(friction=FRICTION),
        (body, wall),
        {"frame": "reference"},
        kinematics=kinematics,
    )
    left, right = scene.facet_tags.find(LEFT), scene.facet_tags.find(RIGHT)
    if stiff < np.inf:
        problem.dirichlet(right, 0.0)
    across = np.zeros(DIMENSION[cell] - 2)
    problem.dirichlet(left, lambda t: (PRESSED * min(t, 1), 0.03 * max(t - 1, 0), *across))
    return problem, left, right


@pytest.mark.parametrize(
    ("cell", "kinematics", "stiff"),
    [
        ("quadrilateral", "finite", 1e4),
        ("quadrilateral", "small", np.inf),
        ("tetrahedron", "finite", np.inf),
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
    assert np.abs(moved[given]).max(initial=0.0) <= PRESSED / stiff


def test_too_stiff(comm):
    """Forces that drown in the rounding of a wall of 1e9 times the modulus are told, on rank 0."""
    problem, *_ = block_on_a_wall(comm, "quadrilateral", "finite", 1e9)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        vmdg.solve(problem, [1.0])
    told = [str(one.message) for one in caught if one.category is vmdg.ModelWarning]
    assert all("rounding error of the stiffest body" in text for text in told)
    assert len(told) == (comm.rank == 0)


P_C, GAP, LENGTH = 10.0, 0.4, 2.0  # MPa, mm
BODY = vmdg.NeoHookean(E=E, nu=0.0)


def bar(comm, cell, kinematics, wall=None, activate="all", **options):
    """A bar of 2 mm between a support and a wall that pulls at its bond."""
    d = DIMENSION[cell]
    tagged = blocks(comm, cell, (2, 2, 1))
    mesh, cells, facets = with_wall(tagged, tagged.facet_tags.find("right"), 0.25)
    moving = vmdg.Rigid(lambda t: (t, *np.zeros(d - 1)))
    glued = vmdg.Interface(between=("left", "right"), law=vmdg.Bonded())
    law, between = vmdg.Debonding(P_C, GAP), ("right", "wall")
    bond = vmdg.Interface(between=between, law=law, name="bond", activate=activate)
    bodies = {"left": BODY, "right": BODY, "wall": wall or moving}
    problem = vmdg.Problem(mesh, cells, bodies, [glued, bond], kinematics=kinematics, **options)
    problem.dirichlet(facets.find("left"), 0.0)
    return problem, facets


@EVERY_CELL
def test_pulled_off(comm, cell):
    """F = E u/L up to the strength, then P_c (1 - zeta/zeta_c) with u = F L/E + zeta, then none."""
    problem, facets = bar(comm, cell, "small")
    onset = P_C * LENGTH / E
    loads = np.array([0.5 * onset, onset, 0.1, 0.25, 0.39, 0.5])
    force = lambda p: {"F": p.reaction(facets.find("wall"))[0]}  # noqa: E731
    options = vmdg.SolveOptions(energy=True)
    history = vmdg.solve(problem, loads, options, monitor=force).history
    rows = [history["load"].tolist().index(load) for load in loads]
    softening = P_C * (1 - (loads - onset) / (GAP - onset))
    exact = np.where(loads <= onset, E * loads / LENGTH, np.maximum(softening, 0.0))
    assert np.asarray(history["F"])[rows] == pytest.approx(exact, abs=1e-6 * P_C)
    energy = problem.energy()
    assert energy.damage == pytest.approx(P_C * GAP / 2, rel=1e-6)
    assert energy.external == pytest.approx(P_C * GAP / 2, rel=1e-5)


def test_wall_without_interface(comm):
    """It holds its neighbours by their common nodes, and at small strain it may turn."""
    scene = two_blocks(comm, "triangle", 2)
    angle = 1e-3
    wall = vmdg.Rigid(lambda x, t: t * angle * np.stack([-x[1], x[0]]))
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, {1: BODY, 2: wall}, [], kinematics="small")
    vmdg.solve(problem, [1.0])
    x = problem.space.tabulate_dof_coordinates()
    turned = angle * np.column_stack([-x[:, 1], x[:, 0]])
    assert problem.u.x.array.reshape(-1, 2) == pytest.approx(turned, abs=1e-9)
    assert problem.energy().bulk == pytest.approx(0.0, abs=1e-12)


def refused(comm, bodies, interface=None, **options):
    scene = two_blocks(comm, "quadrilateral", 2)
    one = interface(scene) if interface else vmdg.Interface(between=(1, 2), law=vmdg.Contact())
    return vmdg.Problem(scene.mesh, scene.cell_tags, bodies, [one], **options)


def inside(scene):
    """An interface along all facets of block 2."""
    return vmdg.Interface(within=2, law=vmdg.Contact())


def anywhere(scene):
    return vmdg.Interface(facets=lambda x: x[0] > -1, law=vmdg.Contact())


#: What a wall cannot be: its displacement, how the problem is made, and what is said.
REFUSED = [
    (lambda x, t: 0 * x[:2], {}, "displacement of tag 2: the value must be a number, array"),
    ((1.0, 0.0, 0.0), {}, r"tag 2: the value has shape \(3,\), expected \(\) or"),
    ("0.1", {}, r"tag 2: the value '0\.1' is not a number"),
    (0.0, {"eigenstrain": {2: 0.1}}, "tag 2 has an eigenstrain and is Rigid"),
    (0.0, {"plane": "generalized strain"}, "Rigid cannot be used with plane="),
    (lambda t: (t, 0.0), {"symmetry": "axisymmetric"}, "tag 2: .* can only move along z"),
    (
        0.0,
        {"periodic": vmdg.Periodic(gradient=np.eye(2))},
        "Rigid cannot be used in a periodic cell",
    ),
    (0.0, {"interface": inside}, "of its facets have a rigid wall on both sides"),
    (0.0, {"interface": anywhere}, "have a rigid wall on both sides|do not; use"),
]


@pytest.mark.parametrize(("value", "options", "message"), REFUSED)
def test_refused(comm, value, options, message):
    """In words, on every rank."""
    with pytest.raises(ValueError, match=message):
        refused(comm, {1: BODY, 2: vmdg.Rigid(value)}, **options)


def test_nothing_but_walls(comm):
    """There must be a body."""
    with pytest.raises(ValueError, match="all tags are Rigid; at least one must"):
        refused(comm, {1: vmdg.Rigid(), 2: vmdg.Rigid()})


def test_some_facets_on_a_wall(comm):
    """Those of an interface are all on a wall, or none."""
    tagged = blocks(comm, "quadrilateral", (2, 2))
    mesh, cells, _ = with_wall(tagged, tagged.facet_tags.find("right"))
    bodies = {"left": BODY, "right": BODY, "wall": vmdg.Rigid()}
    every = vmdg.Interface(between="all", law=vmdg.Contact())
    with pytest.raises(ValueError, match="2 of its facets lie on a rigid wall and 2 do not; use"):
        vmdg.Problem(mesh, cells, bodies, [every])
