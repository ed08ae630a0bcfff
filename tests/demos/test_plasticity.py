"""Plastic bodies with interfaces at coarse sizes: one body, closed forms, a published membrane."""

from __future__ import annotations

import numpy as np
import plasticity
import pytest
from parts.plasticity import arms, shells


def rows_of(case, comm, out):
    """Rows of a coarse case by name, quantity and source."""
    rows = plasticity.main(case=case, coarse=True, out=str(out), plot=False)
    comm.barrier()
    assert (out / "plasticity.md").read_text().count("\n") == len(rows) + 2
    return {(row.case, row.quantity, row.source): row for row in rows}


@pytest.mark.long
def test_necking(comm, out):
    """Halves joined at the neck carry what one body does, far beyond the peak within 0.3 %; in 3D
    within 1 % what the section with as many cells does."""
    rows = rows_of("necking", comm, out)
    for (case, quantity, source), row in rows.items():
        if source == "one body, same mesh":
            assert abs(row.error) < 3e-3, (case, quantity)
        elif source == "axisymmetric":
            assert abs(row.error) < (1e-5 if "largest" in quantity else 0.01), quantity
    peak = rows["necking, tied", "largest force [kN]", "one body, refined"]
    assert peak.computed == pytest.approx(77.25, rel=2e-3)
    last = rows["necking, tied", "force at 7 mm [kN]", "one body, refined"]
    assert last.computed < 0.4 * peak.computed


@pytest.mark.long
def test_membrane(comm, out):
    """A tie across the membrane changes nothing, and 8 x 8 cells miss the published rise by 4 %; so
    it is with hexahedra between smooth walls, 4 x 4 of which miss it by 12 %."""
    for (case, quantity, source), row in rows_of("cook", comm, out).items():
        if source == "one body, same mesh":
            assert abs(row.error) < 1e-3, (case, quantity)
        elif source == "code_aster ssnp179a":
            assert abs(row.error) < (0.13 if "3D" in case else 0.05), (case, quantity)


@pytest.mark.long
def test_shells(comm):
    """Errors of the displacement are those of one body within 5 % and fall by the order 3."""
    shape, front = shells.Shell(True, 0.3), (shells.M + shells.B) / 2
    errors = np.array(
        [[shells.press(shape, n, tied, front).error for tied in (True, False)] for n in (4, 8)]
    )
    assert errors[1, 0] == pytest.approx(errors[1, 1], rel=0.05)
    assert (errors[1] < errors[0] / 2**2.9).all()


def test_inclusion(comm):
    """Traction and gap while a plastic matrix debonds, until half of the bond is lost."""
    gaps = shells.BOND.critical_gap * np.array([0.1, 0.2, 0.3, 0.4])
    traction, opening, _ = shells.pull_off(8, gaps)
    assert traction == pytest.approx([shells.debonding(gap)[1] for gap in gaps], rel=2e-3)
    assert opening == pytest.approx(gaps, rel=1e-2)


@pytest.mark.long
def test_arms(comm, out):
    """Plastic arms are parted by the moment of J, less than elastic ones need by a quarter."""
    (row,) = rows_of("arms", comm, out).values()
    assert abs(row.error) < 0.01
    assert row.reference < 0.8 * arms.elastic_moment()
