"""Prony series: relaxation, creep and cycles in closed form, energies, tangents, runs in time."""

from __future__ import annotations

from functools import partial

from mpi4py import MPI

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from support.checks import multiply, product_error, tangent_matrix
from support.plastic import DT, TENSORS, deformed
from support.problems import joined, partly_damaged
from support.scenes import DIMENSION, SEVERAL_RANKS, tag_cells, two_blocks, unit_box

import vmdg

E, NU = 2000.0, 0.3
G, K = E / 2 / (1 + NU), E / 3 / (1 - 2 * NU)
SHEAR, BULK = [(0.3, 0.1), (0.4, 2.0)], [(0.25, 0.5)]
BODY = vmdg.Viscoelastic(E, NU, SHEAR, BULK)
#: The same series for shear and volume: Poisson's ratio stays.
ALIKE = vmdg.Viscoelastic(E, NU, SHEAR, SHEAR)
SMALL = pytest.mark.parametrize("small", [True, False])
TIMES = st.sampled_from([0.0, 1e-9, 1e-3, 0.009, 0.011, 0.3, 5.0, 1e6, np.inf])


def relaxing(t, series=SHEAR):
    """Share of the modulus that is left after a time."""
    return 1 - sum(g * (1 - np.exp(-t / tau)) for g, tau in series)


def principal(answer, F, small):
    """sigma, at finite strain tau, of one point in its principal axes."""
    return np.diag(answer.stress[0] if small else answer.stress[0] @ F[0].T)


@SMALL
@pytest.mark.parametrize("moduli", ["instantaneous", "long-term"])
def test_relaxation(small, moduli):
    """After a strain that takes no time: the series, whatever the steps."""
    strain = np.array([0.03, -0.01, 0.02])
    F = np.diag(strain if small else np.exp(strain))[None]
    body = vmdg.Viscoelastic(E, NU, SHEAR, BULK, moduli=moduli)
    share = [1.0, 1.0] if moduli == "instantaneous" else [0.3, 0.75]
    mean, t, state = strain.mean(), 0.0, body.start(1)
    for dt in (np.inf, 0.003, 0.2, 0.2, 5.0):
        answer, t = body(F, state, dt, small), t + (dt if dt < np.inf else 0.0)
        expected = 2 * G / share[0] * relaxing(t) * (strain - mean)
        expected += 3 * K / share[1] * relaxing(t, BULK) * mean
        assert principal(answer, F, small) == pytest.approx(expected, rel=1e-12)
        state = answer.state
    assert body.elastic.parameters["mu"] == pytest.approx(G / share[0])


@SMALL
def test_ramp_and_energies(small):
    """A strain that grows linearly in time, exact in one step; stored and dissipated energy are its
    work."""
    rate = np.array([0.2, -0.1, 0.05])
    places, weights = np.polynomial.legendre.leggauss(12)

    def at(t, state=None, since=0.0):
        F = np.diag(rate * t if small else np.exp(rate * t))[None]
        start = BODY.start(1) if state is None else state
        answer = BODY(F, start, t - since, small)
        return answer, principal(answer, F, small)

    t, mean = 0.7, rate.mean()
    expected = 2 * G * (rate - mean) * (0.3 * t + sum(g * a * -np.expm1(-t / a) for g, a in SHEAR))
    expected += 3 * K * mean * (0.75 * t + 0.25 * 0.5 * -np.expm1(-t / 0.5))
    first, stress = at(t)
    assert stress == pytest.approx(expected, rel=1e-12)
    last, end = at(2 * t, first.state, t)
    assert end == pytest.approx(at(2 * t)[1], rel=1e-12)
    times = t * (3 + places) / 2
    powers = [rate @ at(x, first.state, t)[1] for x in times]
    work = t / 2 * weights @ powers
    assert last.stored - first.stored + last.dissipated == pytest.approx(work, rel=1e-10)
    assert last.dissipated > 0.1 * work


def test_cycles():
    """Storage and loss modulus of a sine of strain, in the sixth cycle: second order in the step,
    and 1e-6 once that is extrapolated."""
    series, found, omega = [(0.3, 0.5), (0.4, 2.0)], [], np.array([0.6, 1.0])
    for n in (100, 200):
        phase, stress = 2 * np.pi * np.arange(6 * n + 1) / n, []
        for w in omega:
            body, state, row = vmdg.Viscoelastic(E, NU, series), np.zeros((1, 18)), []
            for angle in phase:
                strain = 1e-3 * np.sin(angle) * np.eye(3)[[[1, 0, 2]]]
                answer = body(strain, state, 2 * np.pi / n / w, True)
                state = answer.state
                row.append(answer.stress[0, 0, 1])
            stress.append(row[-n:])
        waves = np.array([np.sin(phase[-n:]), np.cos(phase[-n:])])
        found.append(np.array(stress) @ waves.T / (n / 2) / 2e-3)
    shares, times = np.array(series).T
    times = times * omega[:, None]
    storage = G * (0.3 + times**2 / (1 + times**2) @ shares)
    loss = G * (times / (1 + times**2) @ shares)
    exact = np.stack([storage, loss], axis=1)
    coarse, fine = (np.abs(one - exact).max() / G for one in found)
    assert 3.8 < coarse / fine < 4.2
    assert (4 * found[1] - found[0]) / 3 == pytest.approx(exact, abs=1e-6 * G)


@SMALL
@given(first=TENSORS, second=TENSORS, direction=TENSORS, dt=TIMES)
def test_tangent(small, first, second, direction, dt):
    """Moduli are the derivative of the stress, have major symmetry, and at small strain lie between
    zero and the elastic ones."""
    one = BODY(deformed(first, small), BODY.start(1), DT, small)
    answer = BODY(deformed(second, small), one.state, dt, small)
    assert np.abs(answer.moduli - answer.moduli.transpose(0, 3, 4, 1, 2)).max() < 1e-12 * E
    D, h = deformed(direction, small)[0] - (0 if small else np.eye(3)), 1e-5
    ends = [BODY(deformed(second, small) + s * h * D, one.state, dt, small) for s in (1, -1)]
    expected = np.einsum("pijkl,kl->pij", answer.moduli, D)
    scale = E * max(np.abs(D).max(), 1e-3)
    assert np.abs((ends[0].stress - ends[1].stress) / (2 * h) - expected).max() < 1e-6 * scale
    if small:
        elastic = BODY(np.zeros((1, 3, 3)), BODY.start(1), np.inf, True).moduli.reshape(9, 9)
        softer = elastic - answer.moduli.reshape(9, 9)
        assert np.linalg.eigvalsh(softer).min() > -1e-12 * E


@SMALL
@given(path=st.lists(st.tuples(TENSORS, TIMES), min_size=1, max_size=5))
def test_dissipation(small, path):
    """Is not negative, and neither is the energy stored; what has been put in is at least that."""
    state = BODY.start(1)
    for gradient, dt in path:
        answer = BODY(deformed(gradient, small), state, dt, small)
        assert answer.dissipated[0] >= 0
        assert answer.stored[0] >= 0
        assert np.isfinite(answer.state).all()
        state = answer.state
        again = BODY(deformed(gradient, small), state, 0.4, small)
        # At rest the energy that is lost was stored.
        lost = answer.stored[0] - again.stored[0]
        assert again.dissipated[0] == pytest.approx(lost, rel=1e-9, abs=1e-13 * E)


@given(first=TENSORS, second=TENSORS, spin=TENSORS, dt=TIMES)
def test_objectivity(first, second, spin, dt):
    """A rotation Q of all of space after the first step: P -> Q.P, with the same history."""
    one = BODY(deformed(first, False), BODY.start(1), DT, False)
    answer = BODY(deformed(second, False), one.state, dt, False)
    Q, _ = np.linalg.qr(np.eye(3) + 5 * spin)
    Q *= np.sign(np.linalg.det(Q))
    turned = BODY(Q @ deformed(second, False), one.state, dt, False)
    assert turned.stress == pytest.approx(Q @ answer.stress, abs=1e-10 * E)
    assert turned.state == pytest.approx(answer.state, abs=1e-11)


def test_small_strain_is_the_limit_of_finite_strain():
    """Differences fall with the square of the strain."""
    gradient, errors = np.array([[0.4, 0.3, 0.0], [-0.1, -0.2, 0.2], [0.1, 0.0, 0.1]]), []
    for size in (1e-3, 1e-4):
        stresses = [
            BODY(deformed(size * gradient, small), BODY.start(1), DT, small).stress
            for small in (True, False)
        ]
        errors.append(np.abs(stresses[0] - stresses[1]).max() / (E * size))
    assert errors[1] < 0.2 * errors[0] < 1e-2


def test_shift():
    """Relaxation times follow a temperature (Williams, Landel and Ferry): at a constant one it is
    the body with other times, with one that rises the series of the reduced time."""
    wlf = lambda T: 10 ** (-17.4 * (T - 20.0) / (51.6 + T - 20.0))  # noqa: E731
    F = deformed(np.diag([0.02, 0.0, 0.0]), True)

    def after(body, times):
        state = body(F, body.start(1), np.inf, True).state
        for dt in np.diff(times, prepend=0.0):
            answer = body(F, state, dt, True)
            state = answer.state
        return answer.stress

    times = np.linspace(0.0, 2.0, 9)[1:]
    warm = vmdg.Viscoelastic(E, NU, SHEAR, BULK, shift=lambda t: wlf(25.0))
    slower = [[(g, wlf(25.0) * tau) for g, tau in series] for series in (SHEAR, BULK)]
    assert after(warm, times) == pytest.approx(after(vmdg.Viscoelastic(E, NU, *slower), times))
    heated = vmdg.Viscoelastic(E, NU, SHEAR, BULK, shift=lambda t: wlf(20.0 + 2 * t))
    fine = np.linspace(0, 2.0, 20001)
    reduced = np.trapezoid(1 / wlf(20.0 + 2 * fine), fine)
    assert after(heated, times) == pytest.approx(after(BODY, [reduced]), rel=1e-6)


KINDS = [
    ("hexahedron", {"volumetric": "mean"}, "finite"),
    ("triangle", {"plane": "stress"}, "small"),
    ("quadrilateral", {"plane": "stress", "degree": 2}, "finite"),
    ("quadrilateral", {"plane": "generalized strain", "degree": 2}, "finite"),
    pytest.param("tetrahedron", {"degree": 2}, "small", marks=pytest.mark.long),
]


@pytest.mark.parametrize(("cell", "options", "kinematics"), KINDS)
def test_bar(comm, cell, options, kinematics):
    """Uniaxial stress after a strain in no time: what is left of Young's modulus, with Poisson's
    ratio as it was."""
    scene, small = two_blocks(comm, cell), kinematics == "small"
    problem = joined(scene, vmdg.Bonded(), (ALIKE, ALIKE), kinematics=kinematics, **options)
    facets, elongation = scene.facet_tags, 0.06
    problem.dirichlet(facets.find(1), 0.0, "x")
    problem.dirichlet(facets.find(2), elongation, "x")
    for k, name in ((1, "y"), (2, "z"))[: DIMENSION[cell] - 1]:
        problem.dirichlet(lambda x, k=k: np.isclose(x[k], 0.0), 0.0, name)
    found = []
    times = np.array([0.0, 0.05, 0.3, 0.5, 2.0])
    for t in times:
        options = vmdg.SolveOptions(relative_tolerance=1e-12, duration=1.0)
        vmdg.solve(problem, [t], options)
        found.append(-problem.reaction(facets.find(1))[0])
    strain = elongation / 2 if small else np.log1p(elongation / 2)
    expected = E * relaxing(times) * strain / (1.0 if small else 1 + elongation / 2)
    assert found == pytest.approx(expected, rel=1e-9)
    energy = problem.energy()
    assert energy.plastic > 0.1 * energy.external
    state = problem.body_state(1)
    assert state.history["strain"][:, 0] == pytest.approx(strain)
    assert state.history["deviators"].shape == (len(state.points), 12)


def test_creep(comm):
    """Under a constant traction from the start: u_inf - (u_inf - u_0) exp(-t/tau_c), to second
    order in the step."""
    share, tau, pull = 0.6, 0.5, 5.0
    body = vmdg.Viscoelastic(E, NU, [(share, tau)], [(share, tau)])
    errors = []
    for n in (5, 10):
        scene = two_blocks(comm, "quadrilateral")
        problem = joined(scene, vmdg.Bonded(), (body,) * 2, kinematics="small", plane="stress")
        problem.dirichlet(scene.facet_tags.find(1), 0.0, "x")
        problem.dirichlet(lambda x: np.isclose(x[1], 0.0), 0.0, "y")
        problem.traction(scene.facet_tags.find(2), (pull, 0.0))
        far = lambda p: {"u": MPI.COMM_WORLD.allreduce(p.u.x.array.max(), MPI.MAX)}  # noqa: E731
        times = np.linspace(0.0, 2.0, n + 1)
        history = vmdg.solve(problem, times, vmdg.SolveOptions(duration=1.0), far).history
        end = pull * 2 / E / (1 - share)
        expected = end * (1 - share * np.exp(-times * (1 - share) / tau))
        assert history["u"][0] == pytest.approx(expected[0], rel=1e-9)
        errors.append(np.abs(history["u"] - expected).max() / end)
    assert errors[1] < 5e-3
    assert errors[0] / errors[1] > 3.5


def bar_with_bond(comm, n, kinematics="small", material=None, **options):
    """Two bodies in series with a bond, pulled at a constant speed: force and damage work."""
    scene = two_blocks(comm, "quadrilateral")
    body = material or vmdg.Viscoelastic(E, NU, [(0.6, 0.5)], [(0.6, 0.5)])
    bond = vmdg.Debonding(strength=20.0, critical_gap=0.06)
    problem = joined(scene, bond, (body,) * 2, kinematics=kinematics, plane="stress", degree=2)
    left, right = (scene.facet_tags.find(k) for k in (1, 2))
    problem.dirichlet(left, 0.0, "x")
    problem.dirichlet(right, lambda t: 0.05 * t, "x")
    problem.dirichlet(lambda x: np.isclose(x[1], 0.0), 0.0, "y")
    given = vmdg.SolveOptions(**{"duration": 1.0, "energy": True, **options})
    loads = np.linspace(0.0, 1.0, n + 1)[1:]
    return vmdg.solve(problem, loads, given, lambda p: {"F": p.reaction(right)[0]})


def test_bar_with_a_bond(comm):
    """A series of the bond T = T_c (1 - zeta/zeta_c) and the bar: second order in the step."""
    T, zeta, speed, L = 20.0, 0.06, 0.05, 2.0
    share, tau = 0.6, 0.5

    def flows(stress, elongation):
        return (stress - E * (1 - share) * elongation / L) / tau

    def rate(t, y):
        stress, gap = y[0], (y[1] if len(y) > 1 else 0.0)
        slope = -T / zeta if len(y) > 1 else np.inf
        grown = (E / L * speed - flows(stress, speed * t - gap)) / (1 + E / L / slope)
        return [grown, grown / slope][: len(y)]

    begins = lambda t, y: y[0] - T  # noqa: E731
    begins.terminal = True
    exact = {"rtol": 1e-11, "atol": 1e-12, "dense_output": True}
    first = solve_ivp(rate, (0, 1), [0.0], events=begins, **exact)
    onset = first.t_events[0][0]
    second = solve_ivp(rate, (onset, 1), [T, 0.0], **exact)
    errors = []
    for n in (8, 16, 32):
        result = bar_with_bond(comm, n)
        t, F = result.history["load"], result.history["F"]
        assert len(t) == n
        assert not result.failures
        expected = np.where(t < onset, first.sol(np.minimum(t, onset))[0], second.sol(t)[0])
        errors.append(np.abs(F - expected).max() / T)
    assert 0.1 < onset < 0.9
    assert errors[2] < 5e-4
    assert errors[0] / errors[2] > 9


@pytest.mark.parametrize("kinematics", ["small", pytest.param("finite", marks=pytest.mark.long)])
def test_a_bond_fails_as_between_elastic_bodies(comm, kinematics):
    """In the limits of times of relaxation: the same rows, none of which has failed, and forces."""
    elastic = vmdg.NeoHookean(E=E, nu=NU)
    by_load = {"kinematics": kinematics, "control": "load"}
    expected = bar_with_bond(comm, 6, material=elastic, **by_load)
    for tau in (1e-9, 1e9):
        moduli = "instantaneous" if tau > 1 else "long-term"
        body = vmdg.Viscoelastic(E, NU, [(0.6, tau)], [(0.6, tau)], moduli=moduli)
        found = bar_with_bond(comm, 6, material=body, **by_load)
        assert len(found.failures) == len(expected.failures)
        assert found.history["load"] == pytest.approx(expected.history["load"])
        near = 1e-7 if kinematics == "small" else 0.02  # W of another kind
        assert found.history["F"] == pytest.approx(expected.history["F"], rel=near)
    assert expected.history["damage"][-1] > 0.2


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_energies_balance(comm, kinematics):
    """To second order in the step."""
    worst = []
    for n in (10, 20):
        history = bar_with_bond(comm, n, kinematics).history
        worst.append(np.abs(history["imbalance"]).max() / history["external"].max())
        assert (np.diff(history["plastic"]) > 0).all()
    assert worst[1] < 1e-3
    assert worst[0] / worst[1] > 3


def test_units(comm):
    """Times, lengths and stresses in other units by powers of two: the same to the last digits."""
    forces = []
    for second, MPa in ((1.0, 1.0), (2.0**10, 2.0**-20)):
        series = [(g, tau * second) for g, tau in SHEAR]
        body = vmdg.Viscoelastic(E * MPa, NU, series)
        scene = two_blocks(comm, "quadrilateral")
        bond = vmdg.Debonding(20.0 * MPa, 0.1)
        problem = joined(scene, bond, (body,) * 2, degree=2)
        problem.dirichlet(scene.facet_tags.find(1), 0.0)
        right = scene.facet_tags.find(2)
        problem.dirichlet(right, lambda t, s=second: (0.05 * t / s, 0.02 * t / s))
        times = second * np.linspace(0, 1, 6)[1:]
        forces.append([])
        for t in times:
            vmdg.solve(problem, [t], vmdg.SolveOptions(duration=1.0))
            forces[-1].append(problem.reaction(right) / MPa)
    assert np.array(forces[1]) == pytest.approx(np.array(forces[0]), rel=1e-9)


@SEVERAL_RANKS
def test_ranks(comm):
    """Forces, energies and histories of one rank, to 1e-8."""
    results = []
    for ranks in (comm, MPI.COMM_SELF):
        history = bar_with_bond(ranks, 8, "finite").history
        results.append([history[name] for name in ("F", "damage", "plastic", "bulk")])
    assert np.array(results[0]) == pytest.approx(np.array(results[1]), rel=1e-8, abs=1e-12)


@pytest.mark.parametrize(
    ("cell", "degree", "options"),
    [
        ("quadrilateral", 2, {"kinematics": "finite"}),
        ("triangle", 1, {"kinematics": "finite", "plane": "stress"}),
        ("quadrilateral", 1, {"kinematics": "finite", "symmetry": "axisymmetric"}),
        ("hexahedron", 1, {"kinematics": "finite", "volumetric": "mean"}),
        ("quadrilateral", 1, {"kinematics": "small", "volumetric": "mean"}),
    ],
)
def test_tangent_of_bodies(comm, cell, degree, options):
    """K.v is the derivative of the forces along v, in a second step with dt of the size of tau."""
    problem = partly_damaged(comm, cell, degree, materials=(BODY, ALIKE), **options)
    matrix = tangent_matrix(problem, dt=0.3)
    assert product_error(problem, partial(multiply, matrix), dt=0.3) < 1e-7
    assert np.abs(problem.discretization.bodies.points.state.dissipated).max() > 1e-3


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_periodic_cell(comm, kinematics):
    """Of one material: the stress of a point under the mean strain, which relaxes."""
    mesh = unit_box(comm, "quadrilateral", 2)
    cells = tag_cells(mesh, {1: lambda x: x[0] < 0.5, 2: lambda x: x[0] > 0.5})
    tie = vmdg.Interface(law=vmdg.Bonded(), facets=lambda x: np.isclose(x[0], 0.5))
    H = np.array([[0.02, 0.03], [0.01, -0.01]])
    small, whole = kinematics == "small", np.zeros((3, 3))
    given = {"strain": (H + H.T) / 2} if small else {"gradient": np.eye(2) + H}
    drive = vmdg.Periodic(**given)
    problem = vmdg.Problem(
        mesh, cells, {1: BODY, 2: BODY}, [tie], periodic=drive, kinematics=kinematics
    )
    whole[:2, :2] = H
    state = BODY.start(1)
    for t, dt in ((0.0, np.inf), (0.3, 0.3), (1.0, 0.7)):
        vmdg.solve(problem, [t], vmdg.SolveOptions(duration=1.0))
        answer = BODY(deformed(whole, small), state, dt, small)
        state = answer.state
        mean = vmdg.PeriodicCell(problem).stress
        assert mean == pytest.approx(answer.stress[0, :2, :2], rel=1e-9)


def test_motion_in_time(comm):
    """A bar that vibrates and calms down: implicit and explicit steps find the same motion, and the
    energies add up to that of the start."""
    ends, rho = [], 1e-9
    for scheme, steps in ((vmdg.GeneralizedAlpha(1.0), 100), (vmdg.CentralDifferences(), 200)):
        scene, given = two_blocks(comm, "quadrilateral"), {"degree": 2, "density": {1: rho, 2: rho}}
        span = 4 * 2.0 / np.sqrt(E / rho)
        body = vmdg.Viscoelastic(E, NU, [(0.5, 0.1 * span)])
        problem = joined(scene, vmdg.Bonded(), (body, body), kinematics="small", **given)
        problem.dirichlet(scene.facet_tags.find(1), 0.0)
        start = lambda x: np.array([1e3 * np.sin(np.pi * x[0] / 4), 0 * x[0]])  # noqa: E731
        options = vmdg.SolveOptions(energy=True)
        times = np.linspace(0, span, steps + 1)[1:]
        right = lambda p: {"u": p.comm.allreduce(p.u.x.array.max(initial=0.0), MPI.MAX)}  # noqa: E731
        h = vmdg.solve_dynamics(problem, times, scheme, start, right, options).history
        whole = h["kinetic"] + h["bulk"] + h["plastic"] + h["interface"]
        assert whole == pytest.approx(h["external"], rel=5e-3)
        assert h["plastic"][-1] > 0.3 * h["external"][-1]
        ends.append(h["u"][steps // 100 - 1 :: steps // 100])
    assert np.abs(ends[0] - ends[1]).max() < 0.02 * np.abs(ends[0]).max()


def test_other_mesh(comm):
    """A bar that relaxes on one mesh goes on relaxing on another."""
    forces, problems = [], []
    for n in (1, 3):
        scene = two_blocks(comm, "quadrilateral", n=n)
        problem = joined(scene, vmdg.Debonding(500.0, 0.1), (BODY, ALIKE), degree=2)
        problem.dirichlet(scene.facet_tags.find(1), 0.0, "x")
        problem.dirichlet(scene.facet_tags.find(2), 0.06, "x")
        for side in (0.0, 1.0):
            problem.dirichlet(lambda x, side=side: np.isclose(x[1], side), 0.0, "y")
        problems.append((problem, scene.facet_tags.find(2)))
    (old, end), (new, other) = problems
    options = vmdg.SolveOptions(duration=1.0, relative_tolerance=1e-12)
    vmdg.solve(old, [0.0, 0.2], options)
    found = vmdg.transfer(old, new)
    assert new.reaction(other)[0] == pytest.approx(old.reaction(end)[0], rel=1e-9)
    assert found.after.plastic == pytest.approx(found.before.plastic, rel=1e-9)
    for problem, facets in problems:
        vmdg.solve(problem, [0.7], options)
        forces.append(problem.reaction(facets)[0])
    assert forces[1] == pytest.approx(forces[0], rel=1e-9)


def test_derivatives_are_refused(comm):
    with pytest.raises(ValueError, match="history of its own"):
        scene = two_blocks(comm, "quadrilateral")
        problem = joined(scene, vmdg.Debonding(20.0, 0.1), (BODY, BODY))
        problem.dirichlet(scene.facet_tags.find(1), 0.0)
        problem.dirichlet(scene.facet_tags.find(2), lambda t: (0.05 * t, 0.0))
        options, names = vmdg.SolveOptions(duration=1.0), ["interface 0: strength"]
        vmdg.solve(problem, [1.0], options, derivatives=names)


def test_duration_is_needed(comm):
    """Or an error says so, before the first step."""
    with pytest.raises(ValueError, match=r"Viscoelastic \(tag 1\) depends on time.*duration=1.0"):
        bar_with_bond(comm, 4, duration=None)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"shear": [(0.7, 1.0), (0.4, 2.0)]}, "sum is at most 1"),
        ({"shear": [(0.5, 0.0)]}, "positive relaxation times"),
        ({"shear": [0.5, 0.1, 3.0]}, "pairs"),
        ({"bulk": [(-0.1, 1.0)]}, "bulk = .* positive shares"),
        ({"shear": [(1.0, 1.0)], "moduli": "long-term"}, "no long-term modulus"),
        ({"moduli": "relaxed"}, "'instantaneous' or 'long-term'"),
        ({"shear": SHEAR, "shift": 2.0}, "shift = 2.0 must be a function"),
        ({"shear": SHEAR, "shift": lambda t: 1 - t}, r"shift\(.*\) = .* positive"),
    ],
)
def test_mistakes(arguments, words):
    with pytest.raises((ValueError, TypeError), match=words):
        vmdg.Viscoelastic(E, NU, **arguments)
