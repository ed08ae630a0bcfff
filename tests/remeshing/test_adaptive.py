"""Meshes that follow a crack, against a mesh that is fine where the crack comes by."""

from __future__ import annotations

import numpy as np
import pytest
from support.arms import CRACK, HEIGHT, LENGTH, open_ends, opened

import vmdg
from vmdg.meshes import beams, refined

FINE, WINDOW = 0.5, 3.0
LOADS = np.append(np.arange(1, 11) * 0.05, [0.7, 0.9])
ENERGY = vmdg.SolveOptions(energy=True)


def makes(comm, kinematics: str = "small", unloading: str = "plastic"):
    """A function that makes a double cantilever beam with cells of a given size."""
    stations, divisions = (0.0, 10.0, CRACK, LENGTH), (5, 1, 9)
    root = beams(
        comm,
        cell="triangle",
        stations=stations,
        divisions=divisions,
        height=HEIGHT,
        rows=1,
        precrack=CRACK,
    )

    def make(size) -> vmdg.Problem:
        mesh, cells, sides = refined(root, size)
        bond = vmdg.Debonding(strength=20.0, critical_gap=0.02, unloading=unloading)
        interface = vmdg.Interface(facets=sides.find("interface"), law=bond)
        body = vmdg.NeoHookean(E=70e3, nu=0.3)
        problem = vmdg.Problem(
            mesh, cells, {1: body, 2: body}, [interface], degree=2, kinematics=kinematics
        )
        open_ends(problem, sides)
        return problem

    return make


@pytest.mark.parametrize("kinematics", (pytest.param("small", marks=pytest.mark.long), "finite"))
def test_peeled_beam(comm, kinematics):
    """Force and energies of the fixed mesh at all given load factors, with fewer unknowns; energies
    balance, and the wake is coarse again."""
    make = makes(comm, kinematics)
    found = vmdg.solve_adaptively(make, LOADS, FINE, WINDOW, ENERGY, opened)
    along = lambda x: FINE + 0.4 * np.maximum(np.hypot(np.maximum(CRACK - x[0], 0), x[1]) - FINE, 0)  # noqa: E731
    fixed = make(along)
    there = vmdg.solve(fixed, LOADS, ENERGY, opened).history
    here = found.history
    assert len(found.transfers) >= 2
    assert set(LOADS) <= set(here["load"])
    assert (np.diff(here["load"]) >= 0).all()
    for column in ("force", "damage", "external"):
        curves = [run[column][np.isin(run["load"], LOADS)] for run in (here, there)]
        assert curves[0] == pytest.approx(curves[1], rel=5e-3, abs=1e-3)
    assert abs(here["imbalance"]).max() < 1e-4 * here["external"][-1]
    dofmap = fixed.space.dofmap
    assert here["unknowns"].max() < 0.8 * dofmap.index_map.size_global * dofmap.index_map_bs
    # Whoever looks at the last mesh finds the tip where the fixed one has it.
    shares = [problem.debonded(0) for problem in (found.problem, fixed)]
    assert shares[0] == pytest.approx(shares[1], abs=FINE / (LENGTH - CRACK))


def test_unloading_needs_no_mesh(comm):
    """Load factors that fall again, on the mesh of the last front."""
    make = makes(comm, unloading="secant")
    found = vmdg.solve_adaptively(make, [0.3, 0.6, 0.3], FINE, WINDOW, ENERGY, opened)
    damage, load = found.history["damage"], found.history["load"]
    assert load[-1] == 0.3 and damage[-1] > 0
    assert damage[-1] == pytest.approx(damage[load == 0.6][0], rel=1e-6)
    # The first mesh has no row.
    assert len(found.results) in (len(found.transfers) + 1, len(found.transfers) + 2)


def test_rows_are_not_lost(comm):
    """An error of the monitor has the rows so far and the problem, in the state of the last one."""

    def fails(problem):
        if problem.t > 0.35:
            raise ArithmeticError("no number")
        return opened(problem)

    with pytest.raises(ArithmeticError) as caught:
        vmdg.solve_adaptively(makes(comm), LOADS, FINE, WINDOW, ENERGY, fails)
    rows, problem = caught.value.result.history, caught.value.problem
    assert 0 < rows["load"][-1] == problem.t <= 0.35
    assert rows["force"][-1] == pytest.approx(opened(problem)["force [N]"], rel=1e-9)


def test_wrong_arguments(comm):
    """Words that name what is wrong."""
    make = makes(comm)
    with pytest.raises(ValueError, match=r"window = 0\.9 must be positive lengths, the window at"):
        vmdg.solve_adaptively(make, LOADS, FINE, 0.9)
    with pytest.raises(ValueError, match="csv= is of runs on one mesh, whose rows stay"):
        options = vmdg.SolveOptions(csv="rows.csv")
        vmdg.solve_adaptively(make, LOADS, FINE, WINDOW, options)
    with pytest.raises(ValueError, match="resume=True needs the folder of the checkpoints"):
        vmdg.solve_adaptively(make, LOADS, FINE, WINDOW, resume=True)
    with pytest.raises(TypeError, match=r"make_problem returned None, not a vmdg\.Problem"):
        vmdg.solve_adaptively(lambda size: None, LOADS, FINE, WINDOW)
    with pytest.raises(ValueError, match="unknowns, more than most_unknowns = 400"):
        vmdg.solve_adaptively(make, LOADS, FINE, WINDOW, most_unknowns=400)


def test_resumed(comm, tmp_path):
    """A run that was interrupted continues from the last change of its mesh like one that was not;
    the crack of a monitor counts over all meshes."""
    folder = comm.bcast(tmp_path / "run")
    options = vmdg.SolveOptions(energy=True, checkpoint=folder)

    def follow(options, resume=False, end=1.0):
        cracks = []

        def watch(problem):
            if problem.t > end:
                raise ArithmeticError("no number")
            if not cracks:
                cracks.append(vmdg.CrackGrowth(problem, 0, start=CRACK))
            return opened(problem) | cracks[0](problem)

        return vmdg.solve_adaptively(
            makes(comm), LOADS, FINE, WINDOW, options, watch, resume=resume
        )

    whole = follow(ENERGY)
    with pytest.raises(ArithmeticError):
        follow(options, end=0.55)
    rest = follow(options, resume=True)
    assert len(rest.history) == len(whole.history)
    assert len(rest.results) < len(whole.results)
    for column in ("load", "force", "damage", "external", "crack"):
        assert rest.history[column] == pytest.approx(whole.history[column], rel=1e-6)
    # The zone has a constant length: what is spent is crack.
    crack, spent = whole.history["crack"], whole.history["damage"] / 0.2
    assert (np.diff(crack) > -1e-3).all()
    assert crack[-1] - crack[-8] == pytest.approx(spent[-1] - spent[-8], rel=0.05)
    assert (whole.history["resistance"][-8:] > 0.1).all()
    # Nothing is left to do.
    again = follow(options, resume=True)
    assert len(again.history) == len(whole.history) and not again.results
