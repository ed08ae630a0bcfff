"""Single attempts of a step: iterated, checked, and committed or cancelled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..assembly.discretization import carried
from ..checks.model import rated
from ..interface.activation import OPENS, REPEATS_STEP, Utilization
from ..interface.stabilization import SoftensTooFast
from ..problem.problem import Problem
from ..sensitivity.derivatives import Derivatives
from .attempt import Attempt
from .corrector import Corrector
from .limits import Direction, Limits
from .options import SolveOptions
from .progress import Progress


class Steps:
    """Attempts of steps of a problem, with a corrector for the facets that are open."""

    def __init__(
        self,
        problem: Problem,
        options: SolveOptions,
        progress: Progress | None = None,
        check: Callable[[], None] = lambda: None,
        derivatives: Derivatives | None = None,
    ):
        self.problem, self.options = problem, options
        self._progress, self._check = progress or Progress(problem, 0, options), check
        self._derivatives, self._dt = derivatives, np.inf
        laws = [interface.law for interface in problem.interfaces]
        self.viscous = rated(problem)
        self.cyclic, self.krylov = options.cycles > 0, 0
        if self.cyclic and not any(law.fatigues for law in laws):
            raise ValueError(
                f"SolveOptions: cycles = {options.cycles}, but no law of the problem depends on "
                "them; use vmdg.FatigueDebonding, or cycles=0"
            )
        bodies = problem.discretization.bodies.points
        if options.duration is None and bodies and bodies.viscous:
            raise ValueError(
                f"SolveOptions: the stress of the {bodies.viscous} depends on time, which is "
                "duration= seconds per unit of load factor; give SolveOptions(duration=1.0) if "
                "load factors are times in seconds"
            )
        self._corrector = self._begin()

    def _begin(self) -> Corrector:
        self.problem.step.ledger.begin_path()
        return Corrector(self.problem, self.options)

    @property
    def rounding(self) -> float:
        """Rounding error of the stored energy of the bodies [N mm]."""
        return self._corrector.rounding

    @property
    def first_stride(self) -> float:
        """Change of the load factor in a first step with cycles, from the law alone."""
        loss, per_factor = self.options.max_loss, self.options.cycles
        laws = (interface.law for interface in self.problem.interfaces)
        return min(law.cycles_at_strength(loss) for law in laws if law.fatigues) / per_factor

    def restart(self) -> None:
        """Continue like a run resumed from a checkpoint of this state; collective.

        Factors and older tangents speed up a run and change its iterates within the tolerance, but
        a resumed run does not have them.
        """
        self._corrector.free()
        self._corrector = self._begin()

    def close(self) -> None:
        self._corrector.free()

    def attempt(self, limits: Limits, last: Attempt | None) -> Attempt:
        """Attempt a step, committed if it converges and cancelled if not; collective.

        Closed facets beyond their strength in the previous state are opened first. A step that
        loads others far beyond is cancelled and repeated with these open.

        Args:
            last: The previous step; None if there is none, or after a load reversal, where damage
                does not continue.
        """
        self._check()
        step = self.problem.step
        utilization = step.activation.utilization()
        if utilization.largest > OPENS:
            # The state of the last step, whose forces balance, is unchanged.
            last = self._opened(utilization, last)
        while True:
            found = self._passes(limits, last)
            if found.converged and (reason := step.invalid()):
                found = found.failed(reason)
            if found.converged and not step.stabilization_suffices():
                reached = self._reached(found)
                if step.raise_stabilization():
                    self._progress.say("step again: tau_s of its end")
                    # Extrapolated over its own length, it begins where it has ended.
                    last = last and reached
                    continue
                found = found.failed("STABILIZATION_OUTGROWN")
            if found.converged:
                utilization = step.activation.utilization()
                if utilization.largest > REPEATS_STEP:
                    step.cancel()
                    last = self._opened(utilization, last)
                    self._progress.say("step again: facets open in it")
                    continue
                found = self._ended(found, limits)
            break
        if found.converged:
            self._differentiate(limits, found)
            step.commit()
            if self.options.energy:
                step.ledger.complete()
        else:
            step.cancel()
        self._progress.attempted(limits, found)
        return found

    def _differentiate(self, limits: Limits, found: Attempt) -> None:
        if self._derivatives is None:
            return
        if limits.jump:
            self._derivatives.pass_jump()
            return
        follows = self.problem.loading.ray is not None and self.problem.t != limits.target
        self._derivatives.advance(self._corrector.system, follows, found.onset, self._dt)

    def _opened(self, utilization: Utilization, last: Attempt | None) -> Attempt | None:
        before, step = self.problem.discretization, self.problem.step
        if not step.open_facets(utilization) or last is None or last.ahead is None:
            return last
        way = carried(last.ahead.u, self.problem.discretization, before)
        return last.going(Direction(way, last.ahead.t))

    def _ended(self, found: Attempt, limits: Limits) -> Attempt:
        """Complete a converged step, and check the loss by cycles."""
        problem, step = self.problem, self.problem.step
        wears = self.cyclic and not limits.jump and problem.t != step.start.t
        lost = step.lost() if wears else 0.0
        if lost > self.options.max_loss:
            return replace(found.failed("WORN"), lost=lost)
        return replace(self._reached(found), lost=lost)

    def _reached(self, found: Attempt) -> Attempt:
        """A converged attempt with its change and its damage work."""
        problem, step = self.problem, self.problem.step
        change = (problem.u.x.array - step.start.u)[: problem.discretization.owned]
        ahead = Direction(change, problem.t - step.start.t)
        return replace(found, work=step.bond_work(), ahead=ahead)

    def _passes(self, limits: Limits, last: Attempt | None) -> Attempt:
        """An attempt in which bodies may crack: passes from the start of the step, each with the
        damage that the last one leads to, until it hardly changes; collective."""
        step, damage = self.problem.step, self.problem.step.damage
        if damage is None:
            return self._iterate(limits, last)
        numbers, given, count = self.options.path, None, 0
        while True:
            found, count = self._iterate(limits, last, given), count + 1
            if not found.converged:
                return replace(found, passes=count)
            given, change = damage.solve(step.start.bodies.damage)
            if change <= numbers.damage:
                return replace(found, passes=count)
            if count == numbers.passes or np.isnan(change):
                return replace(found.failed("STILL_CRACKING"), passes=count)
            # Extrapolated over its own length, the next pass begins where this one has ended.
            last = last and self._reached(found)
            step.return_to(step.start)

    def _iterate(
        self, limits: Limits, last: Attempt | None, damage: NDArray[np.float64] | None = None
    ) -> Attempt:
        """One pass, with another damage of the bodies than that at the start of the step if it is
        given."""
        problem, options, jump = self.problem, self.options, limits.jump
        if self._corrector.discretization is not problem.discretization:
            self.restart()
        # A step of zero length is at rest: rate effects vanish for infinite time. Along a ray the
        # iteration changes the load factor itself.
        moves = 0.0 if jump else abs(limits.target - problem.t)
        t, dt = jump.t if jump else limits.target, moves * (options.duration or 1.0) or np.inf
        self._dt = dt
        if problem.loading.ray is None:
            problem.loading.check_finite(t)
        elif not jump:
            t = problem.t
        try:
            problem.step.begin(t, dt, limits.start if jump else 0.0, moves * options.cycles)
        except SoftensTooFast as error:
            if not (jump or self.viscous):
                raise
            return Attempt(False, reason=str(error))
        if damage is not None:
            problem.step.damage.apply(damage)
        scales = problem.step.scales
        found = self._corrector.solve(limits, dt, last)
        if jump:
            # Forces due to an overstress do not count for the run.
            problem.step.scales = scales
        self.krylov += found.krylov
        return found
