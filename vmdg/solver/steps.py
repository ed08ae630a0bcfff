"""Single attempts of a step: iterated, checked, and committed or undone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..assembly.discretization import Discretization, carried
from ..interface.activation import OPENS, REPEATS_STEP
from ..problem.problem import Problem
from .attempt import Attempt, Guess
from .corrector import Corrector
from .limits import Direction, Limits
from .options import SolveOptions
from .parameter import Jump
from .progress import Progress


class Steps:
    """Attempts of steps of a problem, with a corrector for the facets that are open.

    Args:
        problem: The problem.
        options: Of the solver.
        progress: Is told how attempts went; None for one by ``options``.
        check: Called before every attempt, may raise to end the run.

    Attributes:
        problem: The problem.
        options: Of the solver.
        viscous: Whether the laws depend on the rate.
        cyclic: Whether cycles of the load wear bonds.
        krylov: Krylov iterations so far.
    """

    def __init__(
        self,
        problem: Problem,
        options: SolveOptions,
        progress: Progress | None = None,
        check: Callable[[], None] = lambda: None,
    ):
        self.problem, self.options = problem, options
        self._progress, self._check = progress or Progress(problem, 0, options), check
        laws = [interface.law for interface in problem.interfaces]
        self.viscous = any(law.viscosity > 0 for law in laws)
        self.cyclic, self.krylov = options.cycles > 0, 0
        if self.cyclic and not any(law.fatigues for law in laws):
            raise ValueError(
                f"SolveOptions: cycles = {options.cycles}, but no law of the problem feels them; "
                "use vmdg.FatigueDebonding, or cycles=0"
            )
        self._corrector = self._begin()

    def _begin(self) -> Corrector:
        self.problem.step.arc = None
        return Corrector(self.problem, self.options)

    @property
    def rounding(self) -> float:
        """Of the energy that bodies store [N mm]."""
        return self._corrector.rounding

    @property
    def first_stride(self) -> float:
        """Change of the load factor in a first step with cycles, whatever bears how much."""
        loss, per_factor = self.options.max_loss, self.options.cycles
        laws = (interface.law for interface in self.problem.interfaces)
        return min(law.cycles_at_strength(loss) for law in laws if law.fatigues) / per_factor

    def restart(self) -> None:
        """Go on as a run that is resumed from a checkpoint of this state; collective.

        Factors and older tangents speed a run up and change its iterations within the tolerance. A
        resumed run has none of them.
        """
        self._corrector.free()
        self._corrector = self._begin()

    def close(self) -> None:
        """Free what PETSc holds; collective."""
        self._corrector.free()

    def attempt(self, limits: Limits, guess: Guess, jump: Jump | None = None) -> Attempt:
        """Take a step, committed if it converges and undone if not; collective.

        Closed facets that the state before it takes beyond their strength are opened first. A step
        that takes others far beyond is undone, they are opened, and it is done again.

        Args:
            limits: Where it ends.
            guess: How the last one went.
            jump: That it is of: limits are of the overstress then, not of the load factor.
        """
        self._check()
        found = self._attempt(limits, guess, jump)
        self._progress.attempted(limits, jump, found)
        return found

    def _attempt(self, limits: Limits, guess: Guess, jump: Jump | None) -> Attempt:
        step, parts = self.problem.step, self.problem.discretization
        # Not as the last step ended: its row is of forces that balance.
        utilization = step.activation.utilization()
        if utilization.largest > OPENS and step.open_facets(utilization):
            guess = replace(guess, ahead=guess.ahead and self._carried(guess.ahead, parts))
        while True:
            parts = self.problem.discretization
            found = self._iterate(limits, guess, jump)
            if not found.converged:
                step.cancel()
                return found
            if step.inverted():
                step.cancel()
                return found.failed("CELLS_INVERTED")
            if not step.stabilization_suffices():
                if step.raise_stabilization():
                    self._progress.say("step again: tau_s of its end")
                    continue
                step.cancel()
                return found.failed("STABILIZATION_OUTGROWN")
            utilization = step.activation.utilization()
            if utilization.largest > REPEATS_STEP:
                step.cancel()
                step.open_facets(utilization)
                self._progress.say("step again: facets open in it")
                guess = replace(guess, ahead=guess.ahead and self._carried(guess.ahead, parts))
                continue
            wears = self.cyclic and not jump and self.problem.t != step.start.t
            lost = step.lost() if wears else 0.0
            if lost > self.options.max_loss:
                step.cancel()
                return replace(found.failed("WORN"), lost=lost)
            change = self.problem.u.x.array[: parts.owned] - step.start.u[: parts.owned]
            way = Direction(change, self.problem.t - step.start.t)
            found = replace(found, work=step.bond_work(), lost=lost, ahead=way)
            step.commit()
            return found

    def _carried(self, way: Direction, before: Discretization) -> Direction:
        """A direction where facets have opened: every cell moves as it did; collective."""
        return Direction(carried(way.u, self.problem.discretization, before), way.t)

    def _iterate(self, limits: Limits, guess: Guess, jump: Jump | None) -> Attempt:
        problem, options = self.problem, self.options
        if self._corrector.discretization is not problem.discretization:
            self.restart()
        # A step of no length is at rest: rate effects vanish for infinite time.
        moves = 0.0 if jump else abs(limits.target - problem.t)
        dt = moves * options.duration or np.inf
        if problem.loading.ray is None:
            problem.loading.check_finite(jump.t if jump else limits.target)
        # Along a ray the iteration moves the load factor itself.
        t = problem.t if problem.loading.ray is not None else limits.target
        begun = (jump.t, dt, limits.start) if jump else (t, dt, 0.0, moves * options.cycles)
        try:
            problem.step.begin(*begun)
        except ValueError as error:
            if not (jump or self.viscous):
                raise
            return Attempt(False, [], str(error))
        scales = problem.step.scales
        found = self._corrector.solve(limits, dt, guess, jump)
        if jump:
            # What a bond bears with an overstress only says nothing about the run.
            problem.step.scales = scales
        self.krylov += found.krylov
        return found
