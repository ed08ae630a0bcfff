"""An interface in one number, the same on every rank and in every partition."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from support.problems import couple, joined
from support.scenes import two_blocks

import vmdg
from vmdg import plot

LAW = vmdg.Debonding(strength=20.0, critical_gap=1.0)


def torn(comm: MPI.Comm, **options) -> vmdg.Problem:
    """Two blocks that are pulled apart, more so at the top."""
    scene = two_blocks(comm, "quadrilateral", 4)
    problem = joined(scene, LAW, interface={"name": "bond"}, **options)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(scene.facet_tags.find(2), lambda x, t: t * np.array([0.5 + x[1], 0 * x[1]]))
    vmdg.solve(problem, [0.01, 0.02])
    return problem


def numbers(problem: vmdg.Problem) -> list[float]:
    """All that there is, with functions of the state too."""
    opening = lambda state: state.opening[:, 0]  # noqa: E731
    found = [
        *vmdg.extremes(problem, "bond", "opening"),
        *vmdg.extremes(problem, 0, opening),
        vmdg.average(problem, "bond", "damage"),
        vmdg.integral(problem, problem.interfaces[0], "traction"),
        vmdg.integral(problem, "bond", lambda state: np.ones(len(state.points))),
    ]
    (rows,) = vmdg.profile(problem, "bond", "opening", along="y")
    return [*found, *rows.ravel()]


def test_same_on_any_number_of_ranks(comm):
    """And equal to the means and forces that the problem knows."""
    problem = torn(comm, thickness=2.0)
    found = numbers(problem)
    assert found == pytest.approx(numbers(torn(MPI.COMM_SELF, thickness=2.0)), rel=1e-8)
    low, high, *_, damage, force, area = found[:7]
    assert 0 < low < problem.mean("bond").opening[0] < high
    assert damage == pytest.approx(problem.mean("bond").softening / LAW.strength)
    assert force == pytest.approx(-problem.reaction(lambda x: np.isclose(x[0], 0))[0], rel=1e-6)
    assert area == pytest.approx(2.0)


def test_profile_of_a_function(comm):
    """Of the state, as of what has a name; a picture of it has no label of its own."""
    problem = torn(comm)
    share = lambda state: state.softening / LAW.strength  # noqa: E731
    ((rows,), (named,)) = (
        vmdg.profile(problem, "bond", quantity, along="y") for quantity in (share, "damage")
    )
    assert rows[:, 1].max() > 0
    assert np.array_equal(rows, named)
    axes = plot.interface_profile(problem, "bond", share, along="y")
    assert np.array_equal(axes.lines[0].get_xydata(), rows)
    assert axes.get_ylabel() == ""
    with pytest.raises(ValueError, match="must be one number for each"):
        vmdg.profile(problem, "bond", lambda state: state.traction)


def test_nothing_open(comm):
    """Where facets are closed there is nothing to look at."""
    scene = two_blocks(comm, "quadrilateral", 2)
    problem = couple(scene, LAW, activate="on-demand")
    assert np.isnan(vmdg.extremes(problem, 0, "damage")).all()
    assert np.isnan(vmdg.average(problem, 0, "damage"))
    assert vmdg.integral(problem, 0, "traction") == 0.0


def test_mistakes(comm):
    """What is no scalar, and a function that gives something else or fails on one rank."""
    problem = torn(comm)
    with pytest.raises(ValueError, match="'force' is not a scalar of an interface"):
        vmdg.extremes(problem, "bond", "force")
    with pytest.raises(ValueError, match="there is no interface 'glue'"):
        vmdg.average(problem, "glue", "damage")
    with pytest.raises(ValueError, match="must be one number for each"):
        vmdg.integral(problem, "bond", lambda state: state.traction)

    def fails(state: vmdg.InterfaceState) -> np.ndarray:
        if comm.rank == comm.size - 1:
            raise IndexError("no points here")
        return state.softening

    with pytest.raises(IndexError, match="no points here"):
        vmdg.extremes(problem, "bond", fails)


def test_debonded_of_one_interface(comm):
    """By number, name and object; other interfaces do not count."""
    scene = two_blocks(comm, "quadrilateral", 4)
    half = lambda x: 1.0 * (x[1] < 0.5)  # noqa: E731
    bonds = [
        vmdg.Interface(between=(1, 2), law=LAW, name="bond", initial_damage=half),
        vmdg.Interface(within=2, law=LAW, activate="on-demand", name="cracks"),
    ]
    body = vmdg.NeoHookean(E=1e3, nu=0.3)
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, {1: body, 2: body}, bonds)
    found = [problem.debonded(which) for which in ("bond", 0, bonds[0])]
    assert found == pytest.approx([0.5] * 3)
    assert problem.debonded("cracks") == 0.0
    assert 0 < problem.debonded() < 0.5
    with pytest.raises(ValueError, match="there is no interface 'glue'"):
        problem.debonded("glue")
