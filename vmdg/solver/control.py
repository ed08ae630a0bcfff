"""How far a step goes: to a load factor, or until it has done so much damage work.

Load control is the wrong parameter once bonds break: every point that breaks is a small limit
point. The damage work D only grows along an equilibrium path, so it passes limit points, snap-backs
and separations as ordinary steps (Gutierrez 2004; Verhoosel, Remmers and Gutierrez 2009). A step
ends at the first of two events,

    lambda = target    or    D(u) - D_n = dD.

In the iteration D is not linearised: along du_0 + alpha du_1 the return maps at the points give it
exactly, also where points change branch, for any law and before anything is damaged (Lorentz and
Badel 2004). What this costs is a fraction of a residual.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from ..problem.problem import Problem

#: Share of dD by which a step may miss it, and by which a correction may.
MISSED, AIMED = 0.1, 0.01

#: Share of a stage at which the change of D is probed.
PROBE = 1e-3

#: How often the last step an extrapolation may be, and how often a bracket is doubled.
MAX_REACH, MAX_DOUBLINGS = 4.0, 12

NEAR = 1e-6
#: Rounding of load factors relative to the stage.
ROUNDING = 1e-11


class Direction(NamedTuple):
    """Displacement of owned dofs and load factor, or a change of both."""

    u: NDArray[np.float64]
    t: float


class Trials(Protocol):
    """States along a direction, see :class:`vmdg.solver.newton.Newton`."""

    def place(self) -> Direction:
        """Displacement and load factor now."""

    def go(self, start: Direction, direction: Direction, length: float) -> None:
        """Change displacement and load factor."""

    def damage_work(self, start: Direction, direction: Direction, length: float) -> float:
        """Damage work of the step if it ended there [N mm]."""


@dataclass
class Control:
    """Where a step ends: at a load factor, or where it has done so much damage work.

    Attributes:
        target: Load factor; with ``work`` the one the path leads to, for the first guess.
        work: Damage work dD at which the step ends, wherever lambda is then [N mm]; None for load
            control.
        span: Load factors of the present stage, the scale of changes.
    """

    target: float
    work: float | None = None
    span: float = 1.0

    def snapped(self, t: float) -> float:
        """The target where a load factor is as near to it as rounding."""
        return self.target if abs(t - self.target) <= ROUNDING * self.span else t

    def met(self, problem: Problem) -> bool:
        """Whether the equilibrium of the last residual ends the step; collective."""
        if self.work is None:
            return problem.t == self.target
        return abs(problem.step.damage_work() - self.work) <= MISSED * self.work

    def length(self, trials: Trials, start: Direction, zero: Direction, direction: Direction) -> float:
        """Change of the load factor with which a correction ends the step; collective.

        Args:
            trials: Gives D.
            start: u and lambda.
            zero: du_0.
            direction: du_1, for a unit of lambda.
        """
        left = self.target - start.t
        if self.work is None:
            return left
        D = trials.damage_work(start, zero, 0.0)

        def slope(d: Direction) -> float:
            size = trials.size(d)
            if size == 0:
                return 0.0
            return (trials.damage_work(start, d, 1e-7 / size) - D) / (1e-7 / size)

        slopes = slope(zero), slope(direction)
        if slopes[1] != 0:
            return (self.work - D - slopes[0]) / slopes[1]
        # Nothing is damaged yet.
        middle = Direction(start.u + zero.u, start.t)
        return self._reach(trials, middle, direction, left if left else self.span)

    def _reach(self, trials: Trials, start: Direction, direction: Direction, end: float) -> float:
        def excess(length: float) -> float:
            return trials.damage_work(start, direction, length) - self.work

        if (now := excess(0.0)) >= 0:
            return 0.0
        if excess(end) <= 0:
            return end
        return brentq(
            lambda x: now if x == 0.0 else excess(x), 0.0, end, xtol=AIMED * abs(end) / 4
        )

    def extrapolate(self, trials: Trials, ahead: Direction) -> bool:
        """Go on as in the last step until the control is met; collective.

        Returns:
            False, and nothing has changed, where this is too far.
        """
        start = trials.place()
        if self.work is not None:
            trials.go(start, ahead, self._reach(trials, start, ahead, MAX_REACH))
            return True
        left = self.target - start.t
        if not 0 < left * ahead.t or left / ahead.t > MAX_REACH:
            return False
        trials.go(start, ahead, left / ahead.t)
        return True


@dataclass
class Arrival(Control):
    """A step that ends at the target and gets there by damage work.

    Where points break one by one load control near the target has no equilibrium nearby more often
    than not. So dD is what the iteration looks for, by the secant method: the path lambda(D) is
    continuous.
    """

    before: tuple[float, float] = (0.0, 0.0)
    beyond: tuple[float, float] | None = None
    limit: float = math.inf

    def met(self, problem: Problem) -> bool:
        """Whether the equilibrium of the last residual ends the step; else dD is another one."""
        if self.work is None:
            return problem.t == self.target
        here = problem.step.damage_work(), problem.t
        left = self.target - here[1]
        if abs(left) <= NEAR * self.span:
            self.work = None
            return problem.t == self.target
        sense = math.copysign(1.0, self.span_sense)
        if left * sense > 0:
            last = self.before
            self.before = here
        else:
            last = self.before
            self.beyond = here
        if self.beyond is not None:
            (D0, t0), (D1, t1) = self.before, self.beyond
            self.work = D0 + (D1 - D0) * min(max((self.target - t0) / (t1 - t0), 0.05), 0.95)
        else:
            (D0, t0), (D1, t1) = last, here
            slope = (t1 - t0) / (D1 - D0)
            more = left / slope if slope * sense > 0 else D1
            self.work = D1 + min(more, D1)
        if self.work > self.limit:
            self.given_up = True
        return False

    span_sense: float = 1.0
    given_up: bool = False
