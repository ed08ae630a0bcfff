"""Strength and energy from a noisy curve, at a coarse size."""

from __future__ import annotations

import numpy as np
import pytest


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


# With facets of 1 mm the curve has teeth that the data, of finer ones, do not have: said so.
@pytest.mark.filterwarnings("ignore:identify. the model misses the data")
def test_study(comm, out):
    """vmdg.identify in the study; what counts as success."""
    import identification as study

    (search,) = study.main(points=8, facet=1.0, alone=True, out=str(out))
    assert search.success
    assert search.runs < 15
    if comm.rank == 0:
        assert "vmdg.identify" in (out / "identification.md").read_text()
    far = search._replace(logs=search.logs + 0.1)
    assert [one.success for one in study.judged([search, far], np.full(2, 0.1))] == [True, False]
    assert np.exp(search.logs) == pytest.approx(list(study.TRUTH.values()), rel=0.2)
