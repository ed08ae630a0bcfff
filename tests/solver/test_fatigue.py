"""Cycles through the solver: a bar under dead load, and the Paris line of a cracked beam."""

from __future__ import annotations

import math

from mpi4py import MPI

import numpy as np
import pytest
from support import bar

import vmdg
from vmdg.meshes import beams
from vmdg.meshes.beams import INTERFACE, RIGHT

LAW = vmdg.FatigueDebonding(100.0, 100.0, 1.0, 1.0)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::vmdg.ModelWarning")
def test_bar_under_dead_load():
    """(1 - d)^(beta + 1) = 1 - N (p/E)^beta/gamma at a constant traction p P; energies; the end."""
    p, wear = 0.6, LAW.wear(1.0, 0.0)
    problem = bar.with_law(MPI.COMM_SELF, LAW, "small", dead=True, most=100.0 * p)
    static = vmdg.solve(problem, [100.0 * p])
    assert not problem.state[0].softening.any()
    life = float(LAW.cycles_to_failure(p))
    options = vmdg.SolveOptions(cycles=1.0, max_loss=0.002, energy=True)
    loads = 100.0 * p + life * np.array([0.4, 0.6])
    result = vmdg.solve(problem, loads, options, history=static.history)
    d = problem.state[0].softening / 100.0
    exact = 1.0 - (1.0 - 0.6 * life * (p / wear.endurance) ** wear.exponent / LAW.life) ** (
        1.0 / (wear.exponent + 1.0)
    )
    assert d == pytest.approx(exact, rel=0.025)
    last = result.history.rows[-1]
    assert last["damage"] == pytest.approx(p**2 * (1 / (1 - exact) - 1), rel=0.025)
    assert abs(last["imbalance"]) < 1e-5 * last["damage"]
    options = vmdg.SolveOptions(cycles=1.0, unstable="trace")
    with pytest.raises(vmdg.StepFailure, match="without force balance"):
        vmdg.solve(problem, [100.0 * p + 1.2 * life], options)
    # early, with steps that long
    assert 0.9 * life < problem.t - 100.0 * p < life


def test_line_of_paris():
    """da/dN of a cracked beam over G: the slope is beta/2, the factor of the length of the zone."""
    law = vmdg.FatigueDebonding(40.0, 40.0, 0.28, 0.28)
    h, a_0, stations, counts = 1.5, 20.0, (0.0, 18.0, 20.0, 30.0, 45.0), (9, 4, 25, 8)
    scene = beams(MPI.COMM_SELF, "quadrilateral", stations, counts, h, 1, a_0)
    body = vmdg.NeoHookean(E=120e3, nu=0.3)
    interface = vmdg.Interface(scene.facet_tags.find(INTERFACE), law=law)
    problem = vmdg.Problem(
        scene.mesh, scene.cell_tags, {1: body, 2: body}, [interface], 2, kinematics="small"
    )
    for side in (-1.0, 1.0):

        def end(x, side=side):
            return np.isclose(x[0], 0.0) & np.isclose(x[1], side * h)

        problem.dirichlet_points(end, lambda t, side=side: side * 0.335 * min(t, 1.0), "y")
    problem.dirichlet(scene.facet_tags.find(RIGHT), 0.0)
    crack = vmdg.CrackGrowth(problem, interface, start=a_0)
    static = vmdg.solve(problem, [0.5, 1.0], monitor=lambda problem: crack())
    options = vmdg.SolveOptions(cycles=1.0)
    far = lambda problem: crack.length > a_0 + 6  # noqa: E731
    result = vmdg.solve(
        problem, [1e9], options, lambda problem: crack(), history=static.history, until=far
    )
    N, a, G = (result.history[name] for name in ("load", "crack", "mode_1"))
    at = np.searchsorted(a, np.linspace(a_0 + 1, a_0 + 5.5, 7))
    speed, share = np.diff(a[at]) / np.diff(N[at]), np.sqrt(G[at][1:] * G[at][:-1]) / 0.28
    slope, factor = np.polyfit(np.log(share), np.log(speed), 1)
    wear = law.wear(1.0, 0.0)
    assert slope == pytest.approx(wear.exponent / 2, rel=0.03)
    length = math.exp(factor - wear.log_rate(1.0, law.life))
    zone = result.history["zone"][at].mean()
    assert 0.6 * zone < length < zone


def test_cycles_need_a_law_that_feels_them():
    problem = bar.build(MPI.COMM_SELF, 0.02, "small")
    with pytest.raises(ValueError, match=r"cycles = 10\.0, but no law .* depends on them"):
        vmdg.solve(problem, [0.001], vmdg.SolveOptions(cycles=10.0))
