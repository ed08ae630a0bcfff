"""Buckling: the displacement leads where load is the wrong parameter, unstable states are found."""

from __future__ import annotations

import warnings

from mpi4py import MPI

import numpy as np
import pytest
from support.budgets import over_budget

import vmdg
from vmdg.base.parallel import global_max
from vmdg.meshes import blocks

#: Of a column 1 mm thick, of two halves [mm, MPa]; its bending stiffness [N mm^2].
LENGTH, E = 20.0, 1e4
STIFFNESS = E / 12
#: Euler's load of a column that is clamped at both ends [N].
CLAMPED = 4 * np.pi**2 * STIFFNESS / LENGTH**2
LAWS = {
    "tie": vmdg.Bonded(),
    "bond": vmdg.Debonding(strength=1e5, critical_gap=1.0),
    "unsymmetric": vmdg.Debonding(strength=1e5, critical_gap=1.0, friction=0.3),
}


def column(comm: MPI.Comm, law: vmdg.Law, imperfection: float, nu: float = 0.0):
    """A column that is clamped on the left, and how its facets are found."""
    scene = blocks(comm, "quadrilateral", (10, 2), LENGTH, 1.0, interface=(LENGTH / 2,) * 2)
    halves = dict.fromkeys((1, 2), vmdg.NeoHookean(E=E, nu=nu))
    bond = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, halves, [bond], degree=2)
    find = scene.facet_tags.find
    problem.dirichlet(find(1), 0.0)
    if imperfection:
        problem.traction(find(5), (0.0, imperfection))
    return problem, find


def deflection(problem: vmdg.Problem) -> dict[str, float]:
    """The largest one, for the history."""
    across = np.abs(problem.u.x.array.reshape(-1, 2)[:, 1])
    return {"deflection [mm]": global_max(problem.comm, across.max(initial=0.0))}


@pytest.mark.parametrize(("law", "steps"), [("tie", 1), ("tie", 20), ("unsymmetric", 4)])
def test_clamped_column(comm, law, steps):
    """Whatever the steps, the force stays at Euler's and the column takes its first mode.

    w = a/2 (1 - cos 2 pi x/L) shortens it by pi^2 a^2/(4 L). On the straight, unstable path the
    force would be 253 N instead of 82.
    """
    problem, find = column(comm, LAWS[law], 1e-4)
    problem.dirichlet(find(2), lambda t: (-t, 0.0))

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        return {"force [N]": problem.reaction(find(1))[0]} | deflection(problem)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Its imperfection is a force of some 1e-6 of the largest one.
        tight = vmdg.SolveOptions(relative_tolerance=1e-9)
        result = vmdg.solve(problem, np.linspace(0, 0.5, steps + 1)[1:], tight, monitor)
    history = result.history
    assert history["load"][-1] == 0.5
    assert history["force"].max() == pytest.approx(CLAMPED, rel=0.01)
    amplitude = 2 / np.pi * np.sqrt(LENGTH * (0.5 - CLAMPED * LENGTH / E))
    assert history["deflection"][-1] == pytest.approx(amplitude, rel=0.01)
    assert not over_budget("column that buckles", result)
    assert not over_budget(f"column that buckles, {steps} steps", result)


def test_nothing_shows_the_way(comm):
    """A perfect column goes on straight, and the run says that this is no stable state."""
    problem, find = column(comm, LAWS["tie"], 0.0, nu=0.25)
    problem.dirichlet(find(2), lambda t: (-t, 0.0))
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        result = vmdg.solve(problem, [0.1, 0.3, 0.5], monitor=deflection)
    said = [str(warning.message) for warning in found if warning.category is vmdg.ModelWarning]
    assert len(said) == (comm.rank == 0)
    assert all("small imperfection" in text for text in said)
    assert result.history["load"][-1] == 0.5
    assert {reason for _, reason in result.failures} == {"UNSTABLE"}


def test_motion_to_the_next_equilibrium(comm):
    """Pushed aside, a straight column that would long have buckled moves, against a drag: within
    six corrections no step gets there.

    Where it comes to rest it also is if it is pushed first, and pressed then.
    """
    options, ends = vmdg.SolveOptions(control="load"), []
    for pressed, pushed in ((0.5, 0.5), (1.0, 0.0)):
        problem, find = column(comm, LAWS["bond"], 0.0)
        problem.dirichlet(find(2), lambda t, end=pressed: (-0.5 * min(t / end, 1.0), 0.0))
        problem.traction(find(5), lambda t, start=pushed: (0.0, 10.0 * (t > start)))
        vmdg.solve(problem, [0.25, 0.5], options)
        if pressed == 0.5:
            assert deflection(problem)["deflection [mm]"] < 1e-9
            few = vmdg.SolveOptions(max_iterations=6)
            jumps = vmdg.solve(problem, [1.0], few).history["jump_steps"].sum()
            assert jumps > 0
        else:
            vmdg.solve(problem, [1.0], options)
        ends.append(deflection(problem)["deflection [mm]"])
    assert ends[0] == pytest.approx(ends[1], rel=1e-6)
    assert ends[0] > 2
