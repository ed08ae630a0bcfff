"""Unstable stages: the bar of 7.1.1 with a bond that breaks faster than the blocks unload."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq

import vmdg
from vmdg.base.parallel import global_max
from vmdg.meshes import blocks
from vmdg.solver.control import advance
from vmdg.solver.iteration import LoadStep, StepReport
from vmdg.solver.jump import FIRST_OVERSTRESS, GROWTH, jump
from vmdg.solver.result import Result
from vmdg.solver.stepper import Stepper

E, NU, STRENGTH = 5000.0, 0.25, 100.0
LOADS = 0.002 * np.arange(1, 31)


def linear(critical_gap: float) -> vmdg.Debonding:
    """The law of most bars."""
    return vmdg.Debonding(strength=STRENGTH, critical_gap=critical_gap)


def bar(comm, law: vmdg.Law) -> vmdg.Problem:
    """Two squares of 1 mm in plane strain, the right end pulled by the load factor."""
    mesh, cells, facets = blocks(comm, "quadrilateral")
    material = vmdg.NeoHookean(E=E, nu=NU)
    interface = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(mesh, cells, {1: material, 2: material}, [interface])
    problem.dirichlet(facets.find(1), 0.0, "x")
    problem.dirichlet(facets.find(2), lambda t: t, "x")
    problem.dirichlet(facets.find(5), 0.0, "y")
    return problem


def onset() -> float:
    """End displacement at which the stress of (86) in plane strain reaches the strength."""
    mu, lmbda = E / (2 * (1 + NU)), NU * E / ((1 + NU) * (1 - 2 * NU))

    def stress(s):
        def lateral(b):
            return mu * (b - 1 / b) + lmbda * (s * b - 1) * s

        b = brentq(lateral, 0.5, 1.5, xtol=1e-15)
        return mu * (s - 1 / s) + lmbda * (s * b - 1) * b

    return 2 * (brentq(lambda s: stress(s) - STRENGTH, 1.0, 1.2, xtol=1e-15) - 1)


def mean(problem: vmdg.Problem) -> dict[str, float]:
    """Traction and gap, the same at all points."""
    values = problem.mean(0)
    return {"traction": values.traction[0], "gap": values.gap[0]}


def test_stable_bar_needs_no_jump(comm):
    """zeta_c = .041 mm: just stable under displacement control, no step is cut."""
    result = vmdg.solve(bar(comm, linear(0.041)), LOADS, monitor=mean)
    assert not result.failures
    assert result.history["jump_steps"].sum() == 0
    assert len(result.history) == len(LOADS)


@pytest.mark.parametrize("critical_gap", [0.02, 0.01, 0.005])
def test_snap_back(comm, critical_gap):
    """Where the bar snaps back, one jump at the onset ends in the equilibrium beyond: apart.

    With six cuts before the jump its start meets the onset of the closed form (.0379 mm); it ends
    at the end of the step. Before it the bar is bonded, after it free of stress; the bond takes
    P_c zeta_c / 2, and what is released beyond that is counted as viscosity. The balance holds to
    1%: displacements are integrated by the trapezoidal rule over steps that contain the kink.
    """
    options = vmdg.SolveOptions(energy=True, jump_after=6)
    history = vmdg.solve(bar(comm, linear(critical_gap)), LOADS, options, mean).history
    (jumped,) = np.flatnonzero(history["jump_steps"])
    assert history["load"][jumped - 1] <= onset() * (1 + 1e-6)
    assert history["load"][jumped - 1] == pytest.approx(onset(), rel=1e-3)
    assert onset() <= history["load"][jumped] < onset() + LOADS[1] - LOADS[0]
    assert (history["gap"][:jumped] == 0).all()
    assert np.abs(history["traction"][jumped:]).max() < 1e-6 * STRENGTH
    assert history["gap"][jumped:] == pytest.approx(history["load"][jumped:], abs=1e-9)
    assert history["damage"][-1] == pytest.approx(STRENGTH * critical_gap / 2, rel=1e-9)
    assert history["viscosity"][-1] > 0
    assert abs(history["imbalance"][-1]) < 0.01 * history["external"][-1]


def test_law_with_an_elastic_branch(comm):
    """A jump carries `IntrinsicExponential` too, and what its gap stores is not taken for loss."""
    law = vmdg.IntrinsicExponential(strength=STRENGTH, fracture_energy=1.0, shear_weight=1.0)
    problem = bar(comm, law)
    history = vmdg.solve(problem, LOADS, vmdg.SolveOptions(energy=True), mean).history
    assert (history["jump_steps"] > 0).sum() == 1
    assert np.abs(history["traction"]).max() == pytest.approx(STRENGTH, rel=0.05)
    assert abs(history["traction"][-1]) < 1e-3 * STRENGTH
    assert history["damage"][-1] == pytest.approx(1.0, rel=1e-3)
    assert history["viscosity"][-1] > 0
    assert abs(history["imbalance"][-1]) < 0.02 * history["external"][-1]


def test_without_jumps_the_step_fails(comm):
    """The same bar with jump=False: an error, and the last converged state is intact."""
    problem = bar(comm, linear(0.01))
    with pytest.raises(vmdg.StepFailure, match="although it was cut") as failure:
        vmdg.solve(problem, LOADS, vmdg.SolveOptions(jump=False, max_cuts=3), mean)
    history = failure.value.result.history
    assert problem.t == history["load"][-1]
    assert problem.mean(0).traction[0] == pytest.approx(history["traction"][-1], rel=1e-12)
    assert problem.mean(0).gap[0] == 0


def test_failed_jump_returns(comm):
    """A jump that is given up leaves the problem in its last converged state."""
    problem = bar(comm, linear(0.01))
    with pytest.raises(vmdg.StepFailure, match="JUMP_FAILED"):
        vmdg.solve(problem, LOADS, vmdg.SolveOptions(max_cuts=2, max_jump_steps=1), mean)
    assert problem.mean(0).gap[0] == 0
    assert problem.energy().dissipated == 0


def test_failed_jump_restores_the_stabilization(comm):
    """In equilibrium again: with tau_s of its own step, not with that of the states on the way."""
    problem = bar(comm, linear(0.01))
    stepper = Stepper(problem, vmdg.SolveOptions(max_jump_steps=3))
    assert stepper.step(LoadStep(0.9 * onset())).converged
    tau, forces = problem.stabilization[0].tau, problem.discretization.forces.x.array.copy()
    report, _ = jump(stepper, 1.1 * onset())
    assert "JUMP_FAILED" in report.reason
    assert np.array_equal(problem.stabilization[0].tau, tau)
    problem.step.assemble_residual(hold=True)
    largest = global_max(comm, np.abs(forces).max(initial=0))
    assert problem.discretization.forces.x.array == pytest.approx(forces, abs=1e-9 * largest)
    stepper.close()


def test_overstress_is_no_measure_of_residuals(comm):
    """What the bond bears with an overstress only, here four times its strength, is forgotten."""
    stepper = Stepper(bar(comm, linear(0.01)), vmdg.SolveOptions(max_jump_steps=3))
    stepper.step(LoadStep(0.9 * onset()))
    largest = stepper.problem.step.scales.reaction
    assert largest > 0
    jump(stepper, 4 * onset())
    assert stepper.problem.step.scales.reaction == largest
    stepper.close()


class Failing(Stepper):
    """Its fourth and fifth steps with overstress fail; keeps what it was asked for."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.calls: list[SimpleNamespace] = []

    def step(self, wanted: LoadStep) -> StepReport:
        viscous = wanted.overstress > 0
        fails = viscous and sum(call.step.overstress > 0 for call in self.calls) in (3, 4)
        report = StepReport(False, [], "") if fails else super().step(wanted)
        at_rest = report.converged and report.iterations == 0 and wanted.exact
        self.calls.append(SimpleNamespace(step=wanted, report=report, at_rest=at_rest))
        return report


def test_second_attempts_in_a_jump(comm):
    """Only where a step with less overstress has failed too, or the state has come to rest."""
    stepper = Failing(bar(comm, linear(0.02)), vmdg.SolveOptions(jump_rest=1.0))
    assert stepper.step(LoadStep(0.99 * onset())).converged
    assert jump(stepper, 1.05 * onset())[0].converged
    calls = stepper.calls[1:]
    assert not calls[0].step.second
    assert calls[-1].step.overstress == 0
    for before, now in pairwise(calls):
        failed = before.step.overstress > 0 and not before.report.converged
        assert now.step.second == (failed if now.step.overstress > 0 else before.at_rest)
    factors = [call.step.overstress for call in calls if call.step.overstress > 0]
    assert factors[3:6] == [factors[3], GROWTH * factors[3], GROWTH**2 * factors[3]]
    stepper.close()


def test_jump_starts_within_a_quarter_of_the_step(comm):
    """By default two cuts come before the jump."""
    history = vmdg.solve(bar(comm, linear(0.02)), LOADS, monitor=mean).history
    (jumped,) = np.flatnonzero(history["jump_steps"])
    step = LOADS[1] - LOADS[0]
    assert onset() - step / 4 <= history["load"][jumped - 1] <= onset() * (1 + 1e-6)


class Halting:
    """Stands in for a Stepper whose steps converge below a length, but not with overstress."""

    def __init__(self, longest: float):
        states = SimpleNamespace(snapshot=lambda: None, return_to=lambda state: None)
        self.problem = SimpleNamespace(t=0.0, step=states)
        self.options = vmdg.SolveOptions()
        self.jumps: list[float] = []
        self._longest = longest

    def step(self, wanted: LoadStep) -> StepReport:
        """Converges if it is short."""
        if wanted.overstress == FIRST_OVERSTRESS:
            self.jumps.append(self.problem.t)
        short = wanted.t - self.problem.t <= self._longest * (1 + 1e-9)
        converged = short and not wanted.overstress
        if converged:
            self.problem.t = wanted.t
        return StepReport(converged, [0.0], "too long")

    def forget_path(self) -> None:
        """Has none."""


def test_cuts_go_on_after_a_failed_jump():
    """Steps are halved until they converge, down to 1/2^max_cuts, though jumps fail on the way."""
    stepper = Halting(1 / 16)
    loads = [part.t for part in advance(stepper, 1.0, Result())]
    assert loads[-1] == 1.0
    assert np.diff(loads, prepend=0.0).max() == pytest.approx(1 / 16)
    # Once from every state: the load at the end is the same.
    assert stepper.jumps
    assert len(set(stepper.jumps)) == len(stepper.jumps)
