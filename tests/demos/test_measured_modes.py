"""All parameters of a mixed-mode law from three noisy curves, at a coarse size."""

from __future__ import annotations

import numpy as np


def test_measured_modes(comm, out):
    """The truth lies within three standard errors, energies are certain, the picture is drawn."""
    import measured_modes as demo

    found = demo.main(noise=0.005, points=6, facet=2.0, out=str(out))
    assert found.converged
    errors = found.relative_errors
    for name, value in demo.TRUTH.items():
        assert abs(np.log(found.estimate[name] / value)) < 3 * errors[name], name
    assert errors["bond.normal_energy"] < 0.05
    if comm.rank == 0:
        assert (out / "measured_modes.png").stat().st_size > 10_000
