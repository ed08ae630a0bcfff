"""A crack that runs along an interface, at a coarse size."""

from __future__ import annotations

import crack_speed
import numpy as np
import pytest


def test_example(comm, out):
    """The crack starts at tau, is never faster than Rayleigh waves, and its speed is Freund's
    estimate 1 - tau/t to 0.06 c_R."""
    found = crack_speed.main(cells=60, out=str(out))
    share, tau = found["speed"] / crack_speed.C_R, found["tau"]
    times, runs = found["times"], found["times"] > 1.3 * found["tau"]
    assert share.max() < 0.9
    assert share[times < 0.8 * tau].max() < 0.1
    assert share[runs] == pytest.approx(1 - tau / times[runs], abs=0.06)
    assert share[-6:].mean() > share[runs][:6].mean() + 0.3
    assert found["length"][-1] == pytest.approx(found["freund"][-1], rel=0.1)
    assert np.all(np.diff(found["length"]) >= 0)
    if comm.rank == 0:
        assert (out / "crack_speed.gif").stat().st_size > 1e4
