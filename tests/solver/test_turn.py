"""A turn of the supports in one step, however large: the body turns with them."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from support.checks import in_frame
from support.problems import MATERIALS, driven

import vmdg

LAW = vmdg.Debonding(strength=100.0, critical_gap=0.2)
PRECISE = vmdg.SolveOptions(relative_tolerance=1e-12)
QUARTER = np.pi / 2


def half_damaged(cell: str, more: float, angle: float) -> vmdg.Problem:
    """Opened until t = 1, then opened by ``more`` [mm] and turned by ``angle`` until t = 2."""
    d = 3 if cell == "hexahedron" else 2
    first, second = (np.array(move)[:d] for move in ([0.12, 0.03, 0.02], [more, more, 0.0]))

    def path(t: float) -> tuple[np.ndarray, float]:
        return first * min(t, 1) + second * max(t - 1, 0), angle * max(t - 1, 0)

    problem, _ = driven(MPI.COMM_SELF, cell, LAW, path, 4 - d, MATERIALS)
    # tau_s belongs to the step before: resting a few steps, the state and its tau_s agree.
    vmdg.solve(problem, [*np.linspace(0.2, 1, 5), *[1.0] * 4], PRECISE)
    softening = problem.state[0].softening / LAW.strength
    assert ((softening > 0.2) & (softening < 0.9)).all()
    return problem


@pytest.mark.parametrize(("cell", "angle"), [("quadrilateral", np.pi), ("hexahedron", QUARTER)])
def test_one_step(cell, angle):
    """Q, R^T.T and R^T.zeta of a half damaged bond stay, and no attempt fails."""
    problem = half_damaged(cell, 0.0, angle)
    before = in_frame(problem)
    result = vmdg.solve(problem, [2.0])
    assert not result.failures
    assert list(result.history["load"]) == [2.0]
    scales = LAW.strength, LAW.critical_gap, LAW.strength
    for now, then, scale in zip(in_frame(problem), before, scales, strict=True):
        assert now == pytest.approx(then, abs=1e-8 * scale)


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_one_step_of_turn_and_stretch(cell):
    """Opened further on the way, the bond is as it is without the turn."""
    states = []
    for angle in (0.0, QUARTER):
        problem = half_damaged(cell, 0.01, angle)
        result = vmdg.solve(problem, [2.0], PRECISE)
        assert not result.failures
        states.append(in_frame(problem))
    for still, moved in zip(*states, strict=True):
        assert moved == pytest.approx(still, rel=1e-6, abs=1e-9)
