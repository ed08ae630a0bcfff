"""Carries a problem over a real snap: from a limit point to the next equilibrium at its load."""

from __future__ import annotations

import math

from .attempt import Attempt, Guess
from .limits import Limits
from .steps import Steps


def jump(steps: Steps, t: float, span: float) -> tuple[Attempt, int]:
    """Carry the problem to the next equilibrium at a load factor.

    Steps at this load follow the bonds as they break, slowed down by an overstress eta = factor H
    per gap increment, as in pseudo-transient continuation (Kelley and Keyes 1998): it falls after a
    step that took few corrections and grows after one that has failed. Where next to nothing is
    spent any more, or it is next to nothing, a step without it ends at an equilibrium of the law as
    it is. Where steps fail although bonds are as good as held it is bodies that move, as in
    buckling. A drag slows them down in proportion to the overstress,

        R(u) + c (u - u_n) = 0,

    the steepest descent of the energy in time by backward Euler: K + c I is positive definite for a
    c that is large enough.

    Args:
        steps: Takes the attempts; the problem is in a state from which it runs away at this load.
        t: Load factor.
        span: Of the stage.

    Returns:
        The last attempt and the number of steps with overstress. If it fails the problem is back
        where it was.
    """
    step, numbers = steps.problem.step, steps.options.path
    before, small = step.snapshot(), steps.problem.discretization.bodies.small
    overstress, done, count, idle, moves, rest = numbers.overstress, 0.0, 0, 0, False, math.inf
    found, guess = Attempt(False, [], ""), Guess()
    while idle <= numbers.idle and overstress < numbers.held**2:
        start, drag = step.snapshot(), overstress / numbers.held if moves else 0.0
        found = steps.attempt(Limits(start.t, t, span), guess, overstress, drag)
        count += 1
        if not found.converged or (moves and found.unstable):
            step.return_to(start)
            overstress, guess, idle = overstress / numbers.cut, Guess(), idle + 1
            if overstress > numbers.held and not (moves or small):
                moves, overstress = True, numbers.overstress
            continue
        done += found.work
        spent = found.work <= numbers.rest * done
        idle = idle + 1 if spent else 0
        slow = numbers.rest / numbers.held if moves else numbers.rest
        if overstress <= rest and (overstress < slow or (spent and not moves)):
            end = steps.attempt(Limits(t, t, span), Guess())
            if end.converged:
                return end, count
            # Not at rest yet: again with half of the overstress.
            rest = overstress / 2
        guess = Guess(found.change if start.t == t else None)
        overstress /= numbers.growth if found.iterations <= 2 * numbers.aim else 1.0
    step.return_to(before)
    return found.failed(f"JUMP_FAILED after {count} steps"), count
