"""The predictor along the path, and how exactly linear systems are solved in the iteration."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from support.problems import FRICTION, pressed

import vmdg
from vmdg.solver.newton import MAX_RTOL, MIN_RTOL, linear_tolerance
from vmdg.solver.predictor import PREDICTORS, EquilibriumPath


def on_a_parabola(t: float) -> np.ndarray:
    return np.array([1.0 - 2 * t + 3 * t**2, 4 * t])


def walked(*times: float) -> EquilibriumPath:
    path = EquilibriumPath(MPI.COMM_SELF)
    for t in times:
        path.start(t, on_a_parabola(t))
    return path


def test_extrapolation_is_exact():
    """Two states give the straight line through them, three the parabola."""
    line, parabola = walked(0.0, 0.1, 0.3, 0.4).ahead(0.6)
    a, b = on_a_parabola(0.3), on_a_parabola(0.4)
    assert line == pytest.approx(b + 2 * (b - a), rel=1e-12)
    assert parabola == pytest.approx(on_a_parabola(0.6), rel=1e-12)


def test_nothing_ahead():
    """Not from one state, not where the load turns back, not far beyond the last step."""
    assert walked(0.0).ahead(0.1) == []
    assert walked(0.0, 0.1).ahead(0.05) == []
    assert walked(0.0, 0.1).ahead(0.6) == []
    assert len(walked(0.0, 0.1).ahead(0.5)) == 1
    assert len(walked(0.2, 0.0, 0.1).ahead(0.2)) == 1


def test_cut_steps_and_jumps():
    """A step that is tried again leaves the path, another state at the same load ends it."""
    path = walked(0.0, 0.1)
    path.start(0.1, on_a_parabola(0.1))
    assert len(path.ahead(0.2)) == 1
    path.start(0.1, on_a_parabola(0.1) + 1)
    assert path.ahead(0.2) == []


def test_ranks_leave_the_path_together(comm):
    """A state that differs on one rank only ends the path on all."""
    path = EquilibriumPath(comm)
    for t in (0.0, 0.1):
        path.start(t, on_a_parabola(t))
    path.start(0.1, on_a_parabola(0.1) + (comm.rank == 0))
    assert path.ahead(0.2) == []


def test_linear_tolerance():
    """Looser while the residual falls slowly, never more exact than the step still needs."""
    assert linear_tolerance([1.0, 0.9], 1e-12) == MAX_RTOL
    assert linear_tolerance([1.0, 1e-1], 1e-12) == pytest.approx(0.9e-2)
    assert linear_tolerance([1.0, 1e-5], 1e-12) == MIN_RTOL
    assert linear_tolerance([1.0, 1e-5], 1e-7) == pytest.approx(0.3e-2)
    assert linear_tolerance([1.0], 0.9) == 0.1


def test_predictors_agree(comm):
    """All predictors end at the same states; along the path fewer systems are solved."""
    solves, results = [], []
    for predictor in PREDICTORS:
        problem = pressed(comm, "quadrilateral", FRICTION)
        options = vmdg.SolveOptions(relative_tolerance=1e-11, predictor=predictor)
        result = vmdg.solve(problem, np.linspace(0, 1, 21)[1:], options)
        assert not result.failures
        solves.append(result.counts.solves)
        results.append(problem.u.x.array.copy())
    assert results[0] == pytest.approx(results[1], abs=1e-10)
    assert results[0] == pytest.approx(results[2], abs=1e-10)
    assert solves[0] < 0.7 * min(solves[1:])


def test_unknown_predictor(comm):
    """The error names what there is."""
    problem = pressed(comm, "quadrilateral", FRICTION)
    with pytest.raises(ValueError, match="'tangents' must be one of"):
        vmdg.solve(problem, [1.0], vmdg.SolveOptions(predictor="tangents"))
