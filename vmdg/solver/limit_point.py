"""Search for the largest load along a path, by tangents."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from ..problem.states import Snapshot


class PathPoint(NamedTuple):
    """A state near a limit point.

    Attributes:
        work: Damage work, relative to some state [N mm].
        height: Load factor in the direction of loading, relative to some state.
        slope: Derivative of the height by the work; NaN if unknown.
        state: The state.
    """

    work: float
    height: float
    slope: float
    state: Snapshot | None = None


def highest(
    left: PathPoint,
    right: PathPoint,
    reach: Callable[[PathPoint, PathPoint, float], PathPoint | None],
    small: float,
    most: int,
) -> PathPoint:
    """The point of largest load evaluated between two points.

    At the left point the load increases with the work, at the right one it is lower or decreases.
    This remains true while they approach, so a maximum lies in between, however the path
    oscillates.

    Args:
        left, right: The points.
        reach: Moves from a left point towards a right one up to a work; None if it fails.
        small: Stop when the possible gain in height is below this.
        most: Largest number of evaluations.
    """
    best = max(left, right, key=lambda point: point.height)
    for _ in range(most):
        work, height = meeting(left, right, small)
        if height - best.height <= small:
            break
        found = reach(left, right, work)
        if found is None:
            break
        best = max(best, found, key=lambda point: point.height)
        if found.height > left.height and not found.slope < 0:
            left = found
        else:
            right = found
    return best


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
