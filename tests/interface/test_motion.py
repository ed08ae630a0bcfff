"""Interface laws in large motion: objectivity, tangents, convergence, load cycles, rates."""

from __future__ import annotations

from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np
import pytest
from support.checks import in_frame, tangent_error
from support.problems import MATERIALS, couple, driven, joined, put, through
from support.scenes import two_blocks

import vmdg
from vmdg import Mode
from vmdg.interface.return_map import map_back

LAW = vmdg.Debonding(strength=100.0, critical_gap=0.2)
TURNS = 4


# Objectivity


def turn_around(comm, cell, **options):
    """Open a patch by (.10, .07[, -.04]) mm, then turn it by 360 degrees in quarters.

    Returns:
        Largest change of R^T.T, R^T.zeta and Q over all points, relative to strength, critical
        gap and strength, after each of the steps that could be solved.
    """
    move = np.array([0.10, 0.07, -0.04])[: 2 if cell == "quadrilateral" else 3]
    problem, _ = driven(
        comm, cell, LAW, lambda t: (min(t, 1) * move, 2 * np.pi * max(t - 1, 0)), **options
    )
    precise = vmdg.SolveOptions(relative_tolerance=1e-12)
    # tau_s belongs to the step before: resting a few steps, the state and its tau_s agree.
    vmdg.solve(problem, [*np.linspace(0.2, 1, 5), *[1.0] * 4], precise)
    start = in_frame(problem)
    _, zeta, Q = start
    assert ((Q > 0.1 * LAW.strength) & (Q < 0.9 * LAW.strength)).all()
    assert (np.abs(zeta[:, :2]) > 0.02 * LAW.critical_gap).all()
    changes = []
    for k in range(1, TURNS + 1):
        try:
            vmdg.solve(problem, [1 + k / TURNS], precise)
        except vmdg.StepFailure:
            break
        now = in_frame(problem)
        scales = (LAW.strength, LAW.critical_gap, LAW.strength)
        changes.append(
            [np.abs(a - b).max() / s for a, b, s in zip(now, start, scales, strict=True)]
        )
    return np.array(changes)


@pytest.mark.parametrize(
    ("group", "cell", "options"),
    [
        (MPI.COMM_WORLD, "quadrilateral", {}),
        (MPI.COMM_SELF, "hexahedron", {}),
        (MPI.COMM_SELF, "quadrilateral", {"n": 2, "materials": MATERIALS}),
    ],
    ids=["plane", "space", "plane-two-materials"],
)
def test_rigid_turn_changes_nothing(group, cell, options):
    """A partly debonded patch turned by 360 degrees keeps Q, R^T.T and R^T.zeta at every step.

    The bound 1e-10 of the strength and the critical gap is a hundred times the measured change:
    the residual is solved to 1e-12.
    """
    changes = turn_around(group, cell, **options)
    assert len(changes) == TURNS
    assert changes.max() < 1e-10


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_far_from_its_place(comm, kinematics):
    """A body carried 10^4 times its size rests where the rounding of positions lets it."""
    scene = two_blocks(comm, "quadrilateral", 4)
    forces = []
    for far in (0.0, 2e4):
        problem = joined(scene, vmdg.Bonded(), kinematics=kinematics)
        problem.dirichlet(scene.facet_tags.find(1), (far, 0.0))
        problem.dirichlet(scene.facet_tags.find(2), (far + 0.01, 0.02))
        assert not vmdg.solve(problem, [1.0]).failures
        forces.append(problem.reaction(scene.facet_tags.find(2)))
    assert forces[1] == pytest.approx(forces[0], rel=1e-6)


# Tangents


@dataclass(frozen=True)
class Branch:
    """Two motions of block 2 against block 1 [mm], after which all points are in one mode."""

    mode: Mode
    before: tuple[float, float, float]
    after: tuple[float, float, float]
    friction: float = 0.3


BRANCHES = (
    Branch(Mode.ELASTIC, (0.08, 0.03, 0.02), (0.0797, 0.03, 0.02)),
    Branch(Mode.TENSION, (0.03, 0.01, 0.02), (0.06, 0.04, 0.01)),
    Branch(Mode.SHEAR, (0.0, 0.0, 0.0), (-0.004, 0.05, 0.03), friction=0.02),
    Branch(Mode.FRICTION, (0.0, 0.0, 0.0), (-0.006, 0.05, 0.03), friction=0.8),
    Branch(Mode.CLOSING, (0.08, 0.03, 0.02), (0.04, 0.06, -0.03)),
    Branch(Mode.OPEN, (0.10, 0.03, 0.02), (0.30, 0.05, 0.02)),
)


@pytest.mark.parametrize(
    ("cell", "branch"),
    [*(("quadrilateral", b) for b in BRANCHES), *(("tetrahedron", b) for b in BRANCHES[1:5:2])],
)
def test_tangent_in_every_mode(comm, cell, branch):
    """K.v = central differences of the residual in every branch, turned by .4 and then .9 rad.

    The step 1e-6 along a v of size 1 leaves 1e-12 of the third derivative and 1e-10 of rounding.
    The branch covers every point, so no difference crosses a switch. The motions are for the r of
    the derived tau_s: they are no equilibria, and the pressure grows with r.
    """
    law = vmdg.Debonding(strength=100.0, critical_gap=0.2, friction=branch.friction)
    scene = two_blocks(comm, cell, 1 if cell == "tetrahedron" else 2)
    problem = couple(scene, law, MATERIALS, safety=1.0)
    motions = (branch.before, 0.4), (branch.after, 0.9)
    through(problem, *(lambda m=m: put(problem, scene, *m) for m in motions))
    error = tangent_error(problem)
    problem.step.commit()
    assert (problem.state[0].mode == branch.mode).all()
    assert error < 1e-7


# Convergence


def along(knots, angles):
    """Path of :func:`driven` through ``knots`` (moves) and ``angles`` at t = 0, 1, 2, ..."""
    knots, angles = np.asarray(knots, dtype=float), np.asarray(angles, dtype=float)

    def path(t):
        i = min(int(t), len(knots) - 2)
        s = t - i
        return ((1 - s) * knots[i] + s * knots[i + 1], (1 - s) * angles[i] + s * angles[i + 1])

    return path


# Load cycles

#: Moves of the right end [mm]: open beyond half of zeta_c, close, press, shear, reopen.
CYCLE = np.array([(0.0, 0.0), (0.14, 0.0), (0.0, 0.0), (-0.02, 0.0), (-0.02, 0.1), (0.3, 0.1)])
STEPS_OF_CYCLE = 200


def cycled(friction, frame):
    """One element a block on the way of :data:`CYCLE`, alone on every rank."""
    law = vmdg.Debonding(strength=100.0, critical_gap=0.2, friction=friction)
    path = along(CYCLE, np.zeros(len(CYCLE)))
    # A factor of tau_s that follows F between steps moves energy, 3e-5 of the work here: fix it.
    return driven(MPI.COMM_SELF, "quadrilateral", law, path, frame=frame, safety=4.0)[0]


def mode_at(problem, t, keep=False):
    """Mode after a step to ``t``, which is taken back unless it is to be kept."""
    start = problem.step.snapshot()
    vmdg.solve(problem, [t], vmdg.SolveOptions(control="load", max_iterations=400, max_cuts=0))
    mode = int(problem.state[0].mode[0])
    if not keep:
        problem.step.return_to(start)
    return mode


def kinks_on_the_way(problem, t):
    """Go to ``t``; load factors at which the active branch changes, by bisection.

    The trapezoidal rule for the external work is exact to second order only on steps that do not
    contain such a kink, so the steps of a cycle are laid between them.
    """
    kinks = []
    while True:
        start = problem.t
        first = mode_at(problem, start + 0.01 * (t - start))
        if mode_at(problem, t) == first:
            mode_at(problem, t, keep=True)
            return kinks
        low, high = start, t
        for _ in range(20):
            middle = (low + high) / 2
            low, high = (middle, high) if mode_at(problem, middle) == first else (low, middle)
        mode_at(problem, low, keep=True)
        mode_at(problem, high, keep=True)
        kinks.append(low)


def kinks_of_cycle(friction, frame):
    """Ends of the legs of the cycle and the load factors where the active branch changes."""
    problem, legs = cycled(friction, frame), len(CYCLE) - 1
    kinks = [kink for t in np.arange(1, 5 * legs + 1) / 5 for kink in kinks_on_the_way(problem, t)]
    found = np.sort([*range(legs + 1), *kinks])
    return found[np.diff(found, prepend=-1) > 1e-6]


@pytest.mark.parametrize(("friction", "frame"), [(0.0, "reference"), (0.3, "corotating")])
def test_load_cycle(friction, frame):
    """Open, close, press, shear, reopen: Q grows only, T follows the law, the energies balance.

    With the switches of the law at ends of steps, 200 steps balance to 1e-6 of the external work
    (sum of |work increments|). What is left is the trapezoidal rule on the curved response of the
    bodies, most of it in the first elastic leg, which gets 40 of the steps. Friction under a
    pressure that changes within the step leaves 2.7e-6, falling by a factor of 3 with half steps.
    """
    ends = kinks_of_cycle(friction, frame)
    share = np.full(len(ends) - 1, (STEPS_OF_CYCLE - 40) // (len(ends) - 2))
    share[0] = 40
    loads = np.concatenate(
        [np.linspace(a, b, k + 1)[1:] for a, b, k in zip(ends[:-1], ends[1:], share, strict=True)]
    )
    assert len(loads) <= STEPS_OF_CYCLE
    problem = cycled(friction, frame)
    states = [problem.state[0]]

    def monitor(problem):
        states.append(problem.state[0])

    options = vmdg.SolveOptions(relative_tolerance=1e-12, energy=True)
    history = vmdg.solve(problem, loads, options, monitor).history
    # Both points of the facet see the same by symmetry; the area is 1.
    R = np.array([state.rotation[0] for state in states])
    T, zeta = (
        np.einsum("tji,tj->ti", R, [getattr(state, name)[0] for state in states])
        for name in ("traction", "gap")
    )
    Q = np.array([state.softening[0] for state in states])
    mode = np.array([state.mode[0] for state in states])
    P_c, H = 100.0, 500.0
    close = {"abs": 1e-8 * P_c}

    # The path: Q never heals, softening on opening, a gap that closes without traction, contact.
    assert (np.diff(Q) >= 0).all()
    opening = mode == Mode.TENSION
    assert opening.any()
    assert T[opening, 0] == pytest.approx(P_c - H * zeta[opening, 0], **close)
    assert Q[opening] == pytest.approx(H * zeta[opening, 0], **close)
    assert Q[opening].max() > P_c / 2
    closing = (mode == Mode.CLOSING) & (zeta[:, 0] > 1e-9)
    assert closing.any()
    assert T[closing, 0] == pytest.approx(0, **close)
    pressed = T[:, 0] < -1e-3 * P_c
    assert pressed.any()
    assert np.abs(zeta[pressed, 0]).max() < 1e-12
    held = np.maximum(P_c - Q, -friction * T[:, 0])
    assert (np.abs(T[pressed, 1]) <= held[pressed] + 1e-8 * P_c).all()
    sliding = (mode == Mode.FRICTION) & pressed
    assert sliding.any()
    assert np.abs(T[sliding, 1]) == pytest.approx(-friction * T[sliding, 0], **close)
    assert (Q[-1], mode[-1]) == (P_c, Mode.OPEN)
    assert T[-1] == pytest.approx(0, **close)

    dissipated = history["damage"] + history["friction"]
    assert (np.diff(dissipated) > -1e-12).all()
    assert (history["friction"][-1] > 0) == (friction > 0)
    work = np.abs(np.diff(history["external"], prepend=0)).sum()
    assert np.abs(history["imbalance"]).max() < (1e-6 if friction == 0 else 3e-6) * work


# Rates


@pytest.mark.parametrize("viscosity", [0.0, 50.0])
def test_overstress_ends_with_the_bond_of_a_bar(comm, viscosity):
    """T = R + eta dgamma R_n/P_c, R_n of the start of the step; blocks 2.9 mm apart are free."""
    law = vmdg.Debonding(strength=100.0, critical_gap=0.2, viscosity=viscosity)
    problem, scene = driven(comm, "quadrilateral", law, lambda t: ((t, 0.0), 0.0))
    step = 0.005
    loads = [*np.arange(1, 60) * step, 2.9]
    history = vmdg.solve(problem, loads, monitor=normal_values).history
    T, gap = history["traction"], history["gap"]
    opens = (gap > 0) & (history["load"] < 1)
    rate = np.diff(gap, prepend=0)[opens] / step
    left = np.maximum(100.0 - 500.0 * np.append(0.0, gap), 0.0)
    start, end = left[:-1][opens], left[1:][opens]
    assert T[opens] == pytest.approx(end + viscosity * rate * start / 100.0, rel=1e-6, abs=1e-6)
    assert np.diff(T).min() > -10.0
    assert T[-1] == 0
    assert np.abs(problem.reaction(scene.facet_tags.find(1))).max() < 1e-9 * law.strength
    assert problem.energy().damage == pytest.approx(10.0, rel=1e-9)


def normal_values(problem: vmdg.Problem) -> dict[str, float]:
    values = problem.mean(0)
    return {"traction": values.traction[0], "gap": values.gap[0]}


def test_drag_slows_the_bonded_points_of_a_step(comm):
    """T = T_law + k dzeta and dzeta = C dT_tr where a bond is left; parted points are free."""
    problem, _ = driven(comm, "quadrilateral", LAW, lambda t: ((0.0, 0.0), 0.0), n=8)
    active, rng = problem.discretization.active[0], np.random.default_rng(4)
    count, k = len(active.quadrature.weights), 3 * LAW.softening_modulus
    parted = np.arange(count) % 2 == 0
    Q = np.where(parted, LAW.strength, 40.0)
    active.history = replace(active.history, softening=Q)
    r = active.stabilization.norm[active.quadrature.facet][:, None]
    trial = np.abs(rng.normal(scale=100.0, size=(count, 2))) + 60.0

    overstress = np.where(parted, 0.0, k)

    def mapped(load, overstress):
        return map_back(LAW, load, replace(active.trial(), overstress_modulus=overstress), 1.0)

    update = mapped(trial, overstress)
    assert not update.traction[parted].any()
    dragged = (update.traction - k * update.gap)[~parted]
    left = LAW.strength - update.softening[~parted]
    assert np.linalg.norm(dragged, axis=1) == pytest.approx(left, rel=1e-9)
    assert update.traction == pytest.approx(trial - r * update.gap, rel=1e-10, abs=1e-9)
    change = 1e-5 * rng.normal(size=trial.shape)
    moved = (mapped(trial + change, overstress).gap - mapped(trial - change, overstress).gap) / 2
    assert moved == pytest.approx(np.einsum("pij,pj->pi", update.tangent, change), abs=1e-12)
    assert np.linalg.norm(mapped(trial, None).traction[~parted], axis=1).max() <= 60.0
