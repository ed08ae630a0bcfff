"""Laws of the equilibrium path that no run may break, whatever the solver is like.

A row keeps the supports and loads that are given for its load factor; what unloads is not damaged;
no step contains a snap unseen; every given load factor has its row; units do not matter; a solution
proportional to the load costs no more in many steps than in one.
"""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from support import bar
from support.bar import STRENGTH
from support.scenes import box
from weak_links import bundle, order_statistics

import vmdg
from vmdg.meshes import blocks

# Programmes: what a row keeps, and what it damages


def pulled(
    comm: MPI.Comm, law: vmdg.Law, kinematics: str, way: Callable[[float], float]
) -> tuple[vmdg.Problem, Callable[[vmdg.Problem], dict[str, float]]]:
    """The bar, its right end moved as a function of the load factor; what to look at in a row."""
    mesh, cells, facets = blocks(comm, "quadrilateral", (1, 1))
    body = vmdg.NeoHookean(E=bar.E, nu=bar.NU)
    interface = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(mesh, cells, {1: body, 2: body}, [interface], kinematics=kinematics)
    end = facets.find(2)
    problem.dirichlet(facets.find(1), 0.0, "x")
    problem.dirichlet(end, way, "x")
    problem.dirichlet(facets.find(5), 0.0, "y")

    def look(problem: vmdg.Problem) -> dict[str, float]:
        moved = problem.u.x.array[2 * fem.locate_dofs_topological(problem.space, 1, end)]
        off = np.abs(moved - way(problem.t)).max(initial=0.0)
        worst = problem.state[0].softening.max(initial=0.0) / STRENGTH
        found = {"off": off, "damage": worst}
        return {name: comm.allreduce(value, MPI.MAX) for name, value in found.items()}

    return problem, look


def bears(law: vmdg.Debonding, kinematics: str, ways: list[float]) -> list[float]:
    """Damage of the bar at one end displacement after the other, in closed form."""
    P, H, damages = STRENGTH, STRENGTH / law.critical_gap, []
    gap = largest = Q = 0.0

    def borne(end: float, gap: float) -> float:
        return bar.stress(1 + (end - gap) / 2, kinematics)

    for end in ways:
        plastic = law.unloading == "plastic"
        start = gap if plastic else largest

        def excess(gap: float, end: float = end, start: float = start, Q: float = Q) -> float:
            return borne(end, gap) - max(P - Q - H * (gap - start), 0.0)

        if Q < P and excess(start) > 0:
            reached = brentq(excess, start, end, xtol=1e-16)
            Q, gap = min(Q + H * (reached - start), P), reached
        elif plastic and borne(end, gap) < 0:
            gap = max(end, 0.0)
        largest = max(largest, gap)
        damages.append(Q / P)
    return damages


def piecewise(knots: list[float]) -> Callable[[float], float]:
    """A way that is straight between whole load factors."""
    return lambda t: float(np.interp(t, np.arange(len(knots)), knots))


def check(comm: MPI.Comm, law: vmdg.Debonding, kinematics: str, knots: list[float], loads) -> None:
    """A run keeps the programme, damages what the closed form says, and nothing that unloads."""
    way = piecewise(knots)
    problem, look = pulled(comm, law, kinematics, way)
    history = vmdg.solve(problem, loads, monitor=look).history
    assert history["off"].max() < 1e-9
    assert set(loads) <= set(history["load"])
    ways = [way(t) for t in history["load"]]
    assert history["damage"] == pytest.approx(bears(law, kinematics, ways), abs=1e-7)
    fell = np.diff(ways) < 0
    assert not np.diff(history["damage"])[fell].any()


@settings(max_examples=8)
@given(
    knots=st.lists(st.integers(-2, 12), min_size=2, max_size=5).filter(any),
    unloading=st.sampled_from(["plastic", "secant"]),
    kinematics=st.sampled_from(["small", "finite"]),
    steps=st.integers(4, 20),
    critical_gap=st.sampled_from([0.05, 0.12, 0.2]),
)
def test_random_programmes(comm, knots, unloading, kinematics, steps, critical_gap):
    """Whether the way turns at a given load factor or between two."""
    knots = [0.0, *(0.01 * knot for knot in knots)]
    law = vmdg.Debonding(STRENGTH, critical_gap, unloading=unloading)
    loads = np.arange(1, steps + 1) / steps * (len(knots) - 1)
    check(comm, law, kinematics, knots, loads)


@pytest.mark.parametrize("knots", [[0.0, 0.02, 0.002], [0.0, 0.016, 0.016, 0.01, 0.02]])
def test_strains_that_turn(comm, knots):
    """Where no ray is followed too: both ends held, the bar shrinks, holds and grows again."""

    def damages(way, loads) -> np.ndarray:
        mesh, cells, facets = blocks(comm, "quadrilateral", (2, 2))
        body = vmdg.NeoHookean(E=bar.E, nu=bar.NU)
        bond = vmdg.Interface(between=(1, 2), law=vmdg.Debonding(STRENGTH, 0.12))
        shrinks = {tag: lambda t: -way(t) for tag in (1, 2)}
        problem = vmdg.Problem(
            mesh, cells, {1: body, 2: body}, [bond], kinematics="small", eigenstrain=shrinks
        )
        problem.dirichlet(facets.find(1), 0.0)
        problem.dirichlet(facets.find(2), 0.0)

        def look(problem) -> dict[str, float]:
            softening = problem.state[0].softening.max(initial=0.0)
            return {"damage": comm.allreduce(softening, MPI.MAX) / STRENGTH}

        history = vmdg.solve(problem, loads, monitor=look).history
        rows = [history["load"].tolist().index(t) for t in loads]
        return np.append(0.0, history["damage"][rows])

    way = piecewise(knots)
    loads = np.arange(0, 4 * (len(knots) - 1) + 1) / 4
    found = damages(way, loads[1:])
    largest = np.maximum.accumulate([way(t) for t in loads])
    straight = damages(lambda t: t, np.unique(largest)[1:])
    assert found == pytest.approx(np.interp(largest, np.unique(largest), straight), abs=1e-7)
    assert found[-1] > 0.01


# Snaps


def bars_alone(
    comm: MPI.Comm, strengths: list[float], shares: list[float], given: np.ndarray, **options: str
) -> tuple[int, float]:
    """Points damaged below their strength, and how far tractions are off at the given load factors
    [MPa], of bars side by side. At 10 t MPa, with t_c = 10 t/S and share s of the critical gap in
    the elongation at the strength S, a stable bar, s > 1, carries S (s - t_c)/(s - 1)."""
    strengths, shares = np.array(strengths), np.array(shares[: len(strengths)])
    shares[np.abs(shares - 1) < 0.1] = 1.2

    def gap(x: np.ndarray) -> np.ndarray:
        bars = np.floor(x[1] / 0.1).astype(int)
        return (shares * strengths * 2e-3)[bars]

    problem, _ = bundle(comm, strengths, gap, unloading=options.pop("unloading"))
    bar = np.floor(problem.state[0].points[:, 1] / 0.1).astype(int)
    farthest = 0.0

    def look(problem: vmdg.Problem) -> dict[str, float]:
        nonlocal farthest
        farthest = max(farthest, problem.t)
        damaged = problem.state[0].softening > 1e-6 * strengths[bar]
        early = damaged & (10 * farthest < strengths[bar] * (1 - 1e-6))
        reached = 10 * problem.t / strengths
        softens = np.where(shares > reached, strengths * (shares - reached) / (shares - 1), 0.0)
        beyond = np.where(shares > 1, softens, 0.0)
        traction = np.where(reached <= 1, 10 * problem.t, beyond)
        off = np.abs(problem.state[0].traction[:, 0] - traction[bar]).max(initial=0.0)
        return {"early": comm.allreduce(early.sum()), "off": comm.allreduce(off, MPI.MAX)}

    history = vmdg.solve(problem, given, vmdg.SolveOptions(**options), look).history
    load = history["load"].tolist()
    return history["early"].max(), max(history["off"][load.index(t)] for t in given)


@pytest.mark.long
@settings(max_examples=2)
@given(
    strengths=st.lists(st.floats(4.0, 9.8), min_size=3, max_size=4),
    shares=st.lists(st.floats(0.3, 3.0), min_size=4, max_size=4),
    steps=st.integers(3, 8),
    unstable=st.sampled_from(["jump", "trace"]),
)
@example([4.5174, 4.9945, 4.8752], [2.3343, 0.4376, 0.78376], 9, "jump")
@example([6.44428, 6.24815, 4.63995], [0.67388, 0.34166, 1.5346], 4, "trace")
def test_no_bar_fails_below_its_strength(comm, strengths, shares, steps, unstable):
    """Some bars soften stably while others snap: in every row each is as if it were alone."""
    given = (np.arange(1, steps + 1) - 1e-4) / steps
    options = {"unstable": unstable, "unloading": "secant"}
    early, off = bars_alone(comm, strengths, shares, given, **options)
    assert early == 0
    assert off < 1e-6


@pytest.mark.parametrize(
    ("strengths", "shares", "steps"),
    [
        # The path beyond a snap closes what has opened: at once, late, and a little.
        ([9.132, 3.376, 1.675, 1.716], [0.728, 19.296, 7.662, 4.537], 7),
        ([2.928, 2.475, 2.349, 7.982, 9.639], [8.917, 4.065, 1.962, 0.427, 0.541], 3),
        pytest.param([5.82, 1.881], [0.732, 6.711], 6, marks=pytest.mark.long),
    ],
)
def test_a_snap_damages_no_other_bar(comm, strengths, shares, steps):
    """A machine never goes back: bars that soften stably are not closed and opened again, with
    plastic unloading, where a snap is shorter than a step."""
    given = (np.arange(1, steps + 1) - 1e-4) / steps
    options = {"unstable": "jump", "unloading": "plastic"}
    early, off = bars_alone(comm, strengths, shares, given, **options)
    assert early == 0
    assert off < 1e-6


@pytest.mark.parametrize(
    ("strengths", "shares", "given", "unstable"),
    [
        ([4.597, 4.737], [0.72, 0.60], [13.5, 15.2], "trace"),
        ([4.597, 4.737, 4.967], [0.72, 0.60, 0.71], [4.5, 9.0, 13.5, 18.2, 20.2], "jump"),
    ],
)
def test_the_weakest_link_of_a_row_fails_alone(comm, strengths, shares, given, unstable):
    """One step passes the strengths of all links: the weakest snaps and unloads the others."""
    E, count = 1000.0, len(strengths)
    strengths, length = np.array(strengths), len(strengths) + 1.0
    mesh, tags = box(comm, [(0.0, 0.0), (length, 0.05)], (count + 1, 1))

    def of_link(values: np.ndarray):
        return lambda x: values[np.rint(x[0]).astype(int) - 1]

    law = vmdg.Debonding(
        strength=of_link(strengths),
        critical_gap=of_link(np.array(shares) * strengths * length / E),
        unloading="secant",
    )
    inside = [np.rint(x).astype(int) for x in range(1, count + 1)]
    bond = vmdg.Interface(lambda x: np.isclose(x[0][:, None], inside).any(axis=1), law=law)
    bodies = {1: vmdg.NeoHookean(E=E, nu=0.0)}
    problem = vmdg.Problem(mesh, tags, bodies, [bond], kinematics="small")
    problem.dirichlet(lambda x: np.isclose(x[0], 0), 0.0, "x")
    problem.dirichlet(lambda x: np.isclose(x[0], length), lambda t: 1e-3 * t, "x")
    problem.dirichlet_points(lambda x: x[0] > -1, 0.0, "y")
    link = np.rint(problem.state[0].points[:, 0]).astype(int) - 1

    def look(problem: vmdg.Problem) -> dict[str, float]:
        state = problem.state[0]
        others = state.softening[link > 0].max(initial=0.0)
        T = state.traction[:, 0].max(initial=-np.inf)
        return {"others": comm.allreduce(others, MPI.MAX), "T": comm.allreduce(T, MPI.MAX)}

    options = vmdg.SolveOptions(unstable=unstable)
    history = vmdg.solve(problem, given, options, look).history
    load = history["load"].tolist()
    assert history["others"].max() == 0
    for t in given:
        elastic = E * 1e-3 * t / length
        expected = elastic if elastic < strengths[0] else 0.0
        assert history["T"][load.index(t)] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("ways", [[0.0, 0.6, 0.6, 1.0]])
def test_snaps_behind_a_kink_of_the_programme(comm, ways):
    """The path turns back to load factors for which other loads were given: a jump goes on."""
    strengths = np.array([4.2, 6.2, 8.9])
    loads = np.arange(1, 4 * (len(ways) - 1) + 1) / 4
    problem, look = bundle(comm, strengths, 0.005, piecewise(ways))
    history = vmdg.solve(problem, loads, monitor=look).history
    load = history["load"].tolist()
    for t in loads:
        force = order_statistics(strengths, 10 * piecewise(ways)(t))
        assert history["force"][load.index(t)] == pytest.approx(force, abs=1e-6)


# Units


@pytest.mark.parametrize("factor", [1e-12, 1e15])
@pytest.mark.filterwarnings("ignore::vmdg.ModelWarning")
def test_a_load_factor_is_no_displacement(comm, factor):
    """Pascals, seconds or cycles, on a small body."""
    size = {"length": 0.004, "height": 0.002, "interface": (0.002, 0.002)}
    mesh, cells, facets = blocks(comm, "quadrilateral", (2, 2), **size)
    body = vmdg.NeoHookean(E=2000.0, nu=0.3)
    bond = vmdg.Interface(between=(1, 2), law=vmdg.Debonding(20.0, 1e-4))
    problem = vmdg.Problem(mesh, cells, {1: body, 2: body}, [bond], kinematics="small")
    problem.dirichlet(facets.find(1), 0.0)
    problem.traction(facets.find(2), lambda t: (10.0 * t / factor, 0.0))
    result = vmdg.solve(problem, factor * np.array([0.2, 0.5, 1.0]))
    assert result.history["load"] == pytest.approx(factor * np.array([0.2, 0.5, 1.0]), rel=1e-15)
    assert not result.failures
    assert problem.mean(0).traction[0] == pytest.approx(10.0, rel=1e-6)


# Work


def test_a_proportional_solution_costs_no_more_in_five_steps_than_in_one(comm):
    """A film with a free lip shrinks: no bond breaks, and points stay as they are."""
    corrections, opened = [], []
    for steps in (1, 5):
        mesh, cells, facets = blocks(
            comm, "quadrilateral", (4, 24), length=0.11, height=0.6, interface=(0.1, 0.1)
        )
        bond = vmdg.Interface(
            between=(1, 2),
            law=vmdg.Debonding(strength=1e3, critical_gap=1e-3),
            initial_damage=lambda x: np.where(x[1] > 0.5, 1.0, 0.0),
        )
        bodies = {1: vmdg.NeoHookean(E=200e3, nu=0.25), 2: vmdg.NeoHookean(E=100e3, nu=0.3)}
        problem = vmdg.Problem(
            mesh, cells, bodies, [bond], kinematics="small", eigenstrain={2: lambda t: -1.5e-3 * t}
        )
        problem.dirichlet(facets.find(5), 0.0, "y")
        problem.dirichlet(facets.find(1), 0.0, "x")
        result = vmdg.solve(problem, steps)
        assert not result.failures
        corrections.append(result.history["iterations"].sum())
        opened.append(problem.mean(0).opening)
    assert corrections[1] <= max(corrections[0], 1)
    assert opened[1] == pytest.approx(opened[0], rel=1e-9, abs=1e-15)


def test_no_way_back(comm):
    """A traced path turns back only where bonds break: nowhere down the line of unloading, which is
    an equilibrium too."""
    strengths = np.sort(np.random.default_rng(3).uniform(4.0, 10.0, 4))
    problem, monitor = bundle(comm, strengths, 0.006)
    history = vmdg.solve(
        problem, 20, vmdg.SolveOptions(unstable="trace", energy=True), monitor
    ).history
    falls = np.diff(history["load"]) < 0
    assert falls.sum() > 8
    assert (np.diff(history["damage"])[falls] > 0).all()
