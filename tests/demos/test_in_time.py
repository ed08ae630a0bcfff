"""The study of motion in time at a coarse size."""

from __future__ import annotations

from mpi4py import MPI

import in_time
import pytest
from in_time import DIVISIONS, OF_STEPS

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="measured on one rank")


@pytest.mark.long
def test_study(out):
    """Extrinsic elements jump and gain energy in large steps and converge in small ones, vmdg keeps
    it; interfaces that can fail leave nine tenths of the step of plain elements."""
    beats, rows = in_time.main(coarse=True, out=str(out))
    *others, mine = beats
    for beat in others:
        assert (beat.energy.max() > 1.1) == (beat.step > 0.2), beat
        assert beat.energy.max() < 1.01 or beat.step > 0.2, beat
    assert 0.7 < mine.step <= 0.8
    assert mine.energy.max() < 1.01
    half = len(mine.energy) // 2
    assert mine.energy[half:].max() < 1.0001 * mine.energy[:half].max()
    assert len(others) == 6 and len(rows) == 2 * len(DIVISIONS)
    for row in rows:
        share = {name: float(value) for name, value in zip(OF_STEPS[3:], row[3:], strict=True)}
        assert min(share[name] for name in OF_STEPS[5:]) >= 0.9, row
        assert share["debonding"] >= share["tied"], row
    assert (out / "in_time.png").stat().st_size > 1e4
