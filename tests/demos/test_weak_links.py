"""Bars that break one after the other: what jumps and what is traced, by order statistics."""

from __future__ import annotations

import numpy as np
import pytest


def test_weak_links(comm, out):
    """Both ways meet the closed form where the path passes a load factor for the first time.

    What a machine releases at a snap is the elastic energy of the bar, S^2 L/E of it, less that of
    its bond.
    """
    import weak_links as demo

    histories = demo.main(bars=3, critical_gap=0.006, steps=20, seed=3, out=str(out))
    comm.barrier()
    strengths = np.sort(np.random.default_rng(3).uniform(4.0, 10.0, 3))
    for history in histories.values():
        load = history["load"].tolist()
        for t in np.linspace(0, 1, 21)[1:]:
            exact = demo.order_statistics(strengths, 10 * t)
            assert history["force"][load.index(t)] == pytest.approx(exact, abs=1e-6)
        limits = [10 * t for t in load if abs(10 * t - strengths).min() < 1e-5]
        assert len({round(limit, 4) for limit in limits}) == 3
        assert history["damage"][-1] == pytest.approx(0.05 * 0.003 * strengths.sum(), rel=1e-6)
    traced, jumped = histories["trace"], histories["jump"]
    released = 0.05 * (strengths**2 / 1000 - 0.003 * strengths)
    assert jumped["viscosity"][-1] == pytest.approx(released.sum(), rel=1e-5)
    assert traced["viscosity"][-1] == 0
    assert (jumped["jump_steps"] > 0).sum() == 3
    assert (np.diff(traced["load"]) < 0).sum() > 3
    if comm.rank == 0:
        assert (out / "weak_links.png").stat().st_size > 10_000
