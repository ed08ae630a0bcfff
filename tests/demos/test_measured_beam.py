"""Strength and energy from a noisy curve, at a coarse size."""

from __future__ import annotations

import numpy as np


def test_measured_beam(comm, out):
    """The truth lies within three standard errors, and the picture is drawn."""
    import measured_beam as demo

    found = demo.main(noise=0.002, points=10, out=str(out))
    assert found.converged
    for name, value in demo.TRUTH.items():
        error = found.relative_errors[name]
        assert abs(np.log(found.estimate[name] / value)) < 3 * error < 0.1
    if comm.rank == 0:
        assert (out / "measured_beam.png").stat().st_size > 10_000
