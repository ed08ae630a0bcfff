"""A few fibres at a coarse size: strengths in two directions, and a study that goes on."""

from __future__ import annotations

import pytest


def test_fibre_cell(comm, out):
    """Pull and shear fail between bond and weakest cut; runs that are done are not done again."""
    import fibre_cell as demo
    from helpers.fibre_cell import BOND, MATRIX, hashin_shtrikman

    coarse = {"fibres": 1, "cells": 2.0, "end": 0.012, "steps": 3, "out": str(out)}
    one = demo.main(**coarse, plot=False)
    both = demo.main(**coarse, directions=2)
    comm.barrier()
    assert both[0] == pytest.approx(one[0])
    assert both[:, :2].tolist() == [[0.0, 0.0], [0.0, 90.0]]
    assert not (out / "fibre_cell_0_0.png").exists()
    assert (out / "fibre_cell_0_90.png").stat().st_size > 10_000
    assert (out / "envelope.png").stat().st_size > 5_000
    pull, across = both[0, 2], both[1, 3]
    assert 0.5 * BOND[0] < across < MATRIX[0]
    for bulk, shear, cut, share in both[:, 4:]:
        assert 0.5 * BOND[0] < pull < cut < MATRIX[0]
        low, high = hashin_shtrikman(share)
        assert low[0] < bulk < high[0]
        assert low[1] < shear < high[1]
    assert abs(both[1, 2]) < 1e-6 * across  # free of stress
    assert demo.main(**coarse | {"fibres": 2, "end": 1e-3, "steps": 1}, plot=False).shape == (1, 8)
