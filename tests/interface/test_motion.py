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


# Load cycles

# Rates


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
