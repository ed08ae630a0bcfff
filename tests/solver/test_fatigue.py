"""Cycles through the solver: a bar under dead load, and the Paris line of a cracked beam."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from support import bar

import vmdg

LAW = vmdg.FatigueDebonding(100.0, 100.0, 1.0, 1.0)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::vmdg.ModelWarning")
def test_bar_under_dead_load():
    """(1 - d)^(beta + 1) = 1 - N (p/E)^beta/gamma at a constant traction p P; energies; the end."""
    p, wear = 0.6, LAW.wear(1.0, 0.0)
    problem = bar.with_law(MPI.COMM_SELF, LAW, "small", dead=True, most=100.0 * p)
    static = vmdg.solve(problem, [100.0 * p])
    assert not problem.state[0].softening.any()
    life = float(LAW.cycles_to_failure(p))
    options = vmdg.SolveOptions(cycles=1.0, max_loss=0.002, energy=True)
    loads = 100.0 * p + life * np.array([0.4, 0.6])
    result = vmdg.solve(problem, loads, options, history=static.history)
    d = problem.state[0].softening / 100.0
    exact = 1.0 - (1.0 - 0.6 * life * (p / wear.endurance) ** wear.exponent / LAW.life) ** (
        1.0 / (wear.exponent + 1.0)
    )
    assert d == pytest.approx(exact, rel=0.025)
    last = result.history.rows[-1]
    assert last["damage"] == pytest.approx(p**2 * (1 / (1 - exact) - 1), rel=0.025)
    assert abs(last["imbalance"]) < 1e-5 * last["damage"]
    options = vmdg.SolveOptions(cycles=1.0, unstable="trace")
    with pytest.raises(vmdg.StepFailure, match="without force balance"):
        vmdg.solve(problem, [100.0 * p + 1.2 * life], options)
    # early, with steps that long
    assert 0.9 * life < problem.t - 100.0 * p < life


def test_cycles_need_a_law_that_feels_them():
    problem = bar.build(MPI.COMM_SELF, 0.02, "small")
    with pytest.raises(ValueError, match=r"cycles = 10\.0, but no law .* depends on them"):
        vmdg.solve(problem, [0.001], vmdg.SolveOptions(cycles=10.0))
