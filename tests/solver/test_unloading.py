"""Laws that unload to the origin, and criteria of mixed modes, through the solver: the bar."""

from __future__ import annotations

import numpy as np
import pytest
from support import bar
from support.bar import STRENGTH

import vmdg

OPTIONS = {"relative_tolerance": 1e-11, "energy": True, "unstable": "trace"}
LAWS = {
    "linear": lambda gap: vmdg.Debonding(STRENGTH, gap, unloading="secant"),
    "exponential": lambda gap: vmdg.ExponentialDebonding(
        STRENGTH, STRENGTH * gap / 2, unloading="secant"
    ),
    "BK": lambda gap: vmdg.MixedModeDebonding(
        *(STRENGTH, 60.0, STRENGTH * gap / 2, 4.0), criterion="BK", exponent=2.0
    ),
    "BK secant": lambda gap: vmdg.MixedModeDebonding(
        *(STRENGTH, 60.0, STRENGTH * gap / 2, 4.0), criterion="BK", exponent=2.0, unloading="secant"
    ),
}


def softened(name: str, gap: float, critical_gap: float) -> float:
    """Traction at the largest gap [MPa]."""
    if name == "exponential":
        return STRENGTH * np.exp(-2 * gap / critical_gap)
    return STRENGTH * max(1 - gap / critical_gap, 0.0)


@pytest.mark.parametrize(
    ("name", "kinematics"),
    [
        pytest.param("exponential", "small", marks=pytest.mark.long),
        ("BK", "small"),
        ("BK secant", "finite"),
    ],
)
def test_snap_back_is_traced(comm, name, kinematics):
    """By the work on bonds, every row on the curve, and what goes in is stored or spent."""
    critical_gap = 0.01
    problem = bar.with_law(comm, LAWS[name](critical_gap), kinematics)
    history = vmdg.solve(problem, bar.LOADS, vmdg.SolveOptions(**OPTIONS), bar.means).history
    assert history["load"].tolist() != sorted(history["load"])
    softening = history["gap"] > 0
    assert softening.sum() > 10
    for T, gap in zip(history["traction"][softening], history["gap"][softening], strict=True):
        assert pytest.approx(softened(name, gap, critical_gap), abs=1e-6) == T
    assert problem.energy().damage == pytest.approx(STRENGTH * critical_gap / 2, rel=1e-4)
    assert np.allclose(history["spread"], 0, atol=1e-8)


@pytest.mark.parametrize("control", ["auto", "load", "dissipation"])
def test_a_load_that_turns_back_unloads(comm, control):
    """Plastic gaps: the traction falls along the elastic line, no bond breaks on the way back."""
    problem = bar.with_law(comm, vmdg.Debonding(STRENGTH, 0.12), "small")
    options = vmdg.SolveOptions(**OPTIONS, control=control)
    history = vmdg.solve(problem, [0.03, 0.06, 0.045, 0.06], options, bar.means).history
    rows = [list(history["load"]).index(0.06)]
    rows += range(rows[0] + 1, len(history))
    top = rows[0]
    assert {0.045, 0.06} == set(history["load"][rows])
    for row in rows:
        T, t = history["traction"][row], history["load"][row]
        slope = bar.E / (1 - bar.NU**2) / 2
        assert pytest.approx(history["traction"][top] - slope * (0.06 - t), rel=1e-8) == T
        assert history["gap"][row] == pytest.approx(history["gap"][top], rel=1e-8)
