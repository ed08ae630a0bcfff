"""Curves over an abscissa that may turn back, and their derivatives."""

from __future__ import annotations

import numpy as np
import pytest

import vmdg

NAME = "bond.strength"


def history(x, y, dx=0.0, dy=0.0) -> vmdg.History:
    found = vmdg.History()
    for row in zip(x, y, *np.broadcast_arrays(dx, dy, x)[:2], strict=True):
        names = ("opening", "force", f"d opening/d {NAME}", f"d force/d {NAME}")
        found.append(dict(zip(names, map(float, row), strict=True)))
    return found


def curve(x) -> vmdg.Curve:
    return vmdg.Curve(x, np.zeros(len(x)), along="opening")


def test_a_machine_passes_a_snap_back():
    """Rising abscissae: the branch before the turn, then that behind it."""
    run = history([1.0, 2.0, 1.5, 3.0], [10.0, 20.0, 5.0, 8.0])
    y, *_ = curve([0.5, 1.9, 2.1]).of_run(run, [NAME])
    assert y == pytest.approx([5.0, 19.0, 5.0 + 0.6 / 1.5 * 3.0])


def test_a_measured_snap_back():
    """Falling abscissae: along the branch that turns back."""
    run = history([1.0, 2.0, 1.0, 3.0], [10.0, 20.0, 4.0, 8.0])
    y, *_ = curve([1.5, 1.9, 1.5, 1.1, 2.0]).of_run(run, [NAME])
    assert y == pytest.approx([15.0, 19.0, 12.0, 5.6, 6.0])


def test_not_reached():
    """What a run does not reach is compared with its end, which moves with the parameter."""
    run = history([1.0, 2.0], [10.0, 20.0], 1.0, 7.0)
    y, rates, reached = curve([3.0]).of_run(run, [NAME])
    assert (y[0], rates[0, 0], reached) == (20.0, 7.0, False)
    assert curve([2.0]).of_run(run, [NAME]).reached
    # A run that ends before it falls may not have passed its peak.
    assert not curve([np.inf]).of_run(run, [NAME]).reached


def test_derivatives():
    """At fixed abscissae, equal to differences of neighbouring curves."""
    x, y = np.array([1.0, 2.0, 1.0, 3.0]), np.array([10.0, 20.0, 4.0, 8.0])
    dx, dy = np.array([0.1, 0.3, -0.2, 0.4]), np.array([2.0, -1.0, 3.0, 0.5])
    places, h = curve([0.7, 1.5, 1.9, 1.5, 2.0]), 1e-7
    _, rates, _ = places.of_run(history(x, y, dx, dy), [NAME])
    ends = [places.of_run(history(x + s * dx, y + s * dy), [NAME])[0] for s in (h, -h)]
    assert rates[:, 0] == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=1e-6)


def test_units():
    """Columns with their units, which pictures then show, are the same columns."""
    found = []
    for names in ({"along": "load"}, {"along": "load [mm]", "column": "force [N]"}):
        run = vmdg.History()
        run.append(
            {"load": 1.0, "force [N]": 10.0, f"d load/d {NAME}": 0.5, f"d force/d {NAME}": 2}
        )
        found.append(vmdg.Curve([0.5, 1.0], [5.0, 9.0], **names).of_run(run, [NAME]))
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one, other)


def test_jump():
    """The row of a jump has the derivative of the next one."""
    run = history([1.0, 1.0, 2.0], [10.0, 4.0, 8.0], [0.0, np.nan, 0.0], [1.0, np.nan, 3.0])
    y, rates, _ = curve([1.0, 1.5]).of_run(run, [NAME])
    assert y == pytest.approx([10.0, 6.0])
    assert rates[:, 0] == pytest.approx([1.0, 3.0])


def test_peak():
    """An infinite abscissa has the largest value of all, wherever that is."""
    run = history([1.0, 2.0, 3.0], [10.0, 25.0, 8.0], 0.0, [1.0, 2.0, 3.0])
    y, rates, _ = curve([np.inf, 1.0, 3.0]).of_run(run, [NAME])
    assert y == pytest.approx([25.0, 10.0, 8.0])
    assert rates[:, 0] == pytest.approx([2.0, 1.0, 3.0])


@pytest.mark.parametrize(
    ("x", "y", "options", "message"),
    [
        ([1.0, 2.0], [1.0], {}, "2 abscissae and 1 values"),
        ([np.nan], [1.0], {}, "x must be an array of finite numbers"),
        ([1.0], [1.0], {"sigma": 0.0}, "sigma must be positive"),
    ],
)
def test_refusals(x, y, options, message):
    """What is no curve."""
    with pytest.raises(ValueError, match=message):
        vmdg.Curve(x, y, **options)
