"""A few fibres at a coarse size: one cell, strengths in two directions, a study that goes on."""

from __future__ import annotations

import numpy as np
import pytest


def test_fibre_cell(comm, out):
    """The cell is pulled until its matrix fails too; picture and table are written."""
    import fibre_cell as demo

    coarse = {"fibres": 1, "cells": 2.0, "end": 0.012, "steps": 3, "out": str(out)}
    history = demo.main(**coarse)
    comm.barrier()
    assert 0.5 * demo.BOND[0] < history["stress_xx"].max() < demo.MATRIX[0]
    assert np.abs(history["stress_xy"]).max() < 1e-6 * history["stress_xx"].max()
    assert (out / "fibre_cell.png").stat().st_size > 10_000
    assert (out / "history.csv").read_text().count("\n") == 1 + len(history)


def test_strengths(comm, out):
    """Pull and shear fail between bond and weakest cut; runs that are done are not done again."""
    import fibre_cell_strengths as study
    from parts.scenes import fibre_cell

    BOND, MATRIX = fibre_cell.BOND, fibre_cell.MATRIX
    coarse = {"fibres": 1, "cells": 2.0, "end": 0.012, "steps": 3, "out": str(out)}
    one = study.main(**coarse, seeds=1)
    both = study.main(**coarse, seeds=1, directions=2)
    comm.barrier()
    assert both[0] == pytest.approx(one[0])
    assert both[:, :2].tolist() == [[0.0, 0.0], [0.0, 90.0]]
    assert (out / "envelope.png").stat().st_size > 5_000
    pull, across = both[0, 2], both[1, 3]
    assert 0.5 * BOND[0] < across < MATRIX[0]
    for bulk, shear, cut, share in both[:, 4:]:
        assert 0.5 * BOND[0] < pull < cut < MATRIX[0]
        low, high = study.hashin_shtrikman(share)
        assert low[0] < bulk < high[0]
        assert low[1] < shear < high[1]
    assert abs(both[1, 2]) < 1e-6 * across  # free of stress
    few = coarse | {"fibres": 2, "end": 1e-3, "steps": 1}
    assert study.main(**few, seeds=1).shape == (1, 8)
