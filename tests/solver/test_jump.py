"""Real snaps: the bar of 7.1.1 with a bond that breaks faster than the blocks unload."""

from __future__ import annotations

import numpy as np
import pytest
from support import bar
from support.bar import LOADS, STRENGTH
from support.budgets import over_budget

import vmdg


def test_stable_bar_needs_no_jump(comm):
    """zeta_c = .041 mm: just stable under displacement control."""
    history = vmdg.solve(bar.build(comm, 0.041), LOADS, monitor=bar.means).history
    assert history["jump_steps"].sum() == 0
    assert (np.diff(history["load"]) > 0).all()


@pytest.mark.parametrize(("critical_gap", "kinematics"), [(0.005, "finite"), (0.01, "small")])
def test_snap_back(comm, critical_gap, kinematics):
    """One jump, from the limit point of the closed form to the equilibrium at its load: apart.

    Before it the bar is bonded, after it free of stress; the bond takes P_c zeta_c / 2, and what
    is released beyond that is counted as viscosity. That is integrated by the trapezoidal rule
    over the steps of the jump: to 3e-3 of the work.
    """
    problem = bar.build(comm, critical_gap, kinematics)
    options = vmdg.SolveOptions(energy=True, relative_tolerance=1e-9)
    result = vmdg.solve(problem, LOADS, options, bar.means)
    history, onset = result.history, 2 * (bar.stretch(STRENGTH, kinematics) - 1)
    (jumped,) = np.flatnonzero(history["jump_steps"])
    assert history["load"][jumped - 1] == pytest.approx(onset, rel=1e-6)
    assert history["load"][jumped] == pytest.approx(onset, rel=1e-6)
    assert (np.diff(history["load"]) >= 0).all()
    assert set(LOADS) <= set(history["load"])
    # The yield function is zero at the onset but for rounding.
    assert np.abs(history["gap"][:jumped]).max() < 1e-12 * critical_gap
    assert history["traction"][jumped - 1] == pytest.approx(STRENGTH, rel=1e-6)
    assert np.abs(history["traction"][jumped:]).max() < 1e-6 * STRENGTH
    assert history["gap"][jumped:] == pytest.approx(history["load"][jumped:], abs=1e-9)
    assert history["damage"][-1] == pytest.approx(STRENGTH * critical_gap / 2, rel=1e-9)
    released = bar.elastic_energy(STRENGTH, kinematics) - STRENGTH * critical_gap / 2
    assert history["viscosity"][-1] == pytest.approx(released, rel=5e-3)
    assert abs(history["imbalance"][-1]) < 3e-3 * history["external"][-1]
    assert not over_budget("bar that jumps", result)


def test_dead_loads_work_while_it_snaps(comm):
    """A weight f of the right block moves by (s - 1)(2 - x) as that goes slack: f (s - 1)/2."""
    problem, f = bar.build(comm, 0.005, "small"), 1e-2
    problem.body_force((f, 0.0), 2)
    options = vmdg.SolveOptions(energy=True, unstable="jump")
    history = vmdg.solve(problem, LOADS, options).history
    (jumped,) = np.flatnonzero(history["jump_steps"])
    work = np.diff(history["external"])[jumped - 1]
    assert work == pytest.approx(f * (bar.stretch(STRENGTH, "small") - 1) / 2, rel=1e-3)


def test_law_with_an_elastic_branch(comm):
    """A jump carries `IntrinsicExponential` too, and what its gap stores is not taken for loss."""
    law = vmdg.IntrinsicExponential(strength=STRENGTH, fracture_energy=1.0, shear_weight=1.0)
    problem = bar.with_law(comm, law)
    history = vmdg.solve(problem, LOADS, vmdg.SolveOptions(energy=True), bar.means).history
    assert (history["jump_steps"] > 0).sum() == 1
    assert history["traction"].max() == pytest.approx(STRENGTH, rel=0.01)
    assert abs(history["traction"][-1]) < 1e-3 * STRENGTH
    assert history["damage"][-1] == pytest.approx(1.0, rel=1e-3)
    assert history["viscosity"][-1] > 0
    assert abs(history["imbalance"][-1]) < 0.02 * history["external"][-1]


def test_under_load_control_the_step_fails(comm):
    """control="load" knows no jump: an error, and the last converged state is intact."""
    problem = bar.build(comm, 0.01)
    options = vmdg.SolveOptions(control="load", max_cuts=3)
    with pytest.raises(vmdg.StepFailure, match="although it was cut") as failure:
        vmdg.solve(problem, LOADS, options, bar.means)
    history = failure.value.result.history
    assert problem.t == history["load"][-1]
    assert problem.mean(0).traction[0] == pytest.approx(history["traction"][-1], rel=1e-12)
    assert problem.mean(0).gap[0] == 0


def test_viscous_bond_that_is_held(comm):
    """At rest its overstress ends: what the bond bears alone is no equilibrium, and it snaps."""
    law = vmdg.Debonding(STRENGTH, 0.01, viscosity=1e4)
    problem, onset = bar.with_law(comm, law), 2 * (bar.stretch(STRENGTH) - 1)
    options = vmdg.SolveOptions(energy=True)
    loads = np.linspace(0, 1.05 * onset, 8)[1:]
    vmdg.solve(problem, loads, options)
    assert problem.mean(0).traction[0] > STRENGTH
    result = vmdg.solve(problem, loads[-1:], options, bar.means)
    assert len(result.history) == 1
    assert result.history["jump_steps"][0] > 0
    assert abs(problem.mean(0).traction[0]) < 1e-6 * STRENGTH
    assert problem.mean(0).gap[0] == pytest.approx(loads[-1], abs=1e-9)
    # A load that is held cannot be cut.
    assert len(result.failures) == 1
