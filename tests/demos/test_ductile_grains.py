"""Grains that part or flow, at a coarse size."""

from __future__ import annotations

import ductile_grains
import numpy as np
import pytest


def test_example(comm, out):
    """Elastic at first alike; elastic grains part, soft ones flow in plane strain and hold."""
    found = ductile_grains.main(grains=4, cells=2.0, end=0.006, steps=6, out=str(out))
    slope = ductile_grains.E / (1 - ductile_grains.NU**2)
    for history in found.values():
        assert history["stress"][0] == pytest.approx(slope * history["load"][0], rel=0.02)
    elastic, hard, soft = (found[name] for name in ductile_grains.YIELDS)
    assert elastic["plastic work"][-1] == 0.0
    assert elastic["stress"].max() > 0.9 * 300.0
    assert elastic["stress"][-1] < 0.05 * elastic["stress"].max()
    assert hard["plastic work"][-1] > 0.0
    assert soft["damage work"][-1] < 1e-3 * soft["plastic work"][-1]
    # Between the flow stresses of plane strain of the mean yield stress and with all scatter.
    flow = 2 / np.sqrt(3) * ductile_grains.YIELDS["soft"]
    assert soft["stress"][-1] == pytest.approx(flow, rel=0.2)
    assert soft["stress"][-1] < elastic["stress"].max()
