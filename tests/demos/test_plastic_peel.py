"""A ductile strip that is peeled off, at a coarse size."""

from __future__ import annotations

import plastic_peel
import pytest


def test_example(comm, out):
    """The bond takes its toughness whatever the strip does; a thick strip stays elastic and stores
    as much, a thin one flows and takes several times as much."""
    found = plastic_peel.main(thinnest=0.2, thickest=0.5, count=2, facet=0.34, out=str(out))
    thin, thick = found.values()
    for shares in found.values():
        assert shares["damage"] == pytest.approx(1.0, abs=0.05)
        balance = sum(shares[name] for name in plastic_peel.SHARES)
        assert shares["external"] == pytest.approx(balance, rel=0.02)
    assert thick["plastic"] < 1e-3
    assert thick["external"] == pytest.approx(2.0, rel=0.12)
    assert thin["plastic"] > 1.0
    comm.barrier()
    assert (out / "plastic_peel.png").exists()
