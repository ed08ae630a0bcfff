"""Single load steps, with the Newton solver that fits the problem."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..interface.activation import OPENS, REPEATS_STEP
from ..problem.problem import Problem
from .condensed_newton import CondensedNewton
from .features import condensation
from .iteration import LoadStep, StepReport
from .newton import Newton
from .options import SolveOptions
from .progress import Progress


class Stepper:
    """Single steps of a problem, with the Newton solver that fits its open facets.

    Args:
        problem: The problem.
        options: See :class:`SolveOptions`.
        progress: What is told how steps went; None for one by ``options``.

    Attributes:
        krylov: Krylov iterations of all steps so far.
    """

    def __init__(self, problem: Problem, options: SolveOptions, progress: Progress | None = None):
        self.problem = problem
        self.options = options
        self._progress = progress or Progress(problem, 0, options)
        self._viscous = any(interface.law.viscosity > 0 for interface in problem.interfaces)
        self.krylov = 0
        self._guards = math.isfinite(options.energy_guard)
        self._newton = self._make_newton()

    def _make_newton(self) -> Newton | CondensedNewton:
        problem, options = self.problem, self.options
        limits = options.relative_tolerance, options.max_iterations
        if condensation(problem, options)[0]:
            return CondensedNewton(problem, *limits)
        return Newton(problem, *limits, options.petsc)

    def restart(self) -> None:
        """Go on as a run that is resumed from a checkpoint of this state; collective.

        Factors, older tangents and the path of the last states speed a run up and change its
        iterations within the tolerance. A resumed run has none of them.
        """
        if isinstance(self._newton, CondensedNewton):
            self._newton.restart()
        else:
            self._newton.destroy()
            self._newton = self._make_newton()

    def forget_path(self) -> None:
        """The next step does not continue the path of the last ones."""
        self._newton.forget_path()

    def close(self) -> None:
        """Free what PETSc holds; collective."""
        self._newton.destroy()

    def step(self, wanted: LoadStep) -> StepReport:
        """Take a step, committed if it converges and undone if not; collective.

        A step that takes closed facets beyond their strength is undone, the facets are opened,
        and the step is done again.
        """
        report = self._step(wanted)
        self._progress.attempted(wanted, report)
        return report

    def _step(self, wanted: LoadStep) -> StepReport:
        step, guards = self.problem.step, self._guards and not wanted.overstress
        while True:
            stored = step.stored_energy() if guards else 0.0
            report = self._iterate(wanted)
            if not report.converged:
                step.cancel()
                return report
            if step.inverted():
                step.cancel()
                return report.failed("CELLS_INVERTED")
            if not step.stabilization_suffices():
                step.cancel()
                return report.failed("STABILIZATION_OUTGROWN")
            if guards and self._created_energy(stored) > self.options.energy_guard:
                step.cancel()
                return report.failed("ENERGY_CREATED")
            utilization = step.activation.utilization()
            if utilization.largest > REPEATS_STEP:
                step.cancel()
                step.open_facets(utilization)
                self._progress.say(f"step to load {wanted.t:.8g} again: facets open within it")
                continue
            step.commit()
            if utilization.largest > OPENS:
                step.open_facets(utilization)
            return report

    def _created_energy(self, stored: float) -> float:
        """Energy that the step would have to create, relative to the work of the run."""
        step = self.problem.step
        exchange = step.exchange(stored)
        work = max(step.scales.work, abs(exchange.before + exchange.external))
        step.scales = replace(step.scales, work=work)
        return exchange.created / max(work, np.finfo(float).tiny)

    def _iterate(self, wanted: LoadStep) -> StepReport:
        problem, options = self.problem, self.options
        if self._newton.discretization is not problem.discretization:
            self._newton.destroy()
            self._newton = self._make_newton()
        # A step of no length is at rest: rate effects vanish for infinite time.
        at_rest = 1.0 if wanted.overstress else np.inf
        dt = abs(wanted.t - problem.t) * options.duration or at_rest
        try:
            problem.step.begin(wanted.t, dt, wanted.overstress)
        except ValueError as error:
            if not (wanted.overstress or self._viscous):
                raise
            return StepReport(False, [], str(error))
        report = self._newton.step(wanted, dt, options.predictor)
        self.krylov += report.krylov
        return report
