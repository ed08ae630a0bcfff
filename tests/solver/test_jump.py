"""Real snaps: the bar of 7.1.1 with a bond that breaks faster than the blocks unload."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from support import bar
from support.bar import CRITICAL_GAPS, LOADS, STRENGTH
from support.budgets import over_budget

import vmdg
from vmdg.base.parallel import global_max
from vmdg.solver.attempt import Attempt
from vmdg.solver.jump import jump
from vmdg.solver.limits import Limits, Reach
from vmdg.solver.path import Path
from vmdg.solver.result import Result
from vmdg.solver.steps import Steps

#: Of the stage in which the bar breaks.
SPAN = LOADS[1] - LOADS[0]

#: Of a step in a jump, of a bond that takes STRENGTH * .02 / 2 per area of 1 [N mm].
WORK = 0.1 * STRENGTH * 0.02 / 2

PATH = vmdg.SolveOptions().path


def test_stable_bar_needs_no_jump(comm):
    """zeta_c = .041 mm: just stable under displacement control."""
    history = vmdg.solve(bar.build(comm, 0.041), LOADS, monitor=bar.means).history
    assert history["jump_steps"].sum() == 0
    assert (np.diff(history["load"]) > 0).all()


@pytest.mark.parametrize("kinematics", ["finite", "small"])
@pytest.mark.parametrize("critical_gap", CRITICAL_GAPS)
def test_snap_back(comm, critical_gap, kinematics):
    """One jump, from the limit point of the closed form to the equilibrium at its load: apart.

    Before it the bar is bonded, after it free of stress; the bond takes P_c zeta_c / 2, and what
    is released beyond that is counted as viscosity. That is integrated by the trapezoidal rule
    over the steps of the jump: to 3e-3 of the work.
    """
    problem = bar.build(comm, critical_gap, kinematics)
    options = vmdg.SolveOptions(energy=True)
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


class Failing(Steps):
    """Some of its steps in a jump fail, counted from 0; keeps what it was asked for."""

    fails = range(3, 5)

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.calls: list[SimpleNamespace] = []

    def attempt(self, limits, last) -> Attempt:
        report = Attempt(converged=False, guessed=Reach(work=WORK))
        if limits.jump is None or len(self.calls) not in self.fails:
            report = super().attempt(limits, last)
        if limits.jump is not None:
            self.calls.append(SimpleNamespace(limits=limits, report=report))
        return report


def test_failed_jump_returns(comm):
    """A jump that is given up leaves the problem as it was, to all digits."""
    problem = bar.build(comm, 0.01)
    stepper, onset = Failing(problem, vmdg.SolveOptions()), 2 * (bar.stretch(STRENGTH) - 1)
    assert stepper.attempt(Limits(0.0, 0.9 * onset, SPAN), None).converged
    tau, forces = problem.stabilization[0].tau, problem.discretization.forces.x.array.copy()
    stepper.fails = range(1, 99)
    report, _ = jump(stepper, 1.1 * onset, WORK)
    assert "JUMP_FAILED" in report.reason
    assert np.array_equal(problem.stabilization[0].tau, tau)
    problem.step.assemble_residual(hold=True)
    largest = global_max(comm, np.abs(forces).max(initial=0))
    assert problem.discretization.forces.x.array == pytest.approx(forces, abs=1e-9 * largest)
    stepper.close()


def test_overstress_is_no_measure_of_residuals(comm):
    """What the bond bears with an overstress only, here four times its strength, is forgotten."""
    onset = 2 * (bar.stretch(STRENGTH) - 1)
    stepper = Failing(bar.build(comm, 0.01), vmdg.SolveOptions())
    stepper.attempt(Limits(0.0, 0.9 * onset, SPAN), None)
    largest = stepper.problem.step.scales.reaction
    assert largest > 0
    stepper.fails = range(3, 99)
    jump(stepper, 4 * onset, WORK)
    assert stepper.problem.step.scales.reaction == largest
    stepper.close()


def test_overstress_of_a_jump(comm):
    """Steps end where bonds have taken what they may, less after one that fails, the last at rest.

    The work of all is that of the bond, and the overstress is what holds back what drives it.
    """
    onset = 2 * (bar.stretch(STRENGTH) - 1)
    stepper = Failing(bar.build(comm, 0.02), vmdg.SolveOptions())
    assert stepper.attempt(Limits(0.0, 0.99 * onset, SPAN), None).converged
    report, steps = jump(stepper, 1.05 * onset, WORK)
    assert report.converged
    calls = stepper.calls
    assert len(calls) == steps
    assert calls[0].limits.start == PATH.overstress
    assert report.end == 0
    ends = [call.report.end for call in calls if call.report.converged]
    assert min(ends[:-1]) > 0
    for values, cut in (
        ([call.limits.work for call in calls], PATH.cut),
        ([call.limits.start for call in calls], 1 / PATH.cut),
    ):
        assert values[3:6] == [values[3], cut * values[3], cut**2 * values[3]]
    for call in calls:
        assert call.report.work <= (1 + PATH.missed) * call.limits.work
    assert sum(call.report.work for call in calls) == pytest.approx(STRENGTH * 0.02 / 2, rel=1e-6)
    assert abs(stepper.problem.mean(0).traction[0]) < 1e-6 * STRENGTH
    stepper.close()


class Stuck(Steps):
    """No step finds an equilibrium before a jump at ``free``."""

    free = math.inf

    def attempt(self, limits, last) -> Attempt:
        if limits.jump is not None and limits.jump.t == self.free:
            self.free = None
        found = super().attempt(limits, last) if self.free is None else None
        return found or Attempt(False, reason="DIVERGED_LOCAL_MIN")


def test_jump_at_the_given_load(comm):
    """Where none at the smallest attempt comes to an equilibrium."""
    onset, result = 2 * (bar.stretch(STRENGTH) - 1), Result()
    stepper = Stuck(bar.build(comm, 0.02), vmdg.SolveOptions())
    stepper.free = 1.05 * onset
    parts = list(Path(stepper, result).advance(1.05 * onset))
    assert [part.t for part in parts] == [1.05 * onset]
    assert parts[0].jumps > 1
    assert [reason.split()[0] for _, reason in result.failures].count("JUMP_FAILED") == 1
    assert abs(stepper.problem.mean(0).traction[0]) < 1e-6 * STRENGTH
    stepper.close()
