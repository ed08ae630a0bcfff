"""Cracks that are unloaded, and loaded again: bonds with plastic gaps on a bent arm."""

from __future__ import annotations

import numpy as np
import pytest
from support.arms import bent_apart, opened

import vmdg


@pytest.mark.parametrize("kinematics", ("small", pytest.param("finite", marks=pytest.mark.long)))
def test_unloaded_crack(comm, kinematics):
    """In one step as in twenty: the tractions of the process zone vanish at once, and what takes
    over ahead of it breaks a little; nothing jumps."""
    law = vmdg.Debonding(strength=20.0, critical_gap=0.02)
    runs = []
    for back in ([0.3, 0.6], np.linspace(0.6, 0.3, 21)[1:]):
        problem, _ = bent_apart(comm, 18.0, (12, 8), law, kinematics=kinematics)
        result = vmdg.solve(problem, [0.6, *back], vmdg.SolveOptions(energy=True), opened)
        history = result.history
        assert not history["jump_steps"].any()
        assert np.diff(history["damage"]).min() >= 0
        assert abs(history["imbalance"]).max() < 1e-4 * history["external"].max()
        rows = [np.flatnonzero(history["load"] == t)[0] for t in (0.6, 0.3)]
        runs.append([history[column][rows] for column in ("damage", "force")])
        assert sum(t < 0.6 for t, _ in result.failures) <= 3
    (damage, force), (damage_finely, force_finely) = runs
    assert damage[0] < damage[1] < 1.01 * damage[0]
    # One step and many differ as paths of plastic gaps do.
    assert damage[1] == pytest.approx(damage_finely[1], rel=0.01)
    assert force[1] == pytest.approx(force_finely[1], rel=0.02)
