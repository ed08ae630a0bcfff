"""Where a correction ends: at the piece of the constraint that is met first."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmdg.solver.limits import Limits, Reach

RATES = st.floats(-10, 10).filter(lambda rate: abs(rate) > 1e-3)
TARGETS = st.floats(-5, 5).filter(lambda target: abs(target) > 1e-3)


@given(target=TARGETS, work=st.floats(0.1, 9), rate=RATES, done=st.floats(0, 1))
def test_a_correction_ends_at_its_limit(target, work, rate, done):
    """The work is at its limit afterwards, or the load factor at the target, whichever is first.

    Forward is where the work grows, even if that leads away from the target.
    """
    limits = Limits(0.0, target, abs(target), work=work)
    now, zero, one = Reach(0.1 * target, done * work), Reach(work=0.01), Reach(1.0, rate)
    change, at_target = limits.change(now, zero, one)
    left = target - now.t
    spent = now.work + zero.work + change * rate
    if at_target:
        assert change == left
        assert rate * left > 0 and spent <= work * (1 + 1e-9)
    else:
        assert abs(change) <= limits.span
        assert abs(change) == pytest.approx(limits.span) or spent == pytest.approx(work)
        assert rate * left < 0 or now.work + zero.work + left * rate >= work


def test_the_way_limits_where_nothing_breaks():
    """As the work does, forward along the tangent; without either the target is next."""
    now, zero, one = Reach(1.0, 0.0, 0.2), Reach(way=0.1), Reach(1.0, 0.0, -4.0)
    limits = Limits(0.0, 3.0, 3.0, way=0.5)
    assert limits.change(now, zero, one) == (pytest.approx(-0.05), False)
    assert Limits(0.0, 3.0, 3.0, work=9.0).change(now, zero, one) == (2.0, True)
    assert Limits(0.0, 3.0, 3.0, way=50.0).change(now, zero, one._replace(way=4.0)) == (2.0, True)


def test_no_correction_exceeds_the_stage():
    """Where the work hardly grows its rate says nothing about how far it is to the limit."""
    limits = Limits(0.0, 2.0, 2.0, work=1.0)
    change, at_target = limits.change(Reach(0.5), Reach(), Reach(1.0, -1e-9))
    assert (change, at_target) == (-2.0, False)


def test_shorter_attempts():
    """By a share of what the last one would have done, within its limits; a work is never less
    than that of the onset."""
    limits = Limits(0.0, 1.0, 1.0, onset=1e-3)
    assert limits.by_load_alone
    shorter = limits.shortened(Reach(work=8.0), 0.25)
    assert (shorter.work, shorter.way, shorter.by_load_alone) == (2.0, math.inf, False)
    assert shorter.shortened(Reach(work=100.0), 0.25).work == 0.5
    assert shorter.shortened(Reach(work=1e-9), 0.25).work == 1e-3
    assert limits.shortened(Reach(way=2.0), 0.25).way == 0.5


def test_in_words():
    """What may end a step before its target."""
    assert str(Limits(0.0, 1.0, 1.0)) == "by load"
    assert str(Limits(0.0, 1.0, 1.0, work=0.25, way=0.5)) == "at most 0.25 N mm on bonds and 0.5 mm"
