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
