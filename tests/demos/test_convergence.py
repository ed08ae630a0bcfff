"""Rates of the tied interface against exact finite-strain solutions, coarse studies."""

from __future__ import annotations

from pathlib import Path

import convergence
import pytest
from parts.convergence import rates


@pytest.fixture(scope="module")
def rows(comm, tmp_path_factory):
    """The coarse table, and the folder of its results."""
    out = Path(comm.bcast(str(tmp_path_factory.mktemp("convergence"))))
    return convergence.main(coarse=True, out=str(out)), out


@pytest.mark.long
def test_rates(rows):
    """L2 rate >= k + .9, H1 and interface traction >= k - .1 in every study."""
    for row in rows[0]:
        for norm, target in rates.targets(row.study.degree).items():
            assert row.rates[norm] >= target, (row.study, norm, row.rates)


@pytest.mark.long
def test_straight_cells_along_a_curve(comm):
    """They limit degree 2 to order 2 in L2 and order 1 of the traction; degree 1 loses nothing."""

    def coarse_rates(degree):
        study = rates.Study(
            "quadrilateral", degree, "curved", contrast=10.0, straight_cells=True, levels=(8, 16)
        )
        return rates.Row(study, [rates.errors(study, n, comm) for n in (8, 16)]).rates

    first, second = coarse_rates(1), coarse_rates(2)
    assert all(first[norm] >= rate for norm, rate in rates.targets(1).items())
    assert 1.8 < second["l2"] < 2.5 and 0.8 < second["traction"] < 1.3
