"""Where a mesh is too coarse: estimated against true errors."""

from __future__ import annotations

import numpy as np
import pytest
from support import arms

import vmdg
from vmdg.meshes import blocks
from vmdg.output.values import facet_scalar, open_facets


def blocks_under_weight(comm, cell: str, n: int, degree: int) -> vmdg.Problem:
    """Two tied blocks under body forces that vary, one face held."""
    mesh, cells, facets = blocks(comm, cell, (n, n))
    bodies = {1: vmdg.NeoHookean(E=1000.0, nu=0.3), 2: vmdg.NeoHookean(E=2000.0, nu=0.3)}
    tie = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
    problem = vmdg.Problem(mesh, cells, bodies, [tie], degree=degree, kinematics="small")
    problem.dirichlet(facets.find(1), 0.0)
    problem.body_force(lambda x, t: t * np.array([np.sin(3 * x[1]), np.cos(2 * x[0])]))
    vmdg.solve(problem, [1.0])
    return problem


def total(problem: vmdg.Problem) -> float:
    """The root of the sum of the squares of all cells."""
    share, space = problem.indicator().x.array, problem.indicator().function_space
    owned = share[: space.dofmap.index_map.size_local]
    return float(np.sqrt(problem.comm.allreduce(owned @ owned)))


@pytest.mark.parametrize(
    ("cell", "degree"), (("triangle", 1), ("quadrilateral", 1), ("triangle", 2))
)
def test_effectivity(comm, cell, degree):
    """True error over estimate within a factor of two, with a much finer mesh as the truth.

    At equilibrium under dead loads the energy lost by a mesh is half the square of the error."""
    problem, truth = (blocks_under_weight(comm, cell, n, degree) for n in (6, 24))
    energies = [one.energy().stored for one in (problem, truth)]
    error = np.sqrt(abs(energies[1] - energies[0]) / energies[1])
    assert 0.5 < error / total(problem) < 2


def test_uniform_strain(comm):
    """No error where the elements have the solution."""
    mesh, cells, facets = blocks(comm, "tetrahedron", (2, 2, 2))
    body = vmdg.NeoHookean(E=1000.0, nu=0.3)
    tie = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
    problem = vmdg.Problem(mesh, cells, {1: body, 2: body}, [tie])
    assert not problem.indicator().x.array.any()
    for side, axis in ((1, "x"), (4, "y"), (6, "z")):
        problem.dirichlet(facets.find(side), 0.0, axis)
    problem.dirichlet(facets.find(2), lambda t: t, "x")
    vmdg.solve(problem, [0.1])
    assert total(problem) < 1e-8


def test_bond(comm):
    """The largest fine scale of a facet over the critical gap, on the facets of the tip."""
    bond = vmdg.Debonding(strength=20.0, critical_gap=0.02)
    problem = arms.bent_apart(comm, 24.0, (12, 3), bond)[0]
    vmdg.solve(problem, [0.3])
    state, found = problem.state[0], problem.indicator(0)
    sizes = np.linalg.norm(problem.fine_scale(0), axis=2).max(axis=1) / 0.02
    for facet, value in zip(open_facets(state), found, strict=True):
        assert value == pytest.approx(sizes[state.facet == facet].max(), rel=1e-12)
    assert facet_scalar(problem, 0, "indicator") == pytest.approx(found, rel=1e-12)
    most = max(problem.comm.allgather(found.max(initial=0.0)))
    assert most > 1e-3
    worst = state.points[np.isin(state.facet, open_facets(state)[found == most]), 0]
    assert (abs(worst - arms.CRACK) < 4).all()


def test_no_bond(comm):
    with pytest.raises(ValueError, match="has no bond, and no critical gap"):
        blocks_under_weight(comm, "triangle", 2, 1).indicator(0)
