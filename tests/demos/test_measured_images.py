"""Strength, gap and modulus from a force and images."""

from __future__ import annotations

import numpy as np


def test_measured_images(comm, out):
    """The truth lies within three standard errors, which the images make smaller."""
    import measured_images as demo

    found = demo.main(out=str(out))
    alone, both = (found[name].relative_errors for name in ("force", "force and images"))
    for name, value in demo.TRUTH.items():
        estimate = found["force and images"].estimate[name]
        assert abs(np.log(estimate / value)) < 3 * both[name]
    assert both["bond.strength"] < 0.3 * alone["bond.strength"]
    if comm.rank == 0:
        assert (out / "measured_images.png").stat().st_size > 10_000
