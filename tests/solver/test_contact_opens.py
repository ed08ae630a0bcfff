"""Cracks that are there from the start, `Contact`, as they open; bodies that rest on contact."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from support.budgets import over_budget

import vmdg
from vmdg.meshes import beams, blocks
from vmdg.meshes.beams import CONTACT, INTERFACE, LOWER_LEFT, RIGHT, UPPER_LEFT

LENGTH, HEIGHT, CRACK = 100.0, 1.5, 30.0  # mm
MATERIAL = vmdg.NeoHookean(E=120e3, nu=0.3)


def cracked_beam(comm, facets: int, friction: float = 0.0, **options) -> vmdg.Problem:
    """A DCB whose crack is an interface of ``facets`` facets; t opens its ends [mm]."""
    stations, counts = (0.0, CRACK, LENGTH), (facets, max(facets, 8))
    scene = beams(comm, "quadrilateral", stations, counts, HEIGHT, 2, CRACK, contact=CRACK)
    laws = {INTERFACE: vmdg.Debonding(40.0, 0.014), CONTACT: vmdg.Contact(friction)}
    find = scene.facet_tags.find
    bonds = [vmdg.Interface(find(tag), law=law) for tag, law in laws.items()]
    arms = dict.fromkeys((1, 2), MATERIAL)
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, arms, bonds, **options)
    problem.dirichlet(find(RIGHT), 0.0)
    problem.dirichlet(find(UPPER_LEFT), lambda t: t / 2, "y")
    problem.dirichlet(find(LOWER_LEFT), lambda t: -t / 2, "y")
    return problem


@pytest.mark.parametrize(("kinematics", "friction"), [("small", 0.3), ("finite", 0.0)])
def test_crack_opens_at_once(comm, kinematics, friction):
    """The work does not depend on the number of facets, and the open crack bears nothing."""
    for facets in (15, 120):
        problem = cracked_beam(comm, facets, friction, kinematics=kinematics)
        result = vmdg.solve(problem, [0.1, 0.2])
        assert not result.failures
        assert not over_budget("crack that opens", result)
        state = problem.state[1]
        assert not state.traction.any()
        assert (state.opening[:, 1] > 0).all()


@pytest.mark.parametrize(
    ("cell", "friction"), [("quadrilateral", 0.0), ("triangle", 0.05), ("quadrilateral", 0.5)]
)
def test_pressed_lips_close_at_once(comm, cell, friction):
    """Points that touch are held before the first correction, which tells which of them slide.

    The stiffer block slides without friction on the other, which gets wider, and is held by much of
    it; by some it slides at both ends.
    """
    mesh, cells, facets = blocks(comm, cell, (8, 16), 1.0, interface=(0.5, 0.5))
    interface = vmdg.Interface(between=(1, 2), law=vmdg.Contact(friction))
    bodies = {tag: vmdg.NeoHookean(E=tag * 1e3, nu=0.3) for tag in (1, 2)}
    problem = vmdg.Problem(mesh, cells, bodies, [interface], degree=2)
    problem.dirichlet(facets.find(1), 0.0)
    problem.dirichlet(facets.find(2), lambda t: np.array([-0.01 * t, 0.0]))
    result = vmdg.solve(problem, [1.0])
    assert not result.failures
    assert not over_budget("pressed faces", result)
    # One tangent of open faces, one of held ones, and one for every correction.
    assert result.counts.factorizations <= result.history["iterations"][0] + 2
    modes = set(comm.allreduce(list(problem.state[0].mode)))
    slides, held = vmdg.Mode.FRICTION, vmdg.Mode.ELASTIC
    assert modes == {0.0: {slides}, 0.05: {slides, held}, 0.5: {held}}[friction]


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_turned_block_opens_and_closes(comm, cell, friction):
    """One block is turned on the other: half of the lips is pressed, and some of that held, and
    half of them opens."""
    d = 2 if cell == "quadrilateral" else 3
    mesh, cells, facets = blocks(comm, cell, (4, 8, 2)[:d], 1.0, interface=(0.5, 0.5))
    interface = vmdg.Interface(between=(1, 2), law=vmdg.Contact(friction))
    bodies = {1: vmdg.NeoHookean(E=1e3, nu=0.3), 2: vmdg.NeoHookean(E=5e3, nu=0.2)}
    problem = vmdg.Problem(mesh, cells, bodies, [interface], kinematics="small")
    problem.dirichlet(facets.find(1), 0.0)
    problem.dirichlet(facets.find(2), lambda x, t: t * np.stack([0.01 * (x[1] - 0.7), *0 * x[1:d]]))
    result = vmdg.solve(problem, [1.0])
    assert not result.failures
    assert not over_budget(f"turned blocks, {d}D", result)
    modes = set(comm.allreduce(list(problem.state[0].mode)))
    assert modes >= {vmdg.Mode.OPEN, vmdg.Mode.FRICTION}
    assert (vmdg.Mode.ELASTIC in modes) == (friction > 0)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_block_rests_on_contact(comm, friction):
    """Nothing else holds it, so its points must not start open; a dead load presses it."""
    mesh, cells, facets = blocks(comm, "quadrilateral", (4, 4))
    interface = vmdg.Interface(between=(1, 2), law=vmdg.Contact(friction))
    bodies = dict.fromkeys((1, 2), vmdg.NeoHookean(E=5000.0, nu=0.25))
    problem = vmdg.Problem(mesh, cells, bodies, [interface], kinematics="small")
    problem.dirichlet(facets.find(1), 0.0)
    problem.dirichlet(facets.find(2), 0.0, "y")
    problem.traction(facets.find(2), lambda t: np.array([-20.0 * t, 0.0]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vmdg.ModelWarning)
        result = vmdg.solve(problem, [0.5, 1.0])
    assert problem.step.rests_on_contact
    assert not result.failures
    assert not over_budget("block on contact", result)
    assert problem.mean(0).traction[0] == pytest.approx(-20.0, rel=1e-9)


@pytest.mark.filterwarnings("ignore:.*held:vmdg.ModelWarning")
@pytest.mark.parametrize("law", [vmdg.Contact(), vmdg.Debonding(10.0, 0.01)], ids=str)
def test_blocks_that_are_moved_apart(comm, law):
    """Nothing happens but a motion of half a block: all forces are rounding, of many dofs."""
    scene = blocks(comm, "quadrilateral", (32, 64), height=1.0, length=2.0)
    damage = {"initial_damage": 1.0} if law.has_bond else {}
    interface = vmdg.Interface(between=(1, 2), law=law, **damage)
    body = vmdg.NeoHookean(E=1000.0, nu=0.3)
    bodies = dict.fromkeys((1, 2), body)
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, bodies, [interface], degree=3)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(scene.facet_tags.find(2), lambda t: (min(t, 1.0) / 2, 0.0))
    # Not linear: the load factor is the control.
    problem.body_force(lambda x, t: max(t - 1, 0.0) * x[:2])
    result = vmdg.solve(problem, [1.0])
    assert not result.failures
    assert np.abs(problem.u.x.array.reshape(-1, 2)[:, 0]).max() == pytest.approx(0.5, rel=1e-10)
