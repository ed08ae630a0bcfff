"""Motion in time: order, spall, impact, friction, spin, energies, ranks, and what is refused."""

from __future__ import annotations

import re

from mpi4py import MPI

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.problems import of_two
from support.scenes import EVERY_CELL, LEFT, RIGHT, two_blocks

import vmdg
from vmdg.meshes import blocks

QUIET = vmdg.SolveOptions(energy=True)
SCHEMES = [vmdg.GeneralizedAlpha(), vmdg.GeneralizedAlpha(1.0), vmdg.CentralDifferences()]
EVERY_SCHEME = pytest.mark.parametrize("scheme", SCHEMES, ids=str)


def bar(comm, n, law, cell="quadrilateral", kinematics="small", degree=1):
    """Two bars of unit length, modulus and density, free everywhere, that meet at x = 1."""
    scene = blocks(comm, cell, divisions=(n, 1, 1))
    body = vmdg.NeoHookean(E=1.0, nu=0.0)
    problem = of_two(
        scene, law, (body,) * 2, degree=degree, kinematics=kinematics, density={1: 1.0, 2: 1.0}
    )
    return problem, scene.facet_tags


def apart(speed):
    def velocity(x):
        v = np.zeros((2, x.shape[1]))
        v[0] = speed * (x[0] - 1)
        return v

    return velocity


def standing(x):
    return np.array([np.sin(np.pi * (x[0] - 1) / 2), 0 * x[0]])


@EVERY_CELL
def test_mass(comm, cell):
    """Mass and moment of inertia of two blocks, also of the lumped masses."""
    scene = two_blocks(comm, cell, 2)
    body = vmdg.NeoHookean(E=1.0, nu=0.3)
    problem = vmdg.Problem(
        scene.mesh, scene.cell_tags, {1: body, 2: body}, [], density={1: 2.0, 2: 2.0}
    )
    d, owned = scene.mesh.geometry.dim, problem.discretization.owned
    x = problem.space.tabulate_dof_coordinates()[: owned // d, :d]
    motion = problem.step.motion
    for i in range(d):
        along = np.zeros_like(x)
        along[:, i] = 1.0
        assert comm.allreduce(along.ravel() @ motion.of(along.ravel())) == pytest.approx(4.0)
        # int rho x_1 x_1 dV = 2 [x^3/3] from 0 to 2.
        along[:, i] = x[:, 0]
        assert comm.allreduce(along.ravel() @ motion.of(along.ravel())) == pytest.approx(16 / 3)
    assert comm.allreduce(motion.row_sums.sum()) == pytest.approx(4.0 * d)


@pytest.mark.parametrize("scheme", SCHEMES[1:], ids=str)
def test_order(comm, scheme):
    """A standing wave of a tied bar: the error falls with the square of the step."""
    found = []
    for steps in (16, 32, 512):
        problem, _ = bar(comm, 4, vmdg.Bonded())
        # All are stable: the explicit scheme takes these steps.
        times = np.linspace(0.0, 1.2, steps + 1)[1:]
        vmdg.solve_dynamics(problem, times, scheme, standing)
        found.append(comm.allreduce(float(np.abs(problem.u.x.array).max()), MPI.MAX))
    first, second = (abs(one - found[-1]) for one in found[:2])
    assert first / second == pytest.approx(4.0, rel=0.15)


@pytest.mark.parametrize("scheme", [SCHEMES[0], SCHEMES[2]], ids=str)
def test_spall(comm, scheme):
    """Bars that fly apart: T = V until the bond fails and V - zeta'/2 after it, continuous at the
    onset, within 1 % of the strength with 80 cells; the bond dissipates its energy."""
    speed, strength, gap = 2.4, 1.0, 0.3
    problem, _ = bar(comm, 80, vmdg.Debonding(strength=strength, critical_gap=gap))

    def monitor(problem):
        return {"T": problem.mean(0).traction[0]}

    times = np.linspace(0.0, 0.9, 73)[1:]
    result = vmdg.solve_dynamics(problem, times, scheme, apart(speed), monitor, QUIET)

    def opens(t, zeta):
        return 2 * (speed * t - strength + strength * zeta / gap)

    def open_(t, zeta):
        return zeta[0] - gap

    open_.terminal = True
    begins = strength / speed
    path = solve_ivp(opens, (begins, 2), [0.0], rtol=1e-10, events=open_, dense_output=True)
    ends = path.t[-1]
    zeta = path.sol(np.clip(times, begins, ends))[0]
    exact = np.select(
        [times < begins, times < ends], [speed * times, strength * (1 - zeta / gap)], 0.0
    )
    history = result.history
    assert np.abs(history["T"] - exact).max() < 0.01 * strength
    assert history["damage"][-1] == pytest.approx(strength * gap / 2, rel=1e-9)
    # The initial kinetic energy, to rounding: no load does work.
    assert history["external"] == pytest.approx(np.full(72, speed**2 / 3), rel=1e-3)
    assert np.abs(history["imbalance"]).max() < 1e-3 * speed**2 / 3


@pytest.mark.parametrize("scheme", SCHEMES[1:], ids=str)
def test_spin(comm, scheme):
    """Bonded blocks that turn freely, twice, at finite strain keep their momenta and energy."""
    scene = two_blocks(comm, "quadrilateral", 2)
    body = vmdg.NeoHookean(E=100.0, nu=0.3)
    bond = vmdg.Debonding(strength=50.0, critical_gap=0.1)
    problem = of_two(scene, bond, (body,) * 2, density={1: 1.0, 2: 1.0})
    owned = problem.discretization.owned
    X = problem.space.tabulate_dof_coordinates()[: owned // 2, :2] - [1.0, 0.5]

    def momenta(problem):
        v, u = (f.x.array[:owned] for f in (problem.velocity, problem.u))
        lumped = problem.step.motion.lumped
        P = (problem.step.motion.of(v) if lumped is None else lumped * v).reshape(-1, 2)
        x = X + u.reshape(-1, 2)
        turning = (x[:, 0] * P[:, 1] - x[:, 1] * P[:, 0]).sum()
        P_x, L = comm.allreduce(np.array([P[:, 0].sum(), turning]))
        return {"P": P_x, "L": L}

    history = vmdg.solve_dynamics(
        problem,
        np.linspace(0.0, 4 * np.pi, 401)[1:],
        scheme,
        lambda x: np.array([0.5 - x[1], x[0] - 1]),
        momenta,
        QUIET,
    ).history
    assert np.abs(history["P"]).max() < 1e-9
    assert history["L"] == pytest.approx(np.full(400, history["L"][0]), rel=1e-3)
    assert np.abs(history["imbalance"]).max() < 2e-3 * history["kinetic"][0]


@EVERY_SCHEME
def test_static_state_stays(comm, scheme):
    """From equilibrium under loads that are held nothing moves, and a support that moves on takes
    the body with it: its work is the energy of both."""
    problem, facets = bar(comm, 4, vmdg.Debonding(strength=1.0, critical_gap=1.0))
    problem.dirichlet(facets.find(LEFT), 0.0)
    problem.dirichlet(facets.find(RIGHT), lambda t: 0.02 * min(t, 1.0) + 0.1 * max(t - 2.5, 0), "x")
    vmdg.solve(problem, [1.0])
    still = problem.u.x.array.copy()
    vmdg.solve_dynamics(problem, [1.5, 2.0], scheme)
    assert problem.u.x.array == pytest.approx(still, abs=1e-9)
    assert np.abs(problem.velocity.x.array).max() < 1e-9
    times = np.linspace(2.0, 3.3, 131)[1:]
    history = vmdg.solve_dynamics(problem, times, scheme, options=QUIET).history
    assert history["kinetic"].max() > 1e-3
    assert np.abs(history["imbalance"]).max() < 0.02 * history["external"].max()


def test_times_that_rounding_misses(comm):
    """.2 + (.9 - .2) is less than .9: two steps all the same, which end at the given times."""
    problem, _ = bar(comm, 4, vmdg.Bonded())
    scheme, reached = vmdg.GeneralizedAlpha(), []
    start = lambda x: np.array([x[0], 0 * x[0]])  # noqa: E731

    def monitor(problem):
        reached.append(problem.t)
        return {}

    history = vmdg.solve_dynamics(problem, [0.2, 0.9], scheme, start, monitor).history
    assert history["steps"].tolist() == [1, 1]
    assert reached == [0.2, 0.9]


def test_velocity_by_group(comm):
    """Each body has its own; others are at rest."""
    problem, _ = bar(comm, 2, vmdg.Contact())
    vmdg.solve_dynamics(problem, [1e-3], velocity={1: (-0.5, 0.25)})
    v, cells = problem.velocity.x.array.reshape(-1, 2), problem.discretization.bodies.cells_of
    for tag, value in ((1, [-0.5, 0.25]), (2, [0.0, 0.0])):
        here = v[np.unique(problem.space.dofmap.list[cells[tag]])]
        assert here == pytest.approx(np.broadcast_to(value, here.shape), abs=1e-5)


def test_back_to_statics(comm):
    """Statics stops bodies in motion, and counts their energy as lost."""
    problem, facets = bar(comm, 4, vmdg.Bonded())
    problem.dirichlet(facets.find(LEFT), 0.0)
    vmdg.solve_dynamics(problem, [0.1, 0.2], velocity=apart(0.1))
    moving = problem.energy()
    assert moving.kinetic > 1e-4
    vmdg.solve(problem, [1.0])
    energy = problem.energy()
    assert energy.kinetic == 0.0
    assert energy.viscosity == pytest.approx(moving.kinetic)
    assert np.abs(problem.u.x.array).max() < 1e-9


@pytest.mark.filterwarnings("ignore:solve_dynamics. up to")  # long steps
def test_step_that_fails(comm):
    """The state is that of the last step, and the message says which step failed and why."""
    problem, facets = bar(comm, 2, vmdg.Bonded(), kinematics="finite")
    problem.dirichlet(facets.find(LEFT), 0.0)
    problem.dirichlet(facets.find(RIGHT), lambda t: -5.0 * t, "x")  # through the other side
    options = vmdg.SolveOptions(max_cuts=2)
    with pytest.raises(vmdg.StepFailure, match=re.escape("the step in time from")) as caught:
        vmdg.solve_dynamics(problem, [0.1, 0.5], options=options)
    assert problem.t < 0.5
    assert caught.value.result.failures
    assert np.isfinite(problem.u.x.array).all()


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"times": 1.0}, ValueError, "must be a list of times"),
        ({"times": [0.0, 1.0]}, ValueError, "increase from problem.t = 0 on"),
        ({"scheme": "explicit"}, TypeError, "must be vmdg.GeneralizedAlpha() or"),
        ({"velocity": 1.0}, TypeError, "function of positions x"),
        ({"velocity": lambda x: x}, ValueError, "velocity returned"),
        ({"velocity": {3: (1.0, 0.0)}}, ValueError, "no cell has tag 3"),
        ({"velocity": {1: 1.0}}, ValueError, "must be 2 finite numbers"),
        ({"options": vmdg.SolveOptions(cycles=10.0)}, ValueError, "no motion for cycles"),
        ({"history": 1}, TypeError, "must be a History"),
    ],
)
def test_refused(comm, arguments, error, words):
    """Arguments that are wrong, and what has no motion yet, are refused in words."""
    problem, _ = bar(comm, 1, vmdg.Bonded())
    with pytest.raises(error, match=re.escape(words)):
        vmdg.solve_dynamics(problem, **({"times": [1.0]} | arguments))


@pytest.mark.parametrize(
    ("density", "error", "words"),
    [
        (None, ValueError, "the problem has no mass"),
        ({1: 1.0}, ValueError, "density has no value for tag 2"),
        ({1: 1.0, 2: 1.0, 3: 1.0}, ValueError, "tag 3"),
        ({1: 1.0, 2: -1.0}, ValueError, "must be positive and finite"),
        ({1: 1.0, 2: "heavy"}, TypeError, "must be a number"),
    ],
)
def test_density(comm, density, error, words):
    """A density for every body, or the problem has no motion."""
    scene = two_blocks(comm, "quadrilateral")
    body = vmdg.NeoHookean(E=1.0, nu=0.0)
    with pytest.raises(error, match=re.escape(words)):
        problem = vmdg.Problem(scene.mesh, scene.cell_tags, {1: body, 2: body}, [], density=density)
        vmdg.solve_dynamics(problem, [1.0])


def test_lumped_masses_must_be_positive(comm):
    """Triangles of degree 2 have none at their corners."""
    problem, _ = bar(comm, 1, vmdg.Bonded(), cell="triangle", degree=2)
    with pytest.raises(ValueError, match="use degree=1, quadrilaterals or hexahedra"):
        vmdg.solve_dynamics(problem, [1.0], vmdg.CentralDifferences())


@pytest.mark.parametrize("rho", [0.0, 1.1, -0.5, True, "0.8"])
def test_parameters(rho):
    """Parameters out of range."""
    for scheme in (vmdg.GeneralizedAlpha, vmdg.CentralDifferences):
        with pytest.raises(ValueError, match=r"must be a number in \(0, 1\]"):
            scheme(rho)
    with pytest.raises(ValueError, match="an integer >= 1"):
        vmdg.CentralDifferences(renewal=0)


@EVERY_SCHEME
def test_displacement_set_by_hand(comm, scheme):
    """Its energy counts as supplied before the run, whatever has happened before."""
    problem, _ = bar(comm, 8, vmdg.Debonding(strength=1.0, critical_gap=0.3))
    for _ in range(2):
        problem.u.interpolate(lambda x: np.array([0.1 * np.cos(np.pi * x[0]), 0 * x[0]]))
        times = problem.t + np.linspace(0.0, 0.2, 41)[1:]
        history = vmdg.solve_dynamics(problem, times, scheme, options=QUIET).history
        assert history["kinetic"][-1] > 1e-3
        assert np.abs(history["imbalance"]).max() < 1e-3 * history["external"][0]
