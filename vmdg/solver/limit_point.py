"""Search for the largest load along a path, by tangents."""

from __future__ import annotations

import math
from typing import NamedTuple

from ..problem.states import Snapshot
from .attempt import Attempt
from .limits import Direction, Limits
from .steps import Steps

#: A state next to the limit, and the step between them.
Neighbour = tuple[Snapshot, Attempt]


class PathPoint(NamedTuple):
    """A state near a limit point."""

    work: float  # Damage work, relative to some state [N mm]
    height: float  # Load factor in the direction of loading, relative to some state
    slope: float  # Derivative of the height by the work; NaN if unknown
    state: Snapshot
    found: Attempt | None


def limit_point(
    steps: Steps, last: Neighbour | None, limit: Snapshot, beyond: Neighbour, way: float
) -> tuple[Snapshot, Attempt | None]:
    """The evaluated state of largest load around the last state before the load falls, and the step
    that ended there; None where it is not beyond that state, whose damage it would undo.

    At the left of two points the load increases with the work, at the right one it is lower or
    decreases. This remains true while they approach, so a maximum lies in between, however the path
    oscillates.

    Args:
        last: The state before the limit; None where there is none.
    """
    step, numbers, sense = steps.problem.step, steps.options.path, math.copysign(1.0, way)
    small = numbers.small * abs(way)

    def point(work: float, state: Snapshot, found: Attempt | None) -> PathPoint:
        slope = sense / found.slope if found and found.slope else math.nan
        return PathPoint(work, sense * (state.t - limit.t), slope, state, found)

    left, right = point(0.0, limit, last and last[1]), point(beyond[1].work, *beyond)
    if left.slope < 0 < last[1].work:
        left, right = point(-last[1].work, *last), left
    # If bodies rather than bonds cause the limit point, the damage work does not locate it.
    if not right.work > left.work:
        return limit, None
    best = max(left, right, key=lambda point: point.height)
    for _ in range(numbers.halvings):
        work, height = meeting(left, right, small)
        if height - best.height <= small:
            break
        # The state beyond is the predictor.
        ahead, start = left.state.change_to(right.state), left.state.t
        step.return_to(left.state)
        limits = Limits(start, start + way, abs(way), work=work - left.work)
        shown = Attempt(work=right.work - left.work, ahead=ahead and Direction(*ahead))
        attempt = steps.attempt(limits, shown)
        if not attempt.converged:
            break
        found = point(left.work + attempt.work, step.snapshot(), attempt)
        best = max(best, found, key=lambda point: point.height)
        if found.height > left.height and not found.slope < 0:
            left = found
        else:
            right = found
    return best.state, best.found if best.work > 0 else None


def meeting(left: PathPoint, right: PathPoint, small: float) -> tuple[float, float]:
    """Where to evaluate the load next between two points, and a bound for it there.

    At the intersection of their tangents: this is the limit point for a kink, and above it if the
    load is a concave function of the work. If they do not intersect in between, up to a small
    height, at the midpoint.
    """
    width, rise = right.work - left.work, right.height - left.height
    meets = left.slope * width > rise - small and right.slope * width < rise + small
    if meets and left.slope > right.slope:
        x = (rise - right.slope * width) / (left.slope - right.slope)
        x = min(max(x, 0.0), width)
        return left.work + x, left.height + left.slope * x
    return left.work + width / 2, math.inf
