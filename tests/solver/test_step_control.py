"""What a step must fulfil beside a small residual, and what solve reports."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from support.budgets import over_budget

import vmdg
from vmdg.meshes import blocks
from vmdg.solver.corrector import Corrector
from vmdg.solver.iterate import Iterate
from vmdg.solver.limits import Direction, Limits
from vmdg.solver.onset import Pieces

E = 1000.0


def squares(comm, law: vmdg.Law, left, right) -> vmdg.Problem:
    mesh, cells, facets = blocks(comm, "quadrilateral", (2, 2))
    material = vmdg.NeoHookean(E=E, nu=0.3)
    interface = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(mesh, cells, {1: material, 2: material}, [interface])
    problem.dirichlet(facets.find(1), left)
    problem.dirichlet(facets.find(2), right)
    return problem


def test_a_correction_beyond_the_work_of_a_step(comm):
    """One that starts beyond the limit of the damage work, but not by far, is not shortened to
    nothing: no length of it would end within the limit."""
    mesh, cells, _ = blocks(comm, "quadrilateral", (2, 2))
    law = vmdg.Debonding(strength=2.0, critical_gap=0.1)
    bodies = dict.fromkeys((1, 2), vmdg.NeoHookean(E=E, nu=0.3))
    problem = vmdg.Problem(mesh, cells, bodies, [vmdg.Interface(between=(1, 2), law=law)])
    options = vmdg.SolveOptions()
    corrector = Corrector(problem, options)
    problem.step.begin(1.0, np.inf)
    moved = np.zeros(len(problem.u.x.array))
    moved[2 * np.unique(problem.space.dofmap.list[cells.find(2)])] = 1.0
    apart = Direction(moved[: problem.discretization.owned], 0.0)
    nothing = Direction(0.0 * apart.u, 0.0)

    def iterate(work: float) -> Iterate:
        given = problem, corrector.system, Pieces(problem.discretization), options.path, 1.0
        limits = Limits(0.0, 1.0, 1.0, work=work)
        return Iterate(*given, limits, np.inf, continues=True)

    def work(gap: float) -> float:
        free.map(nothing.plus(apart, gap))
        return free.reach().work

    free = iterate(np.inf)
    low, high = work(0.02), work(0.025)
    assert 0 < 1.1 * low < high
    start = nothing.plus(apart, 0.02)
    # Twice the limit counts as far.
    limited = iterate(low / 1.9)
    assert high > 2 * low / 1.9
    assert limited.allowed(start, apart, 0.005) == 0.005
    length = limited.allowed(start, apart, 0.08)
    assert 0 < length < 0.08
    assert 0.5 * low < work(0.02 + length) < 1.5 * low
    assert iterate(low / 1.9).allowed(nothing, apart, 0.02) == 0.02
    assert iterate(low / 20).allowed(nothing, apart, 0.02) < 0.02
    corrector.free()


def test_a_target_that_is_never_reached(comm):
    """Steps to a load factor without an equilibrium end in an error, though each half of them
    converges, however short it is."""
    problem = squares(comm, vmdg.Bonded(), 0.0, lambda t: (0.01 * t, 0.0))
    problem.body_force(lambda t: (1e300 if t == 0.5 else t, 0.0))
    with pytest.raises(vmdg.StepFailure, match=r"to 0\.5 failed .*DIVERGED_FNORM_NAN"):
        vmdg.solve(problem, [0.25, 0.5, 1.0])
    assert problem.t == pytest.approx(0.5)


def test_inverted_cells_are_refused(comm):
    """Equilibria of bodies that are turned inside out, which an energy without ln J does not
    prevent: no step ends in one, and the problem is in its last state."""
    mesh, cells, facets = blocks(comm, "quadrilateral", (2, 2))
    rubber = vmdg.Hyperelastic(lambda F, p: p["c"] * (ufl.inner(F, F) - 2 * ufl.det(F)), {"c": E})
    interface = vmdg.Interface(between=(1, 2), law=vmdg.Bonded(), safety=1.0)
    problem = vmdg.Problem(mesh, cells, {1: rubber, 2: rubber}, [interface])
    problem.dirichlet(facets.find(1), 0.0)
    problem.dirichlet(facets.find(2), lambda t: (-t, 0.0))
    vmdg.solve(problem, [0.1])
    before = problem.u.x.array.copy()
    with pytest.raises(vmdg.StepFailure, match="CELLS_INVERTED"):
        vmdg.solve(problem, [5.0], vmdg.SolveOptions(control="load", max_cuts=0))
    assert problem.t == 0.1
    assert np.array_equal(problem.u.x.array, before)


@pytest.mark.filterwarnings("ignore:interface 0:vmdg.ModelWarning")
def test_residual_is_small_against_a_weak_bond(comm):
    """Opened beyond its strength in one step, a bond of 1e-8 E leaves no force.

    The bonded imbalance of such a step is of the order of E: a billionth of it is more than the
    bond could ever bear.
    """
    law = vmdg.Debonding(strength=1e-5, critical_gap=1e-6, friction=0.3)
    problem = squares(comm, law, 0.0, lambda t: np.array([t, t / 2]))
    for t in (0.05, 0.1):
        vmdg.solve(problem, [t], vmdg.SolveOptions(control="load", max_cuts=0))
        free = np.setdiff1d(np.arange(problem.discretization.owned), problem.loading.prescribed)
        residual = problem.step.assemble_residual(hold=True)[free]
        assert np.abs(residual).max(initial=0.0) < 1e-6 * law.strength


def test_given_history_is_filled(comm):
    """An empty table too, and also where the run ends in an error."""
    law = vmdg.Debonding(strength=10.0, critical_gap=0.1)
    problem = squares(comm, law, 0.0, lambda t: np.array([t, 0.0]))
    history = vmdg.History()
    vmdg.solve(problem, [0.001, 0.002], history=history)
    assert list(history["load"]) == [0.001, 0.002]
    options = vmdg.SolveOptions(max_iterations=1, max_cuts=0)
    with pytest.raises(vmdg.StepFailure):
        vmdg.solve(problem, [0.0025, -100.0], options, history=history)
    assert list(history["load"]) == [0.001, 0.002, 0.0025]


def test_number_of_steps(comm):
    """An int is so many equal steps from the present load factor to 1, where a run then ends."""
    problem = squares(comm, vmdg.Bonded(), 0.0, lambda t: np.array([0.1 * t, 0.0]))
    history = vmdg.solve(problem, 4).history
    assert history["load"] == pytest.approx(np.linspace(0.25, 1, 4), rel=1e-15)
    with pytest.raises(
        ValueError, match=r"the problem is at 1: give the load factors .* \[1, 1.1\]"
    ):
        vmdg.solve(problem, 4)
    vmdg.solve(problem, [0.5])
    assert vmdg.solve(problem, np.int64(2)).history["load"].tolist() == [0.75, 1.0]


def test_one_tangent_serves_a_small_step(comm):
    """Where no path is followed; along one the last tangent is to tell whether it is stable."""
    held = squares(comm, vmdg.Bonded(), 0.0, (1e-6, 2e-6))
    once = vmdg.solve(held, [1.0])
    assert not over_budget("small step, held", once)
    assert once.history["iterations"] == [1]
    moved = squares(comm, vmdg.Bonded(), 0.0, lambda t: (1e-6 * t, 2e-6 * t))
    twice = vmdg.solve(moved, [1.0])
    assert (twice.counts.factorizations, twice.counts.solves) == (2, 2)
    assert np.abs(held.u.x.array - moved.u.x.array).max() < 1e-15
