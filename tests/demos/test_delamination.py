"""Delamination tests at a coarse size against their theory, and the table of the demo."""

from __future__ import annotations

from dataclasses import replace

import delamination
import pytest
from delamination import Case, measure, table
from parts.delamination.beams import dcb, four_point
from parts.delamination.laminate import MMB, T300_977
from parts.delamination.mmb import A_0, LEVERS, lever_length, mmb, theory
from parts.delamination.peel import peel
from parts.delamination.peel import theory as peeling
from parts.delamination.plies import D30, first_growth


def test_theory_of_the_lever():
    """Loads of the literature, 126.6 and 725.2 N (.5% here for the plane strain modulus), and the
    ratios of the modes that the levers are made for."""
    for ratio, load in ((0.2, 126.6), (0.8, 725.2)):
        start = theory(MMB, LEVERS[ratio], A_0)
        assert start.load == pytest.approx(load, rel=0.006)
        assert start.ratio == pytest.approx(ratio, abs=0.01)
        assert lever_length(MMB, start.ratio) == pytest.approx(LEVERS[ratio], rel=1e-9)


@pytest.mark.long
def test_mixed_mode_bending():
    """Beam theory: stiffness 1%, critical load 3%, mode ratio .02; the load falls behind it."""
    run = mmb(ratio=0.5, end=1.0, element_size=0.5)
    stiffness, critical, ratio = run.checks[:3]
    assert stiffness.error < 0.01
    assert critical.error < 0.03
    assert abs(ratio.computed - ratio.exact) < 0.02
    assert run.history["load"][-1] < 0.99 * critical.computed


@pytest.mark.long
def test_peel():
    """Forces of the closed form, and its energy release rate as soon as the film comes off."""
    assert peeling(90) == pytest.approx(0.2, rel=1e-3)
    assert peeling(180) == pytest.approx(0.1, rel=1e-3)
    history = peel(90.0, length=0.05, element_size=0.2).history
    loose = history["crack"] > 10.02
    released = (history["mode_1"] + history["mode_2"])[loose]
    assert loose.sum() > 2
    # At 90 degrees P/b itself, whether the crack runs or not.
    assert released == pytest.approx(history["force"][loose], rel=0.05)


@pytest.mark.long
def test_curved_front():
    """Stiffness 1% and first growth 3% of the published ones, with four cells over the width; the
    middle is ahead of the edges."""
    opening, published = D30.points[31.0]
    load, stiffness, result = first_growth(D30, 31.0, columns=4)
    assert stiffness == pytest.approx(published / opening, rel=0.01)
    assert load == pytest.approx(published, rel=0.03)
    last = result.history.rows[-1]
    edge, *inner, other = (value for name, value in last.items() if name.startswith("front_"))
    assert edge == pytest.approx(other, abs=1e-6)
    assert edge - 31 < 0.5 * (min(inner) - 31)


@pytest.mark.long
def test_four_point_bending():
    """The load stays at that of beam theory while the crack runs."""
    run = four_point(element_size=1.0, run=14.0, rows=1)
    for check in run.checks:
        assert check.error < 0.02


def test_case(tmp_path):
    """A case as the demo runs it: lines beside the literature, and a picture."""
    bond = replace(T300_977, strength=26.0)
    options = {"element_size": 1.0, "rows": 1, "degree": 2, "a_0": 55.0, "length": 120.0}
    short = Case(
        "DCB",
        lambda verbose: dcb(m=bond, steps=8, end=5.0, **options),
        {"peak load": 62.0},
        [(1.0, 14.6), (2.0, 29.2)],
    )
    run, rows = measure("short", short)
    peak = next(row for row in rows if row.quantity.startswith("peak"))
    assert peak.computed == pytest.approx(peak.published, rel=0.02)
    assert peak.computed == pytest.approx(peak.theory, rel=0.03)
    assert rows[-1].published == 29.2
    assert rows[-1].computed == pytest.approx(29.2, rel=0.01)
    assert table(rows).count("\n") == len(rows) + 1
    delamination.draw(short, run).savefig(tmp_path / "short.png")
    assert (tmp_path / "short.png").stat().st_size > 10_000
    run.history.to_csv(tmp_path / "dcb.csv")
    axes = delamination.overview(tmp_path).axes
    assert [ax.get_title() for ax in axes if ax.lines] == [delamination.CASES["dcb"].title]


def test_unknown_case(tmp_path):
    """Refused with the names that there are."""
    with pytest.raises(ValueError, match="case = 'dbc' must be all or one of mmb-20"):
        delamination.main(case="dbc", out=str(tmp_path))
