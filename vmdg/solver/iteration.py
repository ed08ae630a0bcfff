"""The iteration on a load step: attempts, line searches and when they are given up.

What Newton's method on the whole problem and that on the gaps alone have in common.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..domain.topology import box_sides
from ..problem.problem import Problem
from ..problem.step import Step
from .predictor import ELASTIC, PATH, EquilibriumPath

#: Tolerance of states on the way to an equilibrium, relative to that of the equilibrium.
SLACK_ON_THE_WAY = 1e3

#: Residual relative to the largest reaction or load so far that is never small enough.
MAX_RESIDUAL = 1e-6


class Criterion:
    """The residual norm at which a step has converged.

    The residual is small when its norm on the free dofs is below ``tolerance`` times the largest
    force the run has seen (reactions, loads, or the imbalance a step starts with). Such a scale
    stays when the body has come apart and no force is left. The imbalance of a step that carries a
    weak bond far beyond its strength may be larger than any force the bond can bear by orders of
    magnitude, so that the residual must also be small against forces that were there.

    Args:
        tolerance: Relative to the largest force.
        step: Holds the largest forces of the run, which this updates.

    Attributes:
        floor: Rounding of the internal forces, below which no residual can come [N].
        slack: Factor on the tolerance of the present step.
    """

    def __init__(self, tolerance: float, step: Step):
        self._tolerance = tolerance
        self._step = step
        self.floor = 0.0
        self.slack = 1.0

    def update(self, imbalance: float = 0.0, reaction: float = 0.0) -> None:
        """Take forces into account: an imbalance, and reactions or loads [N]."""
        scales = self._step.scales
        reaction = max(scales.reaction, reaction)
        force = max(scales.force, imbalance, reaction)
        self._step.scales = replace(scales, force=force, reaction=reaction)

    def goal(self, reaction: float) -> float:
        """Residual norm at which a state with this norm of the reactions has converged [N]."""
        scales = self._step.scales
        reaction = max(scales.reaction, reaction)
        small = min(self._tolerance * max(scales.force, reaction), MAX_RESIDUAL * reaction)
        return max(self.slack * small, self.floor)


#: Line searches: backtracking on the residual norm, full steps, and the least energy.
BACKTRACK, FULL, ENERGY = "backtrack", "full", "energy"

#: Backtracking halves a correction so often at most. It is stuck at a kink if none of these lengths
#: has a smaller residual, or if two corrections leave more than this share of the residual.
MAX_HALVINGS, STALLED = 8, 0.98

#: Full steps may lead to a residual of so many times the largest force. A second attempt must end
#: where at most this share of the energy it exchanged is unaccounted for: larger releases are
#: jumps, whose dissipation is to be counted.
MAX_EXCURSION, MAX_UNACCOUNTED = 5.0, 0.1


@dataclass(frozen=True)
class LoadStep:
    """A step that is to be taken.

    Attributes:
        t: Load factor.
        overstress: Viscous overstress per gap increment in multiples of the softening modulus H:
            that of a jump.
        path: Path parameter at the start and the end of a step of a jump; None for the load factor.
        second: Whether a second attempt with another line search may follow.
        exact: False for a state that is only on the way to an equilibrium.
    """

    t: float
    overstress: float = 0.0
    path: tuple[float, float] | None = None
    second: bool = True
    exact: bool = True


class Correction(NamedTuple):
    """How a residual norm was reached from the one before, or from the start of the step.

    Attributes:
        trials: Residuals the line search has looked at: 1 for a full step, 0 in the predictor.
        krylov: Krylov iterations of its linear systems, 0 where they were solved directly.
        tolerance: Relative tolerance of these iterations.
    """

    trials: int
    krylov: int
    tolerance: float


@dataclass(frozen=True)
class StepReport:
    """How the iteration of a step went.

    Attributes:
        converged: Whether the residual met the tolerance.
        norms: Residual norms on the free dofs, before every correction and at the end [N].
        reason: PETSc's word for how it ended.
        solves: How each of the norms was reached.
        goal: Residual norm at which the step has converged [N].
        krylov: Krylov iterations of all linear systems of the step, the predictor's and those of
            former attempts included; 0 where they were solved directly.
        former: The attempt before this one, with another line search.
    """

    converged: bool
    norms: list[float]
    reason: str
    solves: list[Correction] = field(default_factory=list)
    goal: float = math.nan
    krylov: int = 0
    former: StepReport | None = None

    @property
    def iterations(self) -> int:
        """Newton corrections after the predictor."""
        return max(len(self.norms) - 1, 0)

    def failed(self, reason: str) -> StepReport:
        """The same step, given up for another reason."""
        return replace(self, converged=False, reason=reason)


class Trace:
    """The residual norms of an attempt and what each of them has cost.

    Args:
        krylov: Krylov iterations before the attempt.

    Attributes:
        norms: See :class:`StepReport`.
        solves: See :class:`StepReport`.
    """

    def __init__(self, krylov: int):
        self.norms: list[float] = []
        self.solves: list[Correction] = []
        self._krylov = krylov

    def note(self, norm: float, trials: int, krylov: int, tolerance: float) -> None:
        """Add a norm [N]; ``krylov`` is the count so far, the others as in :class:`Correction`."""
        self.norms.append(norm)
        self.solves.append(Correction(trials, krylov - self._krylov, tolerance))
        self._krylov = krylov

    def report(self, converged: bool, reason: str, goal: float) -> StepReport:
        """What it comes to."""
        return StepReport(converged, self.norms, reason, self.solves, goal)


class Iteration(ABC):
    """Newton's method on the load steps of a problem.

    Args:
        problem: The problem.
        relative_tolerance: Of the residual, see :class:`vmdg.solver.iteration.Criterion`.
        max_iterations: Corrections before an attempt is given up.

    Attributes:
        discretization: What it was made for.
    """

    def __init__(self, problem: Problem, relative_tolerance: float, max_iterations: int):
        self.discretization = problem.discretization
        self._problem = problem
        self._criterion = Criterion(relative_tolerance, problem.step)
        self._max_iterations = max_iterations
        self._path = EquilibriumPath(problem.comm)
        self._dt = 1.0
        self._size = float(np.linalg.norm(box_sides(problem.mesh)))

    def step(self, wanted: LoadStep, dt: float, predictor: str = PATH) -> StepReport:
        """Solve for the loads that ``Step.begin`` has set; collective.

        Args:
            wanted: The step.
            dt: Time step of the return maps [s].
            predictor: One of :data:`vmdg.solver.predictor.PREDICTORS`.
        """
        step, discretization = self._problem.step, self._problem.discretization
        self._dt = dt
        self._criterion.slack = 1.0 if wanted.exact else SLACK_ON_THE_WAY
        scales = step.scales
        start, end = wanted.path or (step.start.t, self._problem.t)
        ahead = self._begin(start, end)
        second = None
        if discretization.can_fail and wanted.second:
            second = FULL if wanted.path is None else ENERGY
        before = self.krylov
        report = self._search(ahead, predictor, second)
        report = replace(report, krylov=self.krylov - before)
        if not report.converged:
            # The forces of a state that is given up say nothing about the run.
            step.scales = scales
        elif wanted.path is not None and start < end:
            # Nor do those that only the overstress of a jump could bear.
            step.scales = replace(step.scales, reaction=scales.reaction)
        return report

    def forget_path(self) -> None:
        """The next step does not continue the path of the last ones."""
        self._path = EquilibriumPath(self._problem.comm)

    def _search(
        self, ahead: list[NDArray[np.float64]], predictor: str, second: str | None
    ) -> StepReport:
        """The line search; at a kink between branches of a law it can jam where another passes."""
        problem, step = self._problem, self._problem.step
        start, force = problem.u.x.array.copy(), step.scales.force
        first = self._attempt(BACKTRACK, ahead, predictor)
        if first.converged or second is None:
            return first
        problem.u.x.array[:] = start
        step.scales = replace(step.scales, force=force)
        step.assemble_residual(self._dt, hold=True)
        stored = step.stored_energy()
        report = replace(self._attempt(second, [], ELASTIC), former=first)
        if report.converged and step.exchange(stored).unaccounted > MAX_UNACCOUNTED:
            return report.failed("DISTANT_EQUILIBRIUM")
        return report

    def _diverged(self, search: str, norms: list[float], trials: int) -> str:
        """PETSc's word for why an attempt is given up, or nothing.

        Args:
            search: The line search.
            norms: Residual norms of the attempt.
            trials: Residuals that the last search has looked at.
        """
        if search == FULL:
            if norms[-1] > MAX_EXCURSION * self._problem.step.scales.force:
                return "DIVERGED_DTOL"
            if np.isclose(norms[-1], norms[-5:-1], rtol=1e-3, atol=0).any():
                return "DIVERGED_LOCAL_MIN"
        elif search == BACKTRACK:
            exhausted = trials > MAX_HALVINGS and norms[-1] >= norms[-2]
            if exhausted or (len(norms) > 4 and norms[-1] > STALLED * norms[-3]):
                return "DIVERGED_LOCAL_MIN"
        return ""

    def _rounding(self, norm: float) -> float:
        """Rounding of the internal forces [N] for a tangent of this infinity norm: eps |K| size."""
        return float(np.finfo(float).eps) * self._size * norm

    @property
    @abstractmethod
    def krylov(self) -> int:
        """Krylov iterations of all steps so far; 0 where systems are solved directly."""

    @abstractmethod
    def _begin(self, start: float, end: float) -> list[NDArray[np.float64]]:
        """What both attempts start from, at these path parameters: where the path may lead."""

    @abstractmethod
    def _attempt(self, search: str, ahead: list[NDArray[np.float64]], predictor: str) -> StepReport:
        """Iterate with a line search."""

    @abstractmethod
    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
