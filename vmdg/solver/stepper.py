"""Single load steps: iterated, checked, and committed or undone."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np

from ..assembly.discretization import Discretization, carried
from ..interface.activation import OPENS, REPEATS_STEP
from ..problem.problem import Problem
from .control import Control, Direction
from .newton import Newton
from .options import SolveOptions
from .progress import Progress
from .report import StepReport


class Stepper:
    """Single steps of a problem, with a Newton solver for the facets that are open.

    Args:
        problem: The problem.
        options: See :class:`SolveOptions`.
        progress: What is told how steps went; None for one by ``options``.

    Attributes:
        krylov: Krylov iterations of all steps so far.
        viscous: Whether the laws depend on the rate.
        cyclic: Whether cycles of the load wear bonds.
    """

    def __init__(self, problem: Problem, options: SolveOptions, progress: Progress | None = None):
        self.problem = problem
        self.options = options
        self._progress = progress or Progress(problem, 0, options)
        self.viscous = any(interface.law.viscosity > 0 for interface in problem.interfaces)
        self.cyclic = options.cycles > 0
        if self.cyclic and not any(interface.law.fatigues for interface in problem.interfaces):
            raise ValueError(
                f"SolveOptions: cycles = {options.cycles}, but no law of the problem feels them; "
                "use vmdg.FatigueDebonding, or cycles=0"
            )
        self.krylov = 0
        self._newton = self._begin()

    @property
    def rounding(self) -> float:
        """Of the energy that bodies store [N mm]."""
        return self._newton.rounding

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
        self._newton.destroy()
        self._newton = self._begin()

    def _begin(self) -> Newton:
        self.problem.step.arc = None
        return Newton(self.problem, self.options)

    def close(self) -> None:
        """Free what PETSc holds; collective."""
        self._newton.destroy()

    def step(
        self, control: Control, ahead: Direction | None = None, overstress: float = 0.0
    ) -> StepReport:
        """Take a step, committed if it converges and undone if not; collective.

        A step that takes closed facets beyond their strength is undone, the facets are opened,
        and the step is done again.

        Args:
            control: How far it goes.
            ahead: Change in the last step, where the path goes on as it was.
            overstress: Of a jump, per gap increment in multiples of H.
        """
        report = self._step(control, ahead, overstress)
        self._progress.attempted(control, overstress, report)
        return report

    def _step(self, control: Control, ahead: Direction | None, overstress: float) -> StepReport:
        step = self.problem.step
        while True:
            parts = self.problem.discretization
            # A control changes on the way.
            report = self._iterate(copy(control), ahead, overstress)
            if not report.converged:
                step.cancel()
                return report
            if step.inverted():
                step.cancel()
                return report.failed("CELLS_INVERTED")
            if not step.stabilization_suffices():
                if step.raise_stabilization():
                    self._progress.say(f"step to load {control.target:.8g} again: tau_s of its end")
                    continue
                step.cancel()
                return report.failed("STABILIZATION_OUTGROWN")
            utilization = step.activation.utilization()
            if utilization.largest > REPEATS_STEP:
                step.cancel()
                step.open_facets(utilization)
                self._progress.say(f"step to load {control.target:.8g} again: facets open in it")
                ahead = ahead and self._carried(ahead, parts)
                continue
            wears = self.cyclic and not overstress and self.problem.t != step.start.t
            lost = step.lost() if wears else 0.0
            if lost > self.options.max_loss:
                step.cancel()
                return replace(report.failed("WORN"), lost=lost)
            change = self.problem.u.x.array[: parts.owned] - step.start.u[: parts.owned]
            way = Direction(change, self.problem.t - step.start.t)
            report = replace(report, work=step.bond_work(), lost=lost, change=way, ahead=way)
            step.commit()
            if utilization.largest > OPENS:
                step.open_facets(utilization)
                report = replace(report, change=None, ahead=self._carried(way, parts))
            return report

    def _carried(self, way: Direction, before: Discretization) -> Direction:
        """A direction where facets have opened: every cell moves as it did; collective."""
        return Direction(carried(way.u, self.problem.discretization, before), way.t)

    def _iterate(self, control: Control, ahead: Direction | None, overstress: float) -> StepReport:
        problem, options = self.problem, self.options
        if self._newton.discretization is not problem.discretization:
            self.restart()
        # A jump takes no time, and a step of no length is at rest: rate effects vanish for infinite
        # time.
        moves = 0.0 if control.brakes else abs(control.target - problem.t)
        dt = moves * options.duration or np.inf
        # Along a ray the iteration moves the load factor itself; in a jump it stays.
        stays = problem.loading.ray is not None or control.brakes
        t = problem.t if stays else control.target
        try:
            problem.step.begin(t, dt, overstress, 0.0 if overstress else moves * options.cycles)
        except ValueError as error:
            if not (overstress or self.viscous):
                raise
            return StepReport(False, [], str(error))
        scales = problem.step.scales
        report = self._newton.solve(control, dt, ahead)
        if overstress:
            # What a bond bears with an overstress only says nothing about the run.
            problem.step.scales = scales
        self.krylov += report.krylov
        return report
