"""Delamination buckling at a coarse size, with default options, beside the closed forms."""

from __future__ import annotations

import numpy as np


def test_buckling(comm, out):
    """The layer buckles where it is to, rises, and peels off where G = G_c.

    w^2 is linear in e behind the buckling strain, and meets zero there. The ends of the layer give
    way: clamped at the tips it would buckle later, clamped its own thickness behind them earlier.
    Of G = G_c the process zone, 2 mm long, and the long way of the roots are left out.
    """
    import buckling

    history = buckling.main(cells=2, end=0.007, steps=6, out=str(out))
    comm.barrier()
    load, rise, crack = history["load"], history["rise"], history["crack"]
    assert load[-1] == 0.007
    early = (rise > 0.1) & (rise < 0.5)
    assert early.sum() >= 2
    slope, start = np.polyfit(load[early], rise[early] ** 2, 1)
    buckles = -start / slope
    latest = buckling.critical(buckling.CRACK)
    earliest = buckling.critical(buckling.CRACK + buckling.LAYER)
    assert earliest < buckles < latest
    assert (rise[load < 0.9 * earliest] < 0.02).all()
    grows = crack > 0.5
    assert grows.sum() > 10
    assert crack[-1] > 3.0
    expected = np.array([buckling.growth(buckling.CRACK + a) for a in crack])
    assert np.abs(load[grows] / expected[grows] - 1).max() < 0.02
    assert (load[crack == 0] < 1.02 * expected[0]).all()
    assert np.abs(history["imbalance"]).max() < 1e-3 * history["external"][-1]
    assert not history["jump_steps"].any()
    assert (out / "buckling.png").stat().st_size > 10_000


def test_closed_forms():
    """G(e' = e_c) = 0, and the force is the same at the end and below the layer."""
    import buckling

    e_c = buckling.critical(buckling.CRACK)
    assert np.isclose(e_c, np.pi**2 / 3 * (0.5 / 20) ** 2)
    assert np.isclose(buckling.at_ends(e_c, buckling.CRACK), e_c)
    k, E = 4.0 / 4.5, buckling.E / (1 - buckling.NU**2)
    for crack in (10.0, 15.0):
        e_c = buckling.critical(crack)
        # at_ends is linear: back from e to e'.
        zero, one = (buckling.at_ends(e, crack) for e in (0.0, 1.0))
        below = (buckling.growth(crack) - zero) / (one - zero)
        G = E * 0.5 / 2 * (below - e_c) * (k * (below - e_c) + 4 * e_c)
        assert np.isclose(G, buckling.ENERGY)
