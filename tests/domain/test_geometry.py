"""The rigid part of a motion of points."""

from __future__ import annotations

import numpy as np
import pytest
from support.problems import rotation

from vmdg.domain.geometry import rigid_part


@pytest.mark.parametrize("d", [2, 3])
def test_rigid_part(comm, d):
    """Of points that turn and move with some noise; none where they do not tell the turn."""
    rng = np.random.default_rng(d + 10 * comm.rank)
    x, R = rng.normal(size=(5, d)), rotation(d, 2.0)
    y = x @ R.T + np.arange(d)
    found, before, after = rigid_part(comm, x, y)
    assert found == pytest.approx(R, abs=1e-12)
    assert (x - before) @ R.T + after == pytest.approx(y, abs=1e-12)
    mirrored = x * [-1.0, *[1.0] * (d - 1)]
    assert np.linalg.det(rigid_part(comm, x, mirrored)[0]) == pytest.approx(1.0)
    alike = np.ones((5, d))
    line = alike * np.arange(5)[:, None]
    assert rigid_part(comm, alike, alike) is None
    assert (rigid_part(comm, line, line) is None) == (d == 3)
    assert rigid_part(comm, x[:0], y[:0]) is None
