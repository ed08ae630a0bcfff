"""Section 7.1.1: two blocks pulled apart, against the closed form; failed steps; energies."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from support.checks import gather
from support.problems import joined
from support.scenes import DIMENSION, EVERY_CELL

import vmdg
from vmdg.interface.history import PointHistory, works
from vmdg.meshes import blocks

E, NU = 5000.0, 0.25
STRENGTH, CRITICAL_GAP = 100.0, 0.2
LAW = vmdg.Debonding(strength=STRENGTH, critical_gap=CRITICAL_GAP)
LOADS = 0.02 * np.arange(1, 21)
SHARP = vmdg.SolveOptions(relative_tolerance=1e-12, control="load")
LEFT, RIGHT, BOTTOM, BACK = 1, 2, 4, 6  # facet tags of meshes.blocks


# The closed form


def uniaxial_traction(stretch: float, plane_strain: bool) -> float:
    """P11 of (86) under uniaxial stress; in plane strain the third stretch stays 1."""
    mu = E / (2 * (1 + NU))
    lmbda = NU * E / ((1 + NU) * (1 - 2 * NU))
    power = 1 if plane_strain else 2

    def lateral_traction(t):
        J = stretch * t**power
        return mu * (t - 1 / t) + lmbda * (J - 1) * J / t

    t = brentq(lateral_traction, 0.5, 1.5, xtol=1e-15, rtol=1e-15)
    J = stretch * t**power
    return mu * (stretch - 1 / stretch) + lmbda * (J - 1) * J / stretch


def closed_form(end: float, plane_strain: bool = False) -> tuple[float, float]:
    """zeta and T for the displacement of the end: delta = 2 (s - 1) + zeta, P(s) = R(zeta)."""

    def excess(zeta):
        resistance = STRENGTH * max(1 - zeta / CRITICAL_GAP, 0.0)
        return uniaxial_traction(1 + (end - zeta) / 2, plane_strain) - resistance

    if excess(0.0) <= 0:
        return 0.0, uniaxial_traction(1 + end / 2, plane_strain)
    if excess(CRITICAL_GAP) >= 0:
        return end, 0.0  # apart: both blocks at rest
    zeta = brentq(excess, 0.0, CRITICAL_GAP, xtol=1e-15, rtol=1e-15)
    return zeta, STRENGTH * (1 - zeta / CRITICAL_GAP)


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


def watch(right):
    """Monitor of the gap, the traction and the force at the right end."""

    def monitor(problem):
        state = problem.state[0]
        gap, traction = gather(problem.comm, state.gap), gather(problem.comm, state.traction)
        return {
            "zeta": gap[:, 0].mean(),
            "zeta_spread": np.ptp(gap[:, 0]),
            "T": traction[:, 0].mean(),
            "T_spread": np.abs(traction - traction.mean(axis=0)).max(),
            "lateral": np.abs(np.hstack([gap[:, 1:], traction[:, 1:] / STRENGTH])).max(),
            "force": problem.reaction(right)[0],
        }

    return monitor


@EVERY_CELL
def test_closed_form(comm, cell):
    """zeta, T and the force at all 20 steps equal the closed form to 1e-9 (mm and MPa)."""
    problem, right = pulled(comm, cell)
    result = vmdg.solve(problem, LOADS, SHARP, watch(right))
    history = result.history
    exact = np.array([closed_form(load, DIMENSION[cell] == 2) for load in LOADS])
    assert np.array_equal(history["load"], LOADS)
    assert history["step"].tolist() == list(range(1, len(LOADS) + 1))
    assert [len(norms) - 1 for norms in result.residuals] == history["iterations"].tolist()
    assert np.abs(history["zeta"] - exact[:, 0]).max() < 1e-9
    assert np.abs(history["T"] - exact[:, 1]).max() < 1e-9
    assert np.abs(history["force"] - exact[:, 1]).max() < 1e-9  # on an area of 1
    assert history["zeta_spread"].max() < 1e-9
    assert history["T_spread"].max() < 1e-9
    assert history["lateral"].max() < 1e-9


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
