"""No step makes energy: impacts with few steps, stiff waves, crushed cells, friction."""

from __future__ import annotations

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from dolfinx import fem
from support.apart import block
from support.problems import of_two, set_displacement

import vmdg
from vmdg.dynamics.balance import Balance
from vmdg.meshes import apart, blocks
from vmdg.problem.states import Energy

ENERGY = vmdg.SolveOptions(energy=True)
LONG_STEPS = pytest.mark.filterwarnings("ignore:solve_dynamics. up to")


def thrown(comm, steps, tilt=0.0, rho_inf=0.8, floor=8):
    """A square block of 1 mm that flies at a rigid floor at a hundredth of its wave speed:
    its energy and its momentum upwards in the rows, relative to those of the start.

    Args:
        steps: Number of steps while a wave runs through it and back.
        tilt: Of the block [degrees].
        floor: Number of its cells.
    """
    E, nu, rho = 50.0, 0.3, 1e-9
    c = np.sqrt(E * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) / rho)
    speed, span = 0.01 * c, 2 / c
    parts = [
        block("quadrilateral", (floor, 1), [-2.0, -0.5], [2.0, 0.0], 1, comm),
        block("quadrilateral", (2, 2), [-0.5, -0.5], [0.5, 0.5], 2, comm),
    ]
    x, turn = parts[1][0].geometry.x, np.deg2rad(tilt)
    x[:, :2] = x[:, :2] @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
    gap = 0.2 * speed * span / steps
    x[:, 1] += gap + (np.cos(turn) + np.sin(turn)) / 2
    scene = apart(parts)
    problem = of_two(
        scene,
        vmdg.Contact(),
        (vmdg.Rigid(), vmdg.NeoHookean(E=E, nu=nu)),
        {"sliding": True},
        density={2: rho},
    )
    owned = problem.discretization.owned

    def upwards(problem):
        motion, v = problem.step.motion, problem.velocity.x.array[:owned]
        P = motion.of(v) if motion.lumped is None else motion.lumped * v
        return {"up": comm.allreduce(P[1::2].sum())}

    start = lambda x: np.array([0 * x[0], -speed * (x[1] > gap / 2)])  # noqa: E731
    times = np.linspace(0.0, 4 * span, 4 * steps + 1)[1:]
    scheme = vmdg.GeneralizedAlpha(rho_inf)
    history = vmdg.solve_dynamics(problem, times, scheme, start, upwards, ENERGY).history
    energy = sum(history[name] for name in ("kinetic", "bulk", "interface"))
    return energy / (rho * speed**2 / 2), history["up"] / (rho * speed)


@LONG_STEPS
@pytest.mark.parametrize(
    ("steps", "tilt", "rho_inf", "floor"),
    [
        (1, 0.0, 0.8, 8),
        (2, 0.0, 1.0, 8),
        (4, 0.0, 0.8, 8),
        (3, 10.0, 0.8, 8),
        (7, 20.0, 0.5, 1),
    ],
)
def test_impact(comm, steps, tilt, rho_inf, floor):
    """A block leaves with at most the energy that it came with, and the scheme may owe 1 %.

    A tilted one touches with its corner, at a distance d from its centre along the floor. Of the
    speed v along which a rigid block of mass m comes the impact (1 + e) m v/(1 + 6 d^2) leaves the
    corner e v: at 10 degrees an elastic one stops the centre, to 0.5 %, and turns the block.
    """
    energy, up = thrown(comm, steps, tilt, rho_inf, floor)
    assert energy.max() <= 1.01
    turn = np.deg2rad(tilt)
    d = (np.cos(turn) - np.sin(turn)) / 2 if tilt else 0.0
    assert 0 < (1 + up[-1]) * (1 + 6 * d**2) - 1 <= 1


@LONG_STEPS
def test_corner_that_slides_past_nodes_is_told(comm):
    """The point at a corner has the area up to the next node of the floor, and nothing in the
    residual is conjugate to what w T^2/(2 r) gains as it slides: the run says so before it has made
    1 % of the energy, and how the floor has no such nodes."""
    with pytest.raises(vmdg.StepFailure, match="nodes of the other surface, larger") as caught:
        thrown(comm, 7, tilt=20.0, rho_inf=0.5)
    history = caught.value.result.history
    energy = sum(history[name] for name in ("kinetic", "bulk", "interface"))
    assert len(energy) > 5
    assert energy.max() <= 1.01 * history["external"][0] + history["discretization"].max()


@LONG_STEPS
@pytest.mark.long
@pytest.mark.parametrize("steps", range(1, 51))
def test_restitution(comm, steps):
    """A flat block leaves, more slowly than it came, whatever the number of steps."""
    assert 0 < thrown(comm, steps)[1][-1] < 1


@LONG_STEPS
def test_stiff_wave(comm):
    """The fastest mode of a bar, 25 times as fast as the step resolves, gains nothing."""
    scene = blocks(comm, "quadrilateral", divisions=(20, 1), length=2.0, height=0.1)
    body = vmdg.NeoHookean(E=1.0, nu=0.0)
    density = {1: 1.0, 2: 1.0}
    problem = of_two(scene, vmdg.Bonded(), (body,) * 2, kinematics="small", density=density)
    start = lambda x: np.array([np.cos(20 * np.pi * x[0]), 0 * x[0]])  # noqa: E731
    history = vmdg.solve_dynamics(problem, np.arange(1.0, 9.0), None, start, options=ENERGY).history
    assert np.all(history["imbalance"] >= -0.01 * history["external"][0])


def apart_at(comm, speed, strength, gap):
    """Two bars with a bond, of unit length, modulus and density, that fly apart."""
    scene = blocks(comm, "quadrilateral", (6, 1), length=2.0, height=0.1)
    bond, bodies = vmdg.Debonding(strength, gap), (vmdg.NeoHookean(E=1.0, nu=0.0),) * 2
    problem = of_two(scene, bond, bodies, kinematics="small", density={1: 1.0, 2: 1.0})
    velocity = problem.velocity.copy()
    set_displacement(
        velocity,
        scene.cell_tags,
        lambda x, tag: speed * (tag - 1.5) * np.array([1 + 0 * x[0], 0 * x[0]]),
    )
    return problem, velocity


@LONG_STEPS
def test_long_steps_break_no_bond(comm):
    """A bond needs ten times the energy of the bars, which come farther than it opens in a step:
    the step is shortened until the bond holds them."""
    problem, velocity = apart_at(comm, 0.01, strength=0.1, gap=5e-3)
    history = vmdg.solve_dynamics(problem, [8.0, 16.0], None, velocity, options=ENERGY).history
    assert np.all(history["damage"] <= 0.01 * history["external"])
    assert np.all(history["imbalance"] >= -0.01 * history["external"])


@pytest.mark.parametrize(("steps", "told"), [(5, 1), (200, 0)])
def test_losses_are_told(comm, steps, told):
    """What the steps lose of the energy in motion is told once, with the cure."""
    problem, velocity = apart_at(comm, 0.01, strength=1.0, gap=0.1)
    times = np.linspace(0.0, 10.0, steps + 1)[1:]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        history = vmdg.solve_dynamics(problem, times, None, velocity, options=ENERGY).history
    lost = history["imbalance"][-1] / history["external"][0]
    assert (lost > 0.05) == told
    assert len(caught) == told * (comm.rank == 0)
    for warning in caught:
        assert "of the energy in motion" in str(warning.message)
        assert "take shorter steps" in str(warning.message)


@pytest.mark.parametrize(("strict", "rows"), [(True, 2), (False, 4), (None, 9)])
def test_dissipation_that_nothing_pays(strict, rows):
    """Friction spends 0.4 % of the energy in each step, of which nothing is lost: a step that asks
    for it ends after 1 %, one that does not where the run, which had lost 1 %, has made as much."""
    spent, lost = [0.0], [0.0]
    ledger = SimpleNamespace(
        energy=lambda: Energy(0.0, 0.0, 0.0, friction=spent[0], viscosity=0.0, external=1.0)
    )
    motion = SimpleNamespace(kinetic_energy=lambda: 1.0 - lost[0])
    balance = Balance(SimpleNamespace(step=SimpleNamespace(ledger=ledger, motion=motion)))
    lost[0] = 0.01
    assert not balance.fault()
    count = 0
    while count < 9:
        spent[0] += 0.004
        if balance.fault(strict=strict):
            break
        count += 1
    assert count == rows
    assert balance.imbalance == pytest.approx(0.01 - 0.004 * rows)


def test_crushed_bar(comm):
    """An explicit bar is pushed at .4 of its wave speed, which stiffens its cells after the step
    was chosen: no cell is inverted, and kinetic energy is less than the work."""
    scene = blocks(comm, "quadrilateral", (40, 1), length=2.0, height=0.1)
    body = vmdg.NeoHookean(E=10.0, nu=0.3)
    density = {1: 1e-3, 2: 1e-3}
    problem = of_two(scene, vmdg.Debonding(1e3, 0.2), (body,) * 2, density=density)
    speed = np.sqrt(10 * 0.7 / (1.3 * 0.4) / 1e-3)
    for side in (4, 5):
        problem.dirichlet(scene.facet_tags.find(side), 0.0, "y")
    problem.dirichlet(scene.facet_tags.find(1), lambda t: 0.4 * speed * t, "x")
    problem.dirichlet(scene.facet_tags.find(2), 0.0, "x")
    times, scheme = np.linspace(0, 2.4 / speed, 9)[1:], vmdg.CentralDifferences()
    result = vmdg.solve_dynamics(problem, times, scheme, options=ENERGY)
    history = result.history
    assert {reason for _, reason in result.failures} <= {"CELLS_INVERTED", "ENERGY_GAINED"}
    assert not problem.discretization.inverted()
    assert np.all(history["kinetic"] < history["external"])
    assert np.abs(history["imbalance"]).max() < 0.01 * history["external"].max()


def test_friction_of_contact_nodes(comm):
    """An explicit block hops and slides on an elastic plate: its contact nodes, which alternate
    between sticking and slipping, settle, and it goes on."""
    parts = [
        block("quadrilateral", (4, 1), [0.0, -1.0], [4.0, 0.0], 1, comm),
        block("quadrilateral", (2, 2), [1.0, 0.0], [3.0, 1.0], 2, comm),
    ]
    scene, body = apart(parts), vmdg.NeoHookean(E=1000.0, nu=0.3)
    problem = of_two(
        scene, vmdg.Contact(friction=0.2), (body,) * 2, {"gap": "keep"}, density={1: 1e-3, 2: 1e-3}
    )
    problem.dirichlet(lambda x: np.isclose(x[1], -1), 0.0)
    problem.body_force(np.array([0.0, -1.0]))
    moving = np.unique(problem.space.dofmap.list[problem.discretization.bodies.cells_of[2]])
    velocity = fem.Function(problem.space)
    velocity.x.array.reshape(-1, 2)[moving] = [3.0, -10.0]
    times, scheme = np.linspace(0, 0.04, 41)[1:], vmdg.CentralDifferences()
    history = vmdg.solve_dynamics(problem, times, scheme, velocity, options=ENERGY).history
    assert problem.t == times[-1]
    assert history["friction"][-1] > 0
    gained = history["kinetic"] + history["bulk"] + history["interface"] - history["external"]
    assert gained.max() < 0.03 * history["external"].max()
