"""Section 7.1.1: two blocks pulled apart, against the closed form; failed steps; energies."""

from __future__ import annotations

import numpy as np
import pytest
from support.problems import joined
from support.scenes import DIMENSION

import vmdg
from vmdg.interface.history import PointHistory, works
from vmdg.meshes import blocks

E, NU = 5000.0, 0.25
STRENGTH, CRITICAL_GAP = 100.0, 0.2
LAW = vmdg.Debonding(strength=STRENGTH, critical_gap=CRITICAL_GAP)
SHARP = vmdg.SolveOptions(relative_tolerance=1e-12, control="load")
LEFT, RIGHT, BOTTOM, BACK = 1, 2, 4, 6  # facet tags of meshes.blocks


# The closed form


# The scene


def pulled(comm, cell: str, n: int = 1, law=LAW, **options):
    """Problem of 7.1.1: the left end held, the right end pulled by the load factor."""
    scene = blocks(comm, cell, divisions=(n, n, n))
    material = vmdg.NeoHookean(E=E, nu=NU)
    problem = joined(scene, law, (material, material), **options)
    right = scene.facet_tags.find(RIGHT)
    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0, "x")
    problem.dirichlet(right, lambda t: t, "x")
    problem.dirichlet(scene.facet_tags.find(BOTTOM), 0.0, "y")
    if DIMENSION[cell] == 3:
        problem.dirichlet(scene.facet_tags.find(BACK), 0.0, "z")
    return problem, right


# Failure and retreat


def snapshot(problem):
    """Everything that a failed step must leave alone, on this rank."""
    state = problem.state[0]
    history = problem.discretization.active[0].history
    return {
        "u": problem.u.x.array.copy(),
        "forces": problem.discretization.forces.x.array.copy(),
        "gap": history.gap.copy(),
        "softening": history.softening.copy(),
        "mode": history.mode.copy(),
        "opening": state.opening.copy(),
        "traction": state.traction.copy(),
        "t": np.array(problem.t),
    }


# Options, load factor, and how each attempt ends.
FAILING = {
    "too few iterations": (
        {"max_iterations": 0, "max_cuts": 0, "relative_tolerance": 1e-13, "control": "load"},
        0.10,
        ["DIVERGED_MAX_IT"],
    ),
    "absurd step": (
        {"max_iterations": 4, "max_cuts": 1, "control": "load"},
        -5.0,
        ["DIVERGED", "DIVERGED"],
    ),
}


@pytest.mark.parametrize("name", FAILING)
def test_failed_step_leaves_no_trace(comm, name):
    """After StepFailure the problem is bitwise in its last converged state."""
    settings, target, reasons = FAILING[name]
    problem, _ = pulled(comm, "hexahedron")
    vmdg.solve(problem, [0.04, 0.06], SHARP)
    before = snapshot(problem)
    energy = problem.energy()
    with pytest.raises(vmdg.StepFailure, match="although it was cut") as failure:
        vmdg.solve(problem, [target], vmdg.SolveOptions(**settings))
    after = snapshot(problem)
    energy_after = problem.energy()
    failures = failure.value.result.failures
    assert {name for name in before if not np.array_equal(before[name], after[name])} == set()
    assert energy_after == energy
    assert len(failures) == len(reasons)
    assert failures[0][0] == target
    for (_, why), reason in zip(failures, reasons, strict=True):
        assert reason in why
    assert "0.06" in str(failure.value)


@pytest.mark.parametrize(
    "law",
    [
        vmdg.Contact(0.4),
        vmdg.Debonding(3.0, 0.02, friction=0.4, unloading="secant"),
        vmdg.MixedModeDebonding(3.4, 2.8, 0.02, 0.049, 0.4, unloading="secant"),
    ],
    ids=lambda law: type(law).__name__,
)
def test_friction_at_no_pressure(law):
    """Whether the pressure ends just above or just below zero makes no difference to its work."""
    N, r = np.array([[0.0, 1.0]]), np.array([1000.0])
    Q = np.array([law.strength * (0.4 if law.has_bond else 1.0)])
    start = law.return_map(np.array([[6.0, -2.0]]), N, np.array([[0.005, 0.0]]), Q, r, 1.0)
    history = PointHistory(start.gap, start.softening, start.mode, start.traction)
    found = []
    for pull in (-1e-14, 0.0, 1e-14):
        end = law.return_map(np.array([[3.0, pull]]), N, start.gap, start.softening, r, 1.0)
        found.append(works(history, end, law, N, r)[1, 0])
    assert min(found) > 1e-4
    assert found == pytest.approx([found[0]] * 3, rel=1e-10)
