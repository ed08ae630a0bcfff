"""A fault that ruptures, at a coarse size."""

from __future__ import annotations

import fault
import numpy as np
import pytest


def test_example(comm, out):
    """Times of arrival and slip of PyLith at six places, as well as cells of 150 m give them; past
    the patch of high stress the rupture is faster than shear waves, and energies add up."""
    found = fault.main(size=150.0, out=str(out))
    arrivals, slip = fault.PYLITH
    assert found["arrivals"] == pytest.approx(arrivals, rel=0.06)
    assert found["slip"][-1] == pytest.approx(slip, rel=0.15)
    speed = 1e3 * 4.5 / (found["arrivals"][0] - found["arrivals"][1])
    assert fault.C_S < speed < fault.C_D
    names = ("imbalance", "friction", "external")
    imbalance, friction, external = (found["history"][name] for name in names)
    assert np.abs(imbalance - imbalance[0]).max() < 1e-4 * friction[-1]
    # What a patch that begins with more than it can carry loses in the first step.
    assert np.abs(imbalance[0]) < 1e-5 * external[0]
    if comm.rank == 0:
        assert (out / "fault.gif").stat().st_size > 1e4
