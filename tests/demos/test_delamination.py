"""Delamination tests at a coarse size against their theory, and the table of the demo."""

from __future__ import annotations

import math
from dataclasses import replace

import delamination
import numpy as np
import pytest
from parts.delamination import fatigue
from parts.delamination.beams import Run, dcb, four_point
from parts.delamination.cases import Case, measure, table
from parts.delamination.laminate import MMB, T300_977
from parts.delamination.mmb import A_0, CRITICAL, LEVERS, lever_length, mmb, theory
from parts.delamination.peel import peel
from parts.delamination.peel import theory as peeling
from parts.delamination.plies import D30, first_growth
from parts.delamination.vcct import flexibility

import vmdg


def test_theory_of_the_lever():
    """Loads of the literature, 126.6 and 725.2 N (.5% here for the plane strain modulus), and the
    ratios of the modes that the levers are made for."""
    for ratio, load in ((0.2, 126.6), (0.8, 725.2)):
        start = theory(MMB, LEVERS[ratio], A_0)
        assert start.load == pytest.approx(load, rel=0.006)
        assert start.ratio == pytest.approx(ratio, abs=0.01)
        assert lever_length(MMB, start.ratio) == pytest.approx(LEVERS[ratio], rel=1e-9)


def test_linear_fracture_mechanics():
    """The published critical points within 1% by a mesh of two cells over an arm; beam theory, its
    deflection with what the load presses in, within 1.5% by a finer one."""
    coarse, fine = flexibility(rows=2), flexibility(rows=8, tip=0.125)
    for ratio, (deflection, load) in CRITICAL.items():
        c = LEVERS[ratio]
        assert coarse.critical(c, MMB)[:2] == pytest.approx((load, deflection), rel=0.01)
        P, w, share = fine.critical(c, MMB)
        start = theory(MMB, c, A_0)
        assert (P, w) == pytest.approx((start.load, start.deflection), rel=0.015)
        assert share == pytest.approx(start.ratio, abs=0.01)


def test_mixed_mode_bending():
    """Beam theory: stiffness 1%, critical load 3%, mode ratio .02; the load falls behind it."""
    run = mmb(ratio=0.5, end=1.0, element_size=0.5)
    stiffness, critical, ratio = run.checks[:3]
    assert stiffness.error < 0.01
    assert critical.error < 0.03
    assert abs(ratio.computed - ratio.exact) < 0.02
    assert run.history["load"][-1] < 0.99 * critical.computed


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


def test_cycles_without_vmdg(tmp_path):
    """Arms and law in numpy: the slope of the law, and the growth of a zone that bears sqrt(G/G_c)
    of what it can; the picture with a run that follows a line of Paris."""
    found = fatigue.line(fatigue.without_vmdg(2.7))
    law = fatigue.BOND.wear(1.0, 0.0)
    assert found[0] == pytest.approx(law.exponent / 2, rel=0.005)
    zone = found[1] / math.exp(law.log_rate(math.sqrt(fatigue.SHARE), fatigue.BOND.life))
    assert 0.25 < zone < 0.35
    crack = fatigue.A_0 + np.linspace(0.0, 3.0, 61)
    release = fatigue.PLY.G_I * (fatigue.A_0 / crack) ** 8
    speed = 1e-4 * (release / fatigue.PLY.G_I / fatigue.SHARE) ** 7
    cycles = np.append(0.0, np.cumsum(np.diff(crack) / np.sqrt(speed[1:] * speed[:-1])))
    history = vmdg.History()
    for row in zip(cycles, crack, release, strict=True):
        named = zip(("cycles", "crack", "mode_1"), row, strict=True)
        history.append(dict(named) | {"force": 1.0})
    assert fatigue.line(fatigue.of_history(history)) == pytest.approx((7.0, 1e-4), rel=0.01)
    case = Case("cycles", lambda verbose: None, motion="cycles")
    delamination.draw(case, Run(vmdg.Result(history=history), [])).savefig(tmp_path / "cycles.png")
    assert (tmp_path / "cycles.png").stat().st_size > 10_000


def test_unknown_case(tmp_path):
    """Refused with the names that there are."""
    with pytest.raises(ValueError, match="case = 'dbc' must be all or one of mmb-20"):
        delamination.main(case="dbc", out=str(tmp_path))
