"""Multigrid at interfaces: Krylov iterations are counted, on any number of ranks."""

from __future__ import annotations

import numpy as np
from parts.benchmark import iterations
from parts.delamination import plies
from support.budgets import over_budget
from support.problems import FRICTION, pressed
from support.scenes import everywhere, tag_cells, unit_box

import vmdg
from vmdg.base.parallel import global_max
from vmdg.base.timers import timings, timings_since
from vmdg.linear.ksp import CG_GAMG, GMRES_GAMG, automatic_options
from vmdg.linear.system import System


def solved(problem: vmdg.Problem, options: dict, times: int = 1, rtol: float = 1e-6):
    """Krylov iterations of systems at the present state, and runs of timers."""
    system, before = System(problem, options), timings()
    counts = [0]
    for _ in range(times):
        forces = np.ones_like(problem.step.assemble_residual())
        system.solve([forces], [0 * forces], rtol)
        counts.append(system.iterations)
    system.free()
    return np.diff(counts), {timing.name: timing.runs for timing in timings_since(before)}


def at_work(damage: bool, n: int = 10) -> vmdg.Problem:
    """The block of the benchmark, its interface tied, or damaged or sliding at every point."""
    return iterations.block("3D", damage, refine=n / 22)


def test_broken_as_tied():
    """An interface that is damaged or slides everywhere takes as many iterations as a tie."""
    tied, _ = solved(at_work(False), CG_GAMG)
    damaged, _ = solved(at_work(True), GMRES_GAMG)
    assert not over_budget("tied block", krylov=max(tied))
    assert not over_budget("damaged block", krylov=max(damaged))


def test_coarsened_once(comm):
    """Interpolation is made from the bodies where an interface can fail, once; a tie needs none."""
    _, runs = solved(pressed(comm, "hexahedron", FRICTION), GMRES_GAMG, times=3)
    assert runs["coarsen"] == 1
    assert runs["set up preconditioner"] == 1
    _, runs = solved(pressed(comm, "hexahedron", vmdg.Bonded()), CG_GAMG)
    assert "coarsen" not in runs


def test_factors_take_the_place_of_multigrid(comm):
    """What has not served is coarsened once more; until then one factorization does for all."""
    options = {**GMRES_GAMG, "pc_gamg_coarse_eq_limit": 50, "ksp_max_it": 1}
    counts, runs = solved(pressed(comm, "hexahedron", FRICTION), options, times=4, rtol=1e-10)
    assert runs["coarsen"] == 2
    assert runs["factorize"] == 1
    assert list(counts) == [1, 1, 1, 1]


def test_thin_arms():
    """Multigrid that is bad for the mesh is given up, and no row comes of inexact corrections."""
    arms = plies.Specimen(plies.T300, 40.0, fine=2.0, size=1.0, strength=35.0, columns=2)
    options = vmdg.SolveOptions(petsc=automatic_options(arms.problem, 0, 0)[0])
    result = vmdg.solve(arms.problem, [0.25, 1.2, 1.5], options)
    assert not over_budget("thin arms", result)
    assert result.counts.krylov < 120
    assert list(result.history["load"]) == [0.25, 1.2, 1.5]


def test_pieces_of_a_cell(comm):
    """Where every cell is a piece for itself nothing would be left to coarsen: as a tie."""
    mesh = unit_box(comm, "hexahedron", 6)
    everything = vmdg.Interface(facets=everywhere, law=FRICTION)
    body = {1: vmdg.NeoHookean(E=5000.0, nu=0.25)}
    problem = vmdg.Problem(mesh, tag_cells(mesh, {1: everywhere}), body, [everything])
    problem.dirichlet(lambda x: np.isclose(x[0], 0.0), 0.0)
    counts, runs = solved(problem, GMRES_GAMG)
    assert "coarsen" not in runs
    assert not over_budget("cells all apart", krylov=max(counts))


def test_bodies_stand_alone(comm):
    """Without interfaces that can fail a motion of one body pulls at no node of the other."""
    problem = at_work(True, 4)
    parts = problem.discretization
    matrix, owned = parts.create_matrix(), parts.space.dofmap.index_map.size_local
    x, y = matrix.createVecs()
    cells, height = parts.space.dofmap.list, parts.space.tabulate_dof_coordinates()[:, 2]
    upper = np.zeros(len(height), dtype=bool)
    upper[cells[height[cells].mean(axis=1) > 0.4]] = True
    upper = np.repeat(upper[:owned], 3)
    x.array[:] = upper
    pulls = []
    for failing in (True, False):
        parts.assemble_tangent(matrix, failing=failing)
        matrix.mult(x, y)
        pulls.append(global_max(comm, np.abs(y.array[~upper]).max(initial=0.0)))
    assert pulls[0] > 1.0
    assert pulls[1] == 0.0
