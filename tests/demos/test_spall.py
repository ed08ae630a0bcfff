"""A layer that is torn off by a wave, at a coarse size."""

from __future__ import annotations

import numpy as np
import pytest
import spall


def test_example(comm, out):
    """The free face takes the speed of the flyer; a bond that holds stops it again, one that fails
    leaves the pull-back 2 P_c/(rho c) and lets the layer fly."""
    speed, strength = 1e5, 300.0
    found = spall.main(cells=10, speed=speed, strength=strength, out=str(out))
    holds, fails = (history["face"] for history in found.values())
    time = found["bond that fails"]["time"] * spall.C / (spall.FLYER + spall.PLATE)
    pushed, later = (time > 0.82) & (time < 1.15), time > 1.35
    assert holds[pushed].mean() == pytest.approx(speed, rel=0.03)
    assert abs(holds[later].mean()) < 0.05 * speed
    pull_back = 2 * strength / (spall.RHO * spall.C)
    # Waves disperse on a coarse mesh.
    assert fails[(time > 1.2) & (time < 1.35)].min() == pytest.approx(speed - pull_back, rel=0.2)
    assert fails[later].mean() == pytest.approx(speed, rel=0.1)
    ends = found["bond that fails"]
    assert ends["damage"][-1] > 0 and ends["opening"][-1] > 0.01
    kinetic = found["bond that holds"]["kinetic"][0]
    assert np.abs(ends["imbalance"]).max() < 0.02 * kinetic
