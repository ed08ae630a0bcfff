"""Load stepping: steps to given load factors, cut and retried where the iteration fails."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.timers import timer, timings, timings_since
from ..checkpoint.checkpoint import write_checkpoint
from ..interface.activation import OPENS, REPEATS_STEP
from ..output.history import History, HistoryFile
from ..problem.checks import check_model, checked_loads, checked_row
from ..problem.problem import Problem
from ..problem.states import RunScales
from .condensed_newton import CondensedNewton
from .features import condensation, switchboard
from .newton import Newton, StepReport
from .options import SolveOptions
from .predictor import PREDICTORS
from .progress import Progress
from .result import Counts, Result, StepFailure

#: In a jump the overstress falls after a step with so few corrections, and grows by this factor
#: after one that fails.
EASY, SLOWER = 5, 4.0

#: Range of the overstress in a jump, in multiples of H; below it there is none to speak of.
STIFFEST = 1e8

Monitor = Callable[[Problem], Mapping[str, Any] | None]


def solve(
    problem: Problem,
    loads: ArrayLike,
    options: SolveOptions | None = None,
    monitor: Monitor | None = None,
    history: History | None = None,
) -> Result:
    """Solve for a sequence of load factors.

    Args:
        problem: Changed in place; ends in the state of the last load factor.
        loads: Load factors to reach, one after the other.
        options: See :class:`SolveOptions`.
        monitor: Called after every converged step; what it returns joins the history row, by names
            that may say their unit: "force [N]" is column "force".
        history: Table of an earlier run to continue.

    Raises:
        StepFailure: a step fails although it was cut ``max_cuts`` times.
        ValueError: no load factors (and no history), a body that nothing holds, the softening of a
            law is too steep for the mesh (r <= H - eta), an unknown predictor, ``condensed=True``
            where that is not possible, no steps between checkpoints, or columns of the history that
            have the same name, change their unit, or are to be shown and do not exist.
        TypeError: ``options`` or what the monitor returns is of the wrong kind.
        OSError: a checkpoint or the table could not be written; the problem is in the state that
            it should hold.
    """
    options = options or SolveOptions()
    if not isinstance(options, SolveOptions):
        raise TypeError(f"solve: options = {options!r} must be SolveOptions(...)")
    if options.predictor not in PREDICTORS:
        raise ValueError(
            f"SolveOptions: predictor = {options.predictor!r} must be one of {PREDICTORS}"
        )
    if options.checkpoint_every < 1:
        raise ValueError(
            f"SolveOptions: checkpoint_every = {options.checkpoint_every} must be at least 1; "
            "without checkpoint= nothing is written"
        )
    loads = checked_loads(loads, resumed=history is not None)
    result = Result(
        history=History() if history is None else history, switches=switchboard(problem, options)
    )
    if loads.size:
        check_model(problem, loads)
    before, written, stepper = timings(), len(result.history), None
    try:
        with (
            timer("solve"),
            HistoryFile(problem.comm, options.csv, result.history) as file,
            Progress(problem, len(loads), options) as progress,
        ):
            stepper = Stepper(problem, options, progress)
            for number, target in enumerate(loads):
                for part in _advance(stepper, float(target), result):
                    _take_down(part, problem, options, monitor, result)
                    file.update()
                    progress.advanced(number + part.done, part.size, part.report, result.history)
                if len(result.history) - written >= options.checkpoint_every:
                    written = _write_checkpoint(stepper, result)
            if len(result.history) > written:
                _write_checkpoint(stepper, result)
            # Not where a step failed: one rank alone must not wait for the others here.
            stepper.close()
    finally:
        result.timings = timings_since(before)
        result.counts = Counts.from_timings(result.timings, stepper.krylov if stepper else 0)
    if (options.progress or options.verbose) and problem.comm.rank == 0:
        print(result.summary())
    return result


def _write_checkpoint(stepper: Stepper, result: Result) -> int:
    """Write a checkpoint if one is wanted; the number of rows that are safe now."""
    folder = stepper.options.checkpoint
    if folder is not None:
        write_checkpoint(stepper.problem, folder, result.history)
        stepper.restart()
    return len(result.history)


class _Part(NamedTuple):
    """A converged step on the way to a given load factor.

    Attributes:
        t: Load factor.
        done: Share of the way that is done.
        size: Change of the load factor in the step.
        report: How it went.
        cuts: How often the way had been halved.
        jumps: Steps with overstress of a jump.
    """

    t: float
    done: float
    size: float
    report: StepReport
    cuts: int
    jumps: int


def _take_down(
    part: _Part, problem: Problem, options: SolveOptions, monitor: Monitor | None, result: Result
) -> None:
    """Add the row of a converged step."""
    row = {
        "step [-]": len(result.history) + 1,
        "load [-]": part.t,
        "iterations [-]": part.report.iterations,
        "residual [N]": part.report.norms[-1],
        "cuts [-]": part.cuts,
        "jump_steps [-]": part.jumps,
        "krylov [-]": part.report.krylov,
    }
    if options.energy:
        energy = problem.energy()
        energies = asdict(energy) | {"imbalance": energy.imbalance}
        row |= {f"{name} [N mm]": value for name, value in energies.items()}
    result.history.append(row | checked_row(monitor(problem) if monitor else None))
    result.residuals.append(part.report.norms)


def _advance(stepper: Stepper, target: float, result: Result) -> Iterator[_Part]:
    """Reach ``target``, in several steps where one does not converge; failures are taken down."""
    problem, options = stepper.problem, stepper.options
    start = problem.t
    done, size, cuts, failed = 0.0, 1.0, 0, False
    jumped_from = math.nan
    while done < 1.0:
        end = min(done + size, 1.0)
        t = target if end == 1.0 else start + end * (target - start)
        # A smaller step is the cheaper second attempt, as long as there are some left.
        last = cuts >= min(options.jump_after, options.max_cuts)
        report, jumps = stepper.step(t, once=not last), 0
        # From the same state to the same load a jump fails again.
        if not report.converged and last and options.jump and problem.t != jumped_from:
            jumped_from = problem.t
            result.failures.append((t, report.reason))
            # Beyond the limit point by as much as the step allows: near it a jump starts slowly.
            report, jumps = stepper.jump(target)
            if report.converged:
                end, t = 1.0, target
        if not report.converged:
            result.failures.append((t, report.reason))
            cuts, failed = cuts + 1, True
            size = (end - done) / 2
            if cuts > options.max_cuts:
                norms = ", ".join(f"{norm:.3g}" for norm in report.norms[-4:]) or "none"
                raise StepFailure(
                    f"the step from load factor {problem.t:.8g} to {t:.8g} failed "
                    f"({report.reason}, residuals {norms}) although it was cut "
                    f"{options.max_cuts} times; the problem is in its state at {problem.t:.8g}",
                    result,
                )
            continue
        yield _Part(t, end, (end - done) * (target - start), report, cuts, jumps)
        done = end
        if not failed:
            size, cuts = 2 * size, max(cuts - 1, 0)
        failed = False


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
        self._newton = self._make_newton(problem.step.scales)

    def _make_newton(self, scales: RunScales) -> Newton | CondensedNewton:
        problem, options = self.problem, self.options
        scale, borne = scales.force, scales.reaction
        tolerance, iterations = options.relative_tolerance, options.max_iterations
        if condensation(problem, options)[0]:
            return CondensedNewton(problem, tolerance, iterations, scale, borne)
        return Newton(problem, tolerance, iterations, options.petsc, scale, borne)

    def restart(self) -> None:
        """Go on as a run that is resumed from a checkpoint of this state; collective.

        Factors, kept tangents and the path of the last states speed a run up and change its
        iterations within the tolerance. A resumed run has none of them.
        """
        if isinstance(self._newton, CondensedNewton):
            self._newton.restart()
        else:
            self._newton.destroy()
            self._newton = self._make_newton(self.problem.step.scales)

    def close(self) -> None:
        """Free what PETSc holds; collective."""
        self._newton.destroy()

    def step(
        self,
        t: float,
        overstress: float = 0.0,
        along: tuple[float, float] | None = None,
        once: bool = False,
        rough: bool = False,
    ) -> StepReport:
        """One step to load factor ``t``, committed if it converges and undone if not.

        A step that takes closed facets beyond their strength is undone, the facets are opened,
        and the step is done again.

        Args:
            t: Load factor.
            overstress: Viscous regularisation, see :meth:`Step.begin`.
            along: Path parameter at the start and the end of the step; None for the load factor.
            once: Without the second attempt of the iteration.
            rough: The state is only on the way to an equilibrium, and need not be exact.
        """
        report = self._step(t, overstress, along, once, rough)
        self._progress.attempted(t, report, overstress)
        return report

    def _step(
        self,
        t: float,
        overstress: float,
        along: tuple[float, float] | None,
        once: bool,
        rough: bool,
    ) -> StepReport:
        step, guards = self.problem.step, self._guards and not overstress
        while True:
            stored = step.stored_energy() if guards else 0.0
            report = self._try(t, overstress, along, once, rough)
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
                self._progress.say(f"step to load {t:.8g} again: facets open within it")
                continue
            step.commit()
            step.scales = replace(
                step.scales, force=self._newton.scale, reaction=self._newton.borne
            )
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

    def _try(
        self,
        t: float,
        overstress: float,
        along: tuple[float, float] | None,
        once: bool,
        rough: bool,
    ) -> StepReport:
        problem, options = self.problem, self.options
        if self._newton.discretization is not problem.discretization:
            self._newton.destroy()
            scales = RunScales(self._newton.scale, self._newton.borne)
            self._newton = self._make_newton(scales)
        # A step of no length is at rest: rate effects vanish for infinite time.
        dt = abs(t - problem.t) * options.duration or (1.0 if overstress else np.inf)
        try:
            problem.step.begin(t, dt, overstress)
        except ValueError as error:
            if not (overstress or self._viscous):
                raise
            return StepReport(False, [], str(error))
        report = self._newton.step(dt, options.predictor, along, once, rough)
        self.krylov += report.krylov
        return report

    def jump(self, t: float) -> tuple[StepReport, int]:
        """Carry the problem over an unstable stage at load factor ``t``.

        Displacement control has no equilibrium nearby. Steps at this load with an overstress
        eta = factor H per gap increment follow the bond as it breaks; the factor shrinks as they
        converge, until a step without it does: the end is an equilibrium of the law as it is.

        Returns:
            Report of the last step and the number of steps with overstress. If it fails the
            problem is back where it was.
        """
        options = self.options
        before = self.problem.step.snapshot()
        # The time that passes, relative to the viscosity: the path goes on in it.
        factor, elapsed, steps, rest = 4.0, 0.0, 0, 1
        report, rough, again = StepReport(False, [], ""), True, False
        self._newton.forget_path()
        while steps < options.max_jump_steps and 1 / STIFFEST < factor < STIFFEST:
            place = (elapsed, elapsed + 1 / factor)
            # More overstress is the cheaper second attempt, as long as it helps.
            report = self.step(t, factor, place, once=not again, rough=rough)
            steps += 1
            again = not report.converged
            if again:
                factor *= SLOWER
                continue
            elapsed += 1 / factor
            # A state that has hardly left the equilibrium would be taken for the next one.
            arrived = report.iterations == 0 and not rough
            rough = rough and report.iterations > 0
            if (arrived or steps >= rest) and self.problem.step.overstress() < options.jump_rest:
                # While the state moves, more steps are the cheaper second attempt here too.
                report = self.step(t, along=(elapsed, elapsed), once=not arrived)
                if report.converged:
                    self._newton.forget_path()
                    return report, steps
                # It grows from small values while the state leaves the equilibrium: be patient.
                rest = 2 * steps
            if report.iterations <= EASY:
                factor /= 2
        self.problem.step.return_to(before)
        self._newton.forget_path()
        return report.failed(f"JUMP_FAILED after {steps} steps"), steps
