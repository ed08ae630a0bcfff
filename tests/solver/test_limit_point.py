"""The largest load along a path, between two of its states."""

from __future__ import annotations

import math

import numpy as np
import pytest

import vmdg
from vmdg.solver.limit_point import PathPoint, highest, meeting

#: States that may be asked for.
MOST = vmdg.PathOptions().halvings


class Curve:
    """A load over the work, from its values at some works with straight lines in between."""

    def __init__(self, works, heights):
        self.works, self.heights, self.asked = np.array(works), np.array(heights), 0

    def at(self, work: float) -> PathPoint:
        piece = np.searchsorted(self.works, work, side="right") - 1
        piece = min(piece, len(self.works) - 2)
        slope = np.diff(self.heights)[piece] / np.diff(self.works)[piece]
        height = self.heights[piece] + slope * (work - self.works[piece])
        return PathPoint(work, height, slope)

    def reach(self, left: PathPoint, right: PathPoint, work: float) -> PathPoint:
        assert left.work < work < right.work
        self.asked += 1
        return self.at(work)


def test_tangents_meet():
    """At a kink itself; above the top of a concave function; else in the middle."""
    rising, falling = PathPoint(0.3, 0.6, 2.0), PathPoint(0.9, 0.55, -0.5)
    assert meeting(rising, falling, 0.0) == pytest.approx((0.4, 0.8), rel=1e-12)
    left, right = (PathPoint(x, -((x - 0.4) ** 2), 2 * (0.4 - x)) for x in (0.1, 0.8))
    work, height = meeting(left, right, 0.0)
    assert 0.1 < work < 0.8
    assert height > 0
    for other in (PathPoint(0.9, 0.2, -0.5), PathPoint(0.9, 0.55, math.nan)):
        assert meeting(rising, other, 0.0) == (pytest.approx(0.6), math.inf)


def test_kink():
    """Two states: that of the kink, and none where both ends are known to lie next to it."""
    curve = Curve([0.0, 0.4, 1.2], [0.0, 0.8, 0.4])
    found = highest(curve.at(0.3), curve.at(0.9), curve.reach, 1e-9, MOST)
    assert (found.work, found.height) == pytest.approx((0.4, 0.8), rel=1e-12)
    assert curve.asked == 1
    assert highest(curve.at(0.4 - 1e-12), curve.at(0.9), curve.reach, 1e-9, MOST).work < 0.4
    assert highest(curve.at(0.3), curve.at(0.4), curve.reach, 1e-9, MOST).work == 0.4
    assert curve.asked == 1


def test_smooth_top():
    """Tangents of a parabola meet in the middle: each state brings the bound to a quarter."""
    asked = []

    def at(work: float) -> PathPoint:
        asked.append(work)
        return PathPoint(work, -((work - 0.4) ** 2), 2 * (0.4 - work))

    left, right = at(0.1), at(0.8)
    found = highest(left, right, lambda left, right, work: at(work), 1e-6, MOST)
    assert found.height == pytest.approx(0.0, abs=1e-6)
    assert len(asked) - 2 <= MOST


def test_path_with_teeth():
    """A maximum next to which the load is lower, though it falls and rises on the way there.

    Chords do not tell where that is: those of a push-out in space were concave on one rank and not
    on two, by rounding, and only two found the limit point.
    """
    works = [0.0, 1.0, 1.2, 3.0, 3.1, 4.0, 8.0]
    heights = [0.0, 1.0, 0.6, 2.4, 2.3, 2.9, 1.0]
    curve = Curve(works, heights)
    found = highest(curve.at(0.5), curve.at(7.0), curve.reach, 1e-6, MOST)
    tops = [(1.0, 1.0), (3.0, 2.4), (4.0, 2.9)]
    nearest = min(tops, key=lambda top: abs(found.work - top[0]))
    assert found.height == pytest.approx(nearest[1], rel=1e-9)
    assert curve.asked <= MOST


def test_state_that_is_not_reached():
    """The largest load of those that were."""
    curve = Curve([0.0, 0.4, 1.2], [0.0, 0.8, 0.4])
    found = highest(curve.at(0.3), curve.at(0.9), lambda *_: None, 1e-9, MOST)
    assert found == curve.at(0.3)
