"""A striker on a laminate, at a coarse size."""

from __future__ import annotations

import impact
import numpy as np
import pytest


def test_example(comm, out):
    """A fast striker parts the plies and is slowed down, a slow one leaves them whole; the energies
    add up to that of the striker."""
    mass = impact.DENSITY["striker"] * impact.WIDTH * impact.HEIGHT
    for speed in (2e4, 2e3):
        history = impact.main(size=1.0, speed=speed, end=6e-5, out=str(out))
        start = mass * speed**2 / 2
        assert history["external"] == pytest.approx(np.full(30, start), rel=1e-9)
        assert np.abs(history["imbalance"]).max() < 0.01 * start
        assert -speed < history["striker"][-1] < 0
        assert (history["debonded"][-1] > 0.1) == (history["damage"][-1] > 0.1 * start)
        assert (history["debonded"][-1] > 0.1) == (speed == 2e4)
        if comm.rank == 0:
            assert (out / "impact.gif").stat().st_size > 1e4
