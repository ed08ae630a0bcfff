"""How far to go along a Newton correction of the condensed equations.

The searches of :mod:`vmdg.solver.newton`, which PETSc does there: backtracking on the residual
norm, full steps, and the least energy. All return the state found.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .gap_equation import Direction, GapEquation, Gaps
from .iteration import HALVINGS

LineSearch = Callable[[GapEquation, Gaps, Direction], Gaps]

#: Share of the reduction of |R|^2/2 by the linear model that backtracking must meet.
SUFFICIENT = 1e-4

#: Trials of the search for the least energy, share of the work at the start to which it reduces it,
#: and the shortest and longest step of that search.
TRIALS, REST, SHORTEST, LONGEST = 8, 0.1, 1e-12, 1e8


def backtrack(equation: GapEquation, start: Gaps, direction: Direction) -> Gaps:
    """Halve the step until |R|^2 falls by Armijo's rule; the last trial is taken anyway."""
    length = 1.0
    for _ in range(HALVINGS + 1):
        state = equation.along(start, direction, length)
        # Also with NaN the step is halved.
        if state.norm**2 <= start.norm**2 * (1 - 2 * SUFFICIENT * length):
            break
        length /= 2
    return state


def full_step(equation: GapEquation, start: Gaps, direction: Direction) -> Gaps:
    """The whole correction."""
    return equation.along(start, direction, 1.0)


def least_energy(equation: GapEquation, start: Gaps, direction: Direction) -> Gaps:
    """Where the residual does no work along the correction, by the secant method.

    Where the slope has the sign of a maximum of the energy it is taken with the other sign, as in
    PETSc's search for critical points.
    """
    before, after = 0.0, 1.0
    first = former = -equation.work(start, direction)
    for _ in range(TRIALS):
        state = equation.along(start, direction, after)
        now = -equation.work(state, direction)
        if abs(now) < REST * abs(first) or abs(after - before) < SHORTEST * after:
            return state
        slope = -abs((now - former) / (after - before))
        change = now / slope if slope != 0 else np.nan
        following = after - change
        if following < SHORTEST:
            following = after + change
        if not np.isfinite(following) or following > LONGEST:
            return state
        before, after, former = after, following, now
    return equation.along(start, direction, after)
