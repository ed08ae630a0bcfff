"""Rayleigh damping, dashpots and surfaces that waves leave, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from support.problems import of_two
from support.scenes import LEFT, RIGHT, pairs, two_blocks

import vmdg
from vmdg.meshes import blocks

QUIET = vmdg.SolveOptions(energy=True)
SCHEMES = [vmdg.GeneralizedAlpha(1.0), vmdg.CentralDifferences()]
BODY = vmdg.NeoHookean(E=1.0, nu=0.0)


def bar(comm, n, damping=None, tied=True):
    """A bar from 0 to 2 of unit modulus and density."""
    scene = blocks(comm, "quadrilateral", divisions=(n, 1, 1))
    problem = vmdg.Problem(
        scene.mesh,
        scene.cell_tags,
        {1: BODY, 2: BODY},
        [vmdg.Interface(between=(1, 2), law=vmdg.Bonded())] * tied,
        kinematics="small",
        density={1: 1.0, 2: 1.0},
        damping=damping,
    )
    return problem, scene.facet_tags


@pairs(scheme=SCHEMES, component=(0, 1), viscosity=("absorbing", None))
def test_waves_leave(comm, scheme, component, viscosity):
    """A pulse that goes both ways leaves the bar: less than 1e-3 of its energy comes back, all of
    it without dashpots; what has left is viscous work."""
    problem, facets = bar(comm, 50)
    across = 1 - component
    problem.dirichlet_points(lambda x: np.ones(x.shape[1], dtype=bool), 0.0, across)
    if viscosity is not None:
        for end in (LEFT, RIGHT):
            problem.spring(facets.find(end), viscosity=viscosity)

    def pulse(x):
        v = np.zeros((2, x.shape[1]))
        v[component] = np.exp(-(((x[0] - 1) / 0.15) ** 2))
        return v

    speed = 1.0 if component == 0 else np.sqrt(0.5)
    times = np.linspace(0.0, 1.8 / speed, 181)[1:]
    history = vmdg.solve_dynamics(problem, times, scheme, pulse, options=QUIET).history
    left = history["bulk"] + history["interface"] + history["kinetic"]
    if viscosity is None:
        assert left[-1] == pytest.approx(left[0], rel=1e-3)
    else:
        assert left[-1] < 1e-3 * left[0]
        assert history["viscosity"][-1] == pytest.approx(left[0], rel=2e-3)
    assert np.abs(history["imbalance"]).max() < 1e-3 * left[0]


@pytest.mark.parametrize(
    ("scheme", "alpha", "beta"),
    [(SCHEMES[0], 0.2, 0.0), (SCHEMES[1], 0.0, 0.1), (SCHEMES[0], 0.1, 0.05)],
)
def test_oscillation_decays(comm, scheme, alpha, beta):
    """The first mode of a free bar: u = exp(-xi omega t) sin(omega_d t)/omega_d."""
    problem, _ = bar(comm, 24, vmdg.Rayleigh(alpha, beta), tied=False)
    omega = np.pi / 2
    xi = (alpha / omega + beta * omega) / 2
    damped = omega * np.sqrt(1 - xi**2)
    times = np.linspace(0.0, 9.0, 361)[1:]

    def end(problem):
        x = problem.space.tabulate_dof_coordinates()[:, 0]
        u = problem.u.x.array.reshape(-1, 2)[x > 2 - 1e-9, 0]
        return {"top": max(comm.allgather(u.max(initial=-np.inf)))}

    mode = lambda x: np.array([np.sin(omega * (x[0] - 1)), 0 * x[0]])  # noqa: E731
    history = vmdg.solve_dynamics(problem, times, scheme, mode, end, QUIET).history
    exact = np.exp(-xi * omega * times) * np.sin(damped * times) / damped
    assert history["top"] == pytest.approx(exact, abs=2e-3 / damped)
    energy = history["external"]
    assert energy == pytest.approx(np.full(360, energy[0]))
    assert np.abs(history["imbalance"]).max() < 1e-3 * energy[0]
    assert history["viscosity"][-1] > 0.5 * energy[0]


@pytest.mark.parametrize("scheme", SCHEMES[1:], ids=str)
def test_spin_is_not_damped(comm, scheme):
    """At finite strain the viscosity of the bodies does not slow down a body that turns."""
    scene = two_blocks(comm, "quadrilateral", 2)
    body = vmdg.NeoHookean(E=100.0, nu=0.3)
    problem = of_two(
        scene,
        vmdg.Bonded(),
        (body,) * 2,
        density={1: 1.0, 2: 1.0},
        damping=vmdg.Rayleigh(beta=0.05),
    )
    owned = problem.discretization.owned
    X = problem.space.tabulate_dof_coordinates()[: owned // 2, :2] - [1.0, 0.5]

    def momentum(problem):
        v, motion = problem.velocity.x.array[:owned], problem.step.motion
        P = (motion.of(v) if motion.lumped is None else motion.lumped * v).reshape(-1, 2)
        x = X + problem.u.x.array[:owned].reshape(-1, 2)
        return {"L": comm.allreduce((x[:, 0] * P[:, 1] - x[:, 1] * P[:, 0]).sum())}

    spin = lambda x: np.array([0.5 - x[1], x[0] - 1])  # noqa: E731
    times = np.linspace(0.0, 4 * np.pi, 401)[1:]
    history = vmdg.solve_dynamics(problem, times, scheme, spin, momentum, QUIET).history
    # It rings first, and the viscosity ends that.
    L, lost, energy = history["L"], history["viscosity"], history["external"][0]
    assert L[200:] == pytest.approx(np.full(200, L[200]), rel=1e-5)
    assert lost[-1] > 1e-5 * energy
    assert lost[-1] - lost[200] < 1e-6 * energy


def test_what_is_refused(comm):
    """Damping without mass, of plastic bodies, and viscosities that are none."""
    scene = two_blocks(comm, "quadrilateral", 1)
    given = scene.mesh, scene.cell_tags
    with pytest.raises(ValueError, match="give density= too"):
        vmdg.Problem(*given, {1: BODY, 2: BODY}, [], damping=vmdg.Rayleigh(1.0))
    metal, rho = vmdg.DruckerPrager(1.0, 0.3, 0.1, 30.0), {1: 1.0, 2: 1.0}
    damping = vmdg.Rayleigh(beta=1.0)
    with pytest.raises(ValueError, match="hyperelastic"):
        vmdg.Problem(*given, {1: metal, 2: BODY}, [], 2, density=rho, damping=damping)
    with pytest.raises(ValueError, match="alpha = -1"):
        vmdg.Rayleigh(-1.0)
    left = scene.facet_tags.find(LEFT)
    problem = vmdg.Problem(*given, {1: BODY, 2: BODY}, [])
    with pytest.raises(ValueError, match="no mass"):
        problem.spring(left, viscosity=1.0)
    problem = vmdg.Problem(*given, {1: BODY, 2: BODY}, [], density=rho)
    for viscosity in ("soft", -1.0, 0.0, (1.0, 2.0, 3.0)):
        with pytest.raises(ValueError, match="viscosity"):
            problem.spring(left, viscosity=viscosity)
    with pytest.raises(ValueError, match="give a stiffness"):
        problem.spring(left)
