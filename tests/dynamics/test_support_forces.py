"""Reactions in motion are the forces of supports."""

from __future__ import annotations

import numpy as np
import pytest
from support.scenes import LEFT, RIGHT, two_blocks

import vmdg

EVERY_SCHEME = pytest.mark.parametrize(
    "scheme", [vmdg.GeneralizedAlpha(), vmdg.CentralDifferences()], ids=["implicit", "explicit"]
)


def bar(comm, E, rho, beta):
    """Two bonded blocks of 1 mm2, damped by their stiffness."""
    scene = two_blocks(comm, "quadrilateral", 2)
    body = vmdg.NeoHookean(E=E, nu=0.0)
    problem = vmdg.Problem(
        scene.mesh,
        scene.cell_tags,
        {1: body, 2: body},
        [vmdg.Interface(between=(1, 2), law=vmdg.Debonding(strength=1e5, critical_gap=0.2))],
        density={1: rho, 2: rho},
        kinematics="small",
        damping=vmdg.Rayleigh(beta=beta),
    )
    return problem, scene.facet_tags


@EVERY_SCHEME
def test_inertia(comm, scheme):
    """A body whose face is accelerated smoothly, to a, needs m a, at the last time of the run too;
    its free side needs nothing."""
    a, rise = 1e4, 0.01
    problem, facets = bar(comm, 1e4, 1e-3, 2e-5)

    def path(t):
        s, more = min(t, rise), max(t - rise, 0.0)
        way = s**2 / 2 + (rise / np.pi) ** 2 * (np.cos(np.pi * s / rise) - 1)
        return (a * (way / 2 + more * rise / 2 + more**2 / 2), 0.0)

    problem.dirichlet(facets.find(LEFT), path)
    sides = lambda p: {  # noqa: E731
        "F": p.reaction(facets.find(LEFT))[0],
        "free": p.reaction(facets.find(RIGHT))[0],
    }
    times = np.linspace(0.0, 0.015, 121)[1:]
    history = vmdg.solve_dynamics(problem, times, scheme, monitor=sides).history
    # The inertia of the nodes of the face alone is a quarter of it.
    assert history["F"][-30:] == pytest.approx(np.full(30, 20.0), rel=0.02)
    assert history["free"] == pytest.approx(np.zeros(120), abs=1e-12)


@EVERY_SCHEME
def test_viscosity(comm, scheme):
    """A damped bar that is stretched uniformly at a rate v: E A (v t + beta v)/L at both ends."""
    problem, facets = bar(comm, 1e4, 1e-3, 1e-3)
    problem.dirichlet(facets.find(LEFT), 0.0)
    problem.dirichlet(facets.find(RIGHT), lambda t: (10.0 * t, 0.0))
    sides = lambda p: {str(s): p.reaction(facets.find(s))[0] for s in (LEFT, RIGHT)}  # noqa: E731
    start = lambda x: np.array([5.0 * x[0], 0 * x[0]])  # noqa: E731
    times = np.linspace(0.0, 4e-4, 17)[1:]
    history = vmdg.solve_dynamics(problem, times, scheme, start, sides).history
    exact = 1e4 * 10 * (times + 1e-3) / 2
    # The bond, which is not viscous, vibrates at first.
    assert history[str(RIGHT)][8:] == pytest.approx(exact[8:], rel=0.02)
    assert history[str(LEFT)][8:] == pytest.approx(-exact[8:], rel=0.02)


@EVERY_SCHEME
def test_dashpots(comm, scheme):
    """A body that flies at a speed V against a dashpot of viscosity c: c V, and its impulse is the
    momentum that is lost."""
    problem, facets = bar(comm, 1e4, 1e-3, 0.0)
    problem.spring(facets.find(LEFT), viscosity=0.1)
    V, force = 5.0, lambda p: {"F": p.reaction(facets.find(LEFT))[0]}
    start = lambda x: np.array([np.full(x.shape[1], V), 0 * x[0]])  # noqa: E731
    times = np.linspace(0.0, 0.02, 201)[1:]
    history = vmdg.solve_dynamics(problem, times, scheme, start, force).history
    exact = -0.1 * V * np.exp(-0.1 / 2e-3 * times)
    # The body vibrates.
    assert history["F"] == pytest.approx(exact, abs=0.05 * 0.1 * V)


@pytest.mark.parametrize("ends", [(1e-3, 2e-3), (0.7e-3, 2e-3)], ids=["row", "between"])
def test_a_body_that_is_set_in_motion_at_once(comm, ends):
    """All of it moves as given, from rest to a speed: the supports do the work m v^2/2."""
    problem, _ = bar(comm, 1e4, 1e-3, 0.0)
    problem.dirichlet_points(lambda x: x[0] > -1, lambda t: (20.0 * max(t - 1e-3, 0.0), 0.0))
    history = vmdg.solve_dynamics(problem, ends, options=vmdg.SolveOptions(energy=True)).history
    assert history["kinetic"][-1] == pytest.approx(history["external"][-1], rel=1e-9)
    assert history["kinetic"][-1] > 0.1
