"""Where the load along a path is largest, by tangents."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from ..problem.states import Snapshot


class PathPoint(NamedTuple):
    """A state near a limit point.

    Attributes:
        work: On bonds, since any state [N mm].
        height: Load factor, forward, since any state.
        slope: Of the height over the work; NaN where it is not known.
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
    """The point of largest load found between two, of all that were asked for.

    At the left one the load rises with the work, and at the right one it is lower or falls; so it
    stays while they come closer, and a maximum lies in between, however the path goes up and down.

    Args:
        left, right: The points.
        reach: Goes from a left point towards a right one up to a work; None where it fails.
        small: Height by which no more can be gained to go on.
        most: States that are asked for.
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
    """Where the largest load between two points is looked for, and how large it may be there.

    Where their tangents meet: at a kink that is the limit point, and above it where the load is a
    concave function of the work. Where they do not meet in between, but for a small height, the
    middle.
    """
    width, rise = right.work - left.work, right.height - left.height
    meets = left.slope * width > rise - small and right.slope * width < rise + small
    if meets and left.slope > right.slope:
        x = (rise - right.slope * width) / (left.slope - right.slope)
        x = min(max(x, 0.0), width)
        return left.work + x, left.height + left.slope * x
    return left.work + width / 2, math.inf
