"""The equilibrium path to given load factors: how far steps go, cuts, snaps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..base.parallel import global_sum
from ..problem.problem import Problem
from .control import Arrival, Control, Direction
from .report import StepReport
from .result import Result, StepFailure
from .stepper import Stepper

#: A step spends at most this share of all bonds.
MAX_SHARE = 0.1

#: Corrections that a step should take: with fewer the next one goes further.
AIM = 5

#: Largest growth of a step, and what a failed one is cut by.
GROWTH, CUT = 1.5, 0.25
import os
FIRST = float(os.environ.get('FIRST', 5))
AIM=float(os.environ.get('AIM', 5))
GROWTH=float(os.environ.get('GROWTH', 1.5))


class Part(NamedTuple):
    """A converged step on the way to a given load factor.

    Attributes:
        t: Load factor.
        done: Share of the way that is done.
        size: Change of the load factor in the step.
        report: How it went.
        cuts: How often the way had been cut.
        jumps: Steps with overstress of a jump.
    """

    t: float
    done: float
    size: float
    report: StepReport
    cuts: int
    jumps: int


def bond_energy(problem: Problem) -> float:
    """Energy that breaking all intact bonds of open facets takes, about; collective [N mm]."""
    energy = 0.0
    for active in problem.discretization.active.values():
        law = active.law
        if law.inelastic and law.strength > 0:
            per_area = law.strength**2 / (2 * law.softening_modulus)
            energy += per_area * active.quadrature.weights.sum()
    thickness = float(problem.discretization.geometry.thickness)
    return thickness * float(global_sum(problem.comm, energy))


def facet_energy(problem: Problem) -> float:
    n = sum(len(a.facets.facets) for a in problem.discretization.active.values() if a.law.inelastic and a.law.strength > 0)
    return bond_energy(problem)/max(int(global_sum(problem.comm, n)), 1)

class Path:
    """Follows the equilibrium path of a problem.

    Args:
        stepper: Takes the steps.
    """

    def __init__(self, stepper: Stepper):
        self._stepper = stepper
        self._problem = stepper.problem
        self._work = FIRST * facet_energy(self._problem)
        self._limit = 0.1 * bond_energy(self._problem)
        self._last = 0.0
        self._path_mode = False
        self._ahead: Direction | None = None
        self._rates: tuple[np.ndarray, ...] | None = None

    def _set_out(self, target: float) -> bool:
        """Whether the way to a load factor can be followed by damage work."""
        loading, t = self._problem.loading, self._problem.t
        dissipates = self._work > 0 and not self._stepper.viscous
        if self._stepper.options.control == "load" or not dissipates:
            loading.clear_ray()
            return False
        if not loading.set_ray(t, target):
            self._ahead, self._rates = None, None
            return False
        ray = loading.ray
        rates = ray.rate(ray.prescribed), ray.rate(ray.vectors)
        if self._rates is not None:
            for old, new in zip(self._rates, rates, strict=True):
                if len(old) != len(new) or not np.allclose(old, new, rtol=1e-6, atol=1e-9 * np.abs(new).max(initial=0.0)):
                    self._ahead = None
        self._rates = rates
        return True

    def advance(self, target: float, result: Result) -> Iterator[Part]:
        """Reach ``target``; failures join the result."""
        problem, options = self._problem, self._stepper.options
        start, share, cuts, passed = problem.t, 1.0, 0, None
        follows = self._set_out(target)
        span = abs(target - start)
        sense = np.sign(target - start)
        tried_arrival = False
        while True:
            t = problem.t
            end = target if share == 1 else t + share * (target - t)
            ahead = self._ahead
            if passed is not None:
                # Between here and a state beyond the target.
                part = (target - t) / passed.change.t
                control = Arrival(target, part * passed.work, span, (0.0, t), (passed.work, t + passed.change.t), np.inf, sense)
                ahead = passed.change
            elif follows and self._path_mode and self._last > 0 and not tried_arrival and self._leads_to(end, sense):
                control = Arrival(target, (target - t) / self._ahead.t * self._last, span, (0.0, t), None, 2 * self._work, sense)
            elif follows and self._path_mode:
                control = Control(end, self._work, span)
            else:
                control = Control(end, None, span)
            before = problem.step.snapshot()
            report = self._stepper.step(control, ahead)
            if report.converged and control.work is None and follows and report.work > self._limit:
                problem.step.return_to(before)
                report = report.failed("JUMPED")
            if report.converged and (problem.t - target) * sense > 0:
                # Passed on the way: the state in between is asked for.
                problem.step.return_to(before)
                passed = report
                continue
            if not report.converged:
                result.failures.append((end, type(control).__name__ + report.reason))
                cuts += 1
                if passed is not None:
                    self._work = passed.work / 2
                    passed = None
                elif isinstance(control, Arrival):
                    tried_arrival = True
                elif control.work is None and follows:
                    self._path_mode = True
                else:
                    share /= 2
                    self._work *= CUT
                if cuts > 2*options.max_cuts:
                    norms = ", ".join(f"{norm:.3g}" for norm in report.norms[-4:]) or "none"
                    raise StepFailure(
                        f"the step from load factor {t:.8g} to {end:.8g} failed "
                        f"({report.reason}, residuals {norms}) although it was cut "
                        f"{options.max_cuts} times; the problem is in its state at {t:.8g}",
                        result,
                    )
                continue
            passed = None
            self._ahead = report.change
            self._last = report.work
            self._adapt(report, problem.t == target)
            share, tried_arrival = min(2 * share, 1.0), False
            done = 1.0 if problem.t == target else (problem.t - start) / (target - start)
            yield Part(problem.t, min(max(done, 0), 1), problem.t - t, report, cuts, 0)
            cuts = max(cuts - 1, 0)
            if problem.t == target:
                return

    def _leads_to(self, end: float, sense: float) -> bool:
        """Whether the path as it was leads to a load factor within the work of a step."""
        if self._ahead is None or self._last == 0:
            return True
        return (self._problem.t + self._work / self._last * self._ahead.t - end) * sense >= 0

    def _adapt(self, report: StepReport, arrived: bool) -> None:
        """Choose the work of the next step."""
        growth = min(AIM / max(report.iterations, 1), GROWTH)
        if not arrived:
            self._work *= growth
        elif growth > 1:
            self._work = max(self._work, growth * report.work)
        self._work = min(self._work, MAX_SHARE * bond_energy(self._problem))
