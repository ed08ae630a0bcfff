"""Newton's method for a step: PETSc SNES on displacement and load factor.

The unknowns are (u, lambda), lambda the load factor, or the overstress of a jump. In addition to
R(u, lambda) = 0 of (46) the step ends where the first of its limits is met, g(u, lambda) = 0 of
:mod:`vmdg.solver.limits`. The bordered system is solved by block elimination: with the tangent K
and f = -dR/dlambda, the loads,

    K.du_0 = -R,    K.du_1 = f,    du = du_0 + dlambda du_1,

eliminates the linearised R for every dlambda, which follows from g. If the damage work is limited,
a correction that would exceed the limit by far is shortened; return maps alone determine the
length.
"""

from __future__ import annotations

import math
from dataclasses import replace

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_max, global_norm, warn_together
from ..base.timers import timer
from ..compat import SNES_REASONS
from ..domain.topology import box_sides
from ..linear.ksp import MAX_RTOL, linear_tolerance
from ..linear.system import System
from ..problem.problem import Problem
from ..problem.states import RunScales
from ..problem.step import cause
from .attempt import Attempt
from .iterate import Iterate
from .limits import Direction, Limits, Reach, packed, unpacked
from .onset import Pieces
from .options import SolveOptions
from .parameter import Rate
from .snes import Snes, rounding_of_forces, verdict
from .turn import turn

Array = NDArray[np.float64]


class Corrector:
    """Finds the equilibrium in which a step ends, with one matrix and one SNES for all steps."""

    def __init__(self, problem: Problem, options: SolveOptions):
        self.discretization = problem.discretization
        self._problem, self._options = problem, options
        self._system = System(problem, options.petsc)
        # lambda is the last unknown of every rank, the same on all of them.
        self._snes = Snes(problem.comm, problem.discretization.owned + 1, options)
        self._size = float(np.linalg.norm(box_sides(problem.mesh)))
        self._rounds, self._softest = False, 0.0
        self._pieces = Pieces(problem.discretization)

    @property
    def system(self) -> System:
        return self._system

    @property
    def rounding(self) -> float:
        return float(np.finfo(float).eps) * self._size * self._size * self._system.norm

    def solve(self, limits: Limits, dt: float, last: Attempt | None) -> Attempt:
        """Find the equilibrium at which the first of the limits is met; collective."""
        problem, krylov, scales = self._problem, self._system.iterations, self._problem.step.scales
        self._system.lags = False
        given = problem, self._system, self._pieces, self._options.path, self._size
        iterate = Iterate(*given, limits, dt, continues=last is not None)
        newton = _Newton(problem, self._options, self._system, iterate, self._size, dt)
        with timer("predictor"):
            newton.predict(last)
        converged, reason = self._snes.solve(newton, packed(iterate.place()))
        reason = reason if converged else cause(problem.discretization, reason)
        found = newton.attempt()
        # The forces of a failed attempt do not count for the run.
        if converged:
            scales = problem.step.scales.with_forces(reaction=iterate.reaction())
            self._warn_of_rounding(found.norms[-1], scales.reaction)
        problem.step.scales = scales
        return replace(
            found,
            converged=converged,
            reason=reason,
            krylov=self._system.iterations - krylov,
            unstable=self._system.unstable,
        )

    def _warn_of_rounding(self, norm: float, reaction: float) -> None:
        """Warn once if the rounding of a stiff body is large relative to the forces of softer
        ones."""
        numbers = self._options.path
        if self._rounds or norm <= numbers.small / numbers.missed * reaction:
            return
        self._softest = self._softest or self._least_stiffness()
        # Otherwise there is no strain, and all forces are rounding.
        self._rounds = reaction > numbers.small * self._softest * self._size
        if self._rounds:
            warn_together(
                self._problem.comm,
                f"forces balance only to {norm:.2g} N, of {reaction:.3g} N: this is the rounding "
                "error of the stiffest body. Use a smaller modulus for it (1e4 to 1e6 times that "
                "of the others is practically rigid), or prescribe its displacement and omit it",
            )

    def _least_stiffness(self) -> float:
        """Least stiffness of a dof of the bodies; collective [N/mm]."""
        matrix = self.discretization.create_matrix(PETSc.Mat.Type.AIJ)
        self.discretization.assemble_tangent(matrix, failing=False)
        diagonal = matrix.getDiagonal().array
        # Means are excluded.
        softest = diagonal.min(initial=math.inf, where=diagonal > 0)
        matrix.destroy()
        return -global_max(self._problem.comm, -float(softest))

    def free(self) -> None:
        self._system.free()
        self._snes.free()


class _Newton:
    """The iteration of one attempt: callbacks of PETSc for residual, matrix and linear solver."""

    def __init__(
        self,
        problem: Problem,
        options: SolveOptions,
        system: System,
        iterate: Iterate,
        size: float,
        dt: float,
    ):
        self._problem, self._comm, self._step = problem, problem.comm, problem.step
        self._loading, self._options, self._numbers = problem.loading, options, options.path
        self._system, self._iterate, self._size, self._dt = system, iterate, size, dt
        self._ends_at_target = True
        self._norms: list[float] = []
        # Forces that the predictor balanced, if it is a whole correction.
        self._balanced = 0.0
        self._goal, self._slope, self._rtol = math.nan, 0.0, MAX_RTOL
        self._guessed = Reach()
        self._rate: Rate | None = None  # derivative by the parameter, at the last correction

    def attempt(self) -> Attempt:
        return Attempt(
            norms=self._norms,
            goal=self._goal,
            guessed=self._guessed,
            end=self._iterate.parameter.value,
            slope=self._slope,
            onset=self._iterate.limits.at_onset,
            passed=self._iterate.passed,
        )

    # Predictor

    def predict(self, last: Attempt | None) -> None:
        """Predict by rotation with the supports, by extrapolation, or along the tangent."""
        iterate = self._iterate
        if not iterate.parameter.moves and turn(self._problem, self._numbers.missed):
            self._step.assemble_residual(self._dt)
            self._follow(iterate.place(), self._correct(-iterate.forces()))
        elif last is None or last.ahead is None or not self._extrapolate(last):
            self._along_tangent(last)
        self._guessed = iterate.reach()._replace(
            arc_length=global_norm(self._comm, iterate.moved())
        )

    def _along_tangent(self, last: Attempt | None) -> None:
        """Predict along the tangent; if crack faces overlap then, with closing points sticking."""
        step, iterate, limits = self._step, self._iterate, self._iterate.limits
        step.hold(self._dt, last is None or last.ahead is None, last is not None)
        free = iterate.forces()
        step.scales = step.scales.with_forces(global_norm(self._comm, free))
        self._follow(iterate.start, self._correct(-free))
        if step.close(self._dt):
            self._balanced = 0.0
            iterate.restart(limits)
            self._go(iterate.start, self._correct(-iterate.forces()), 1.0)

    def _extrapolate(self, last: Attempt) -> bool:
        """Extrapolate the last step until a limit is met; False if none is near."""
        iterate, ahead, limits = self._iterate, last.ahead, self._iterate.limits
        left, way = limits.target - limits.start, global_norm(self._comm, ahead.u)
        if ahead.t * left < 0 and last.work == 0:
            return False
        ratios = ((left, ahead.t), (limits.work, last.work), (limits.arc_length, way))
        length = min((x / done for x, done in ratios if x * done > 0), default=math.inf)
        if length >= 1 / self._numbers.cut:
            return False
        iterate.along = ahead.u / way if way > 0 else None
        self._go(iterate.start, ahead, length)
        return True

    def _follow(self, start: Direction, way: Direction) -> None:
        """Move along a correction; if along all of it, it is a first one of Newton's method.

        Along a path the tangent near the end of the step is to tell whether it is stable, and is
        not that of the start.
        """
        self._go(start, way, 1.0)
        if self._ends_at_target and not self._iterate.parameter.moves:
            free = way.u.copy()
            free[self._loading.owned_prescribed] = 0
            forces = self._loading.balance(self._system.product(free))
            self._balanced = global_norm(self._comm, forces)

    def _go(self, start: Direction, way: Direction, length: float) -> None:
        """Move along a direction, as far as the damage work allows."""
        self._ends_at_target &= self._iterate.go(start, way, length) == length

    # Corrections

    def _correct(self, forces: Array) -> Direction:
        """Correction for a residual of -forces that ends at a limit; collective."""
        iterate, limits, parameter = self._iterate, self._iterate.limits, self._iterate.parameter
        now, away, self._ends_at_target = iterate.reach(), self._loading.away(self._problem.t), True
        iterate.note_branches()
        left = limits.target - now.t if parameter.moves else 0.0
        alone = limits.by_load_alone or not parameter.moves
        self._rate = rate = parameter.rate(iterate.moved()) if left or not alone else None
        self._system.drag = max(parameter.drag, self._numbers.small * self._step.scales.held)
        if alone:
            if left:
                forces, away = forces + left * rate.forces, away + left * rate.supports
            return Direction(self._system.solve([forces], [away], self._rtol)[0], left)
        found = self._system.solve([forces, rate.forces], [away, rate.supports], self._rtol)
        zero, one = Direction(found[0], 0.0), Direction(found[1], 1.0)
        size = global_norm(self._comm, one.u)
        if not np.isfinite(global_norm(self._comm, zero.u) + size):
            return Direction(np.full_like(zero.u, np.nan), 0.0)
        if iterate.along is None and size > 0:
            iterate.along = one.u * limits.toward / size
            now = iterate.reach()
        rates = [iterate.rates(zero), iterate.rates(one, rate.work)]
        self._slope = rates[1].work
        change, self._ends_at_target = limits.change(now, *rates)
        if not self._ends_at_target and iterate.sound.elastic and self._slope:
            iterate.limits = limits.ending_at_onset()
            change, self._ends_at_target = iterate.limits.change(now, *rates)
        change = max(change, parameter.least - now.t)
        if self._norms and self._norms[-1] > 0:
            # It changes little from one correction to the next.
            self._system.multiplier = abs(change) / self._norms[-1]
        return zero.plus(one, change)

    # Called by PETSc, see :class:`.Equations`

    def residual(self, x: Array) -> Array:
        """R on free dofs; the entry of lambda is zero."""
        place = unpacked(x)
        farthest = global_max(self._comm, float(np.abs(place.u).max(initial=0.0)))
        if not self._numbers.small * farthest <= self._size:
            return np.full_like(x, np.nan)
        self._iterate.map(place)
        self._problem.discretization.assemble_residual(None, False, self._loading.vector)
        return np.append(self._iterate.forces(), 0.0)

    def correction(self, residual: Array) -> Array:
        return -packed(self._correct(-residual[:-1]))

    def longest(self, start: Array, way: Array) -> tuple[float, bool]:
        """No more than what would exceed the damage work of the step by far; a search where the
        load does not change."""
        direction = unpacked(way)
        length = self._iterate.allowed(unpacked(start), direction, 1.0)
        self._ends_at_target &= length == 1.0
        return length, direction.t == 0

    def test(self, norm: float) -> int:
        reaction = self._iterate.reaction()
        self._norms.append(norm)
        if not np.isfinite(norm + reaction):
            return SNES_REASONS["DIVERGED_FNORM_NAN"]
        self._goal = goal = self._goal_of(self._step.scales.with_forces(reaction=reaction))
        reason = verdict(self._norms, goal, norm > goal or self._met(), self._options)
        if reason != PETSc.SNES.ConvergedReason.ITERATING:
            return reason
        self._rtol = linear_tolerance(self._norms, goal)
        # Reusing the last tangent multiplies the residual by about twice the ratio of the last two,
        # since convergence is quadratic; it is reused if that ends far below the goal, and if the
        # tangent is that of the branches that points are on now.
        first = self._norms[-2] if len(self._norms) > 1 else self._balanced
        surely = self._numbers.missed * goal
        lags = goal < norm and 2 * norm * norm <= surely * first
        self._system.lags = lags and not self._iterate.branched(self._numbers.missed)
        return reason

    def _goal_of(self, scales: RunScales) -> float:
        """Norm of the residual on the free dofs at which the step has converged [N].

        It is small against the largest force the run has seen (reactions, loads, or the imbalance a
        step starts with), a scale that remains when the body has separated. The imbalance of a step
        that loads a weak bond far beyond its strength may exceed any force that it can carry by
        orders of magnitude, so the residual must also be small relative to actual forces. It cannot
        fall below rounding.
        """
        floor = rounding_of_forces(self._problem, self._size, self._system.norm)
        goal = self._options.relative_tolerance * scales.force
        return max(min(goal, self._numbers.small * scales.reaction), floor)

    def _met(self) -> bool:
        limits, now, missed = self._iterate.limits, self._iterate.reach(), self._numbers.missed
        if not self._iterate.parameter.moves or limits.target == limits.start:
            return True
        if limits.at_onset and not self._ends_at_target:
            return now.work <= limits.onset
        if (now.t - limits.target) * limits.toward > 0 or now.work > (1 + missed) * limits.work:
            return False
        there = (
            now.work >= (1 - missed) * limits.work
            or now.arc_length >= (1 - missed) * limits.arc_length
        )
        return there or now.t == limits.target
