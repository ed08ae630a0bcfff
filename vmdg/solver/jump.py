"""Jump over a snap: from a limit point to the next equilibrium at its load."""

from __future__ import annotations

import math

from ..problem.states import Snapshot
from .attempt import Attempt
from .limits import Direction, Jump, Limits
from .steps import Steps


def jump(
    steps: Steps, t: float, most: float, limit: Snapshot, start: Snapshot
) -> tuple[Attempt, int]:
    """Move the problem to the next equilibrium at a load factor.

    Bonds are slowed down by an overstress of s H per gap increment, as in pseudo-transient
    continuation (Kelley and Keyes 1998), and steps follow them as they break. Each step ends at a
    given damage work, with the overstress that this requires, or at half of the last overstress,
    and finally at s = 0, the equilibrium. So s has the role that the load factor has on a path. If
    steps fail despite the overstress, or bonds hardly break, it is bodies that move, as in
    buckling. A drag acts on them as well,

        R(u) + s c |K| (u - u_n) = 0,

    the steepest descent of the energy by backward Euler: K + s c |K| I is positive definite for
    sufficiently large s. It ends in a stable state.

    Args:
        limit: The last state of the stable path. What is released relative to it replaces the work
            of the overstress.

    Returns:
        The last attempt and the number of attempts. If it fails the problem is in the state at the
        limit.
    """
    step, ledger = steps.problem.step, steps.problem.step.ledger
    step.return_to(limit)
    before = ledger.energy()
    step.return_to(start)
    found, count = _moved(steps, t, most)
    if not found.converged:
        step.return_to(limit)
        return found, count
    ledger.keep_loads_constant(limit)
    # Not negative.
    after = ledger.energy()
    charged = after.viscosity - before.viscosity
    ledger.release(max(after.imbalance - before.imbalance, -charged))
    return found, count


def _moved(steps: Steps, t: float, most: float) -> tuple[Attempt, int]:
    step, numbers, cuts_allowed = steps.problem.step, steps.options.path, steps.options.max_cuts
    small = steps.problem.discretization.bodies.linear
    found, last, by, count, cuts, idle = Attempt(converged=False), None, Jump(t), 0, 0, 0
    s, lowest, work, least = numbers.overstress, math.inf, most, numbers.small * most
    while cuts <= cuts_allowed and idle <= numbers.idle:
        target = s / numbers.growth if s > (numbers.small if by.drag else numbers.rest) else 0.0
        allowed, span = math.inf if by.drag else work, numbers.overstress / numbers.small
        before = step.snapshot()
        found = steps.attempt(Limits(s, target, span, work=allowed, jump=by), last)
        count += 1
        if not found.converged or (by.drag and found.unstable):
            step.return_to(before)
            cuts, last = cuts + 1, None
            s, work = s / numbers.cut, max(numbers.cut * work, least)
            bodies = found.guessed.work <= least or s * numbers.drag > 1
            if bodies and not (small or by.drag):
                s, cuts, by = numbers.overstress, 0, Jump(t, numbers.drag)
            continue
        if found.end == 0.0:
            return found, count
        cuts, idle = 0, idle + 1 if found.work <= least and found.end >= lowest else 0
        s, lowest = found.end, min(found.end, lowest)
        work = min(max(numbers.growth_after(found.iterations) * work, least), most)
        last = found.going(Direction(found.ahead.u, 0.0))
    return found.failed(f"JUMP_FAILED after {count} steps"), count
