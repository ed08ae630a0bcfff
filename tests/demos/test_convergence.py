"""Rates of the tied interface against exact finite-strain solutions, coarse studies."""

from __future__ import annotations

from pathlib import Path

import convergence
import numpy as np
import pytest
import ufl
from dolfinx import fem
from parts.convergence import manufactured, rates

import vmdg
from vmdg import compat
from vmdg.base.kernels import compile_expression

MATERIALS = [vmdg.NeoHookean(E=E, nu=0.3) for E in (1e4, 10.0)]


@pytest.fixture(scope="module")
def rows(comm, tmp_path_factory):
    """The coarse table, and the folder of its results."""
    out = Path(comm.bcast(str(tmp_path_factory.mktemp("convergence"))))
    return convergence.main(coarse=True, out=str(out)), out


@pytest.mark.long
def test_rates(rows):
    """L2 rate >= k + .9, H1 and interface traction >= k - .1 in every study."""
    for row in rows[0]:
        for norm, target in rates.targets(row.study.degree).items():
            assert row.rates[norm] >= target, (row.study, norm, row.rates)


@pytest.mark.long
def test_straight_cells_along_a_curve(comm):
    """They limit degree 2 to order 2 in L2 and order 1 of the traction; degree 1 loses nothing."""

    def coarse_rates(degree):
        study = rates.Study(
            "quadrilateral", degree, "curved", contrast=10.0, straight_cells=True, levels=(8, 16)
        )
        return rates.Row(study, [rates.errors(study, n, comm) for n in (8, 16)]).rates

    first, second = coarse_rates(1), coarse_rates(2)
    assert all(first[norm] >= rate for norm, rate in rates.targets(1).items())
    assert 1.8 < second["l2"] < 2.5 and 0.8 < second["traction"] < 1.3


@pytest.mark.long
def test_results_are_stored(rows, comm):
    """Table, CSV with one line a mesh, picture."""
    comm.barrier()
    studies, out = rows
    text = (out / "convergence.md").read_text()
    assert text.count("| kinked |") == sum(r.study.solution == "kinked" for r in studies)
    lines = (out / "convergence.csv").read_text().splitlines()
    assert len(lines) == 1 + sum(len(row.levels) for row in studies)
    assert (out / "convergence.png").stat().st_size > 10_000


def evaluate(mesh, expression) -> tuple[np.ndarray, np.ndarray]:
    """Points (3, n) and values (d, n) of a vector expression in the cells of this rank."""
    d = mesh.geometry.dim
    space = fem.functionspace(mesh, ("DG", 2, (d,)))
    function = fem.Function(space)
    points = compat.interpolation_points(space)
    function.interpolate(compile_expression(expression, points, mesh.comm))
    return space.tabulate_dof_coordinates().T, function.x.array.reshape(-1, d).T


@pytest.mark.parametrize("shape", rates.SHAPES)
@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_kinked_solution_is_in_equilibrium(comm, cell, shape):
    """On a curved interface too: u_1 = u_2 and P_1.N = P_2.N = t, contrast 1000."""
    study = rates.Study(cell, 2, shape)
    mesh = study.mesh(2, comm).mesh
    level = study.level(mesh)
    exact = manufactured.kinked(mesh, MATERIALS, level)
    n = ufl.grad(level)
    normal = n / ufl.sqrt(ufl.dot(n, n))
    _, gap = evaluate(mesh, exact.u[0] - exact.u[1])
    on = np.isclose(evaluate(mesh, level * n)[1], 0, atol=1e-12).all(axis=0)
    assert comm.allreduce(int(on.sum())) > 0
    assert np.abs(gap[:, on]).max(initial=0) < 1e-12
    _, t = evaluate(mesh, exact.traction)
    for material, u in zip(MATERIALS, exact.u, strict=True):
        P = manufactured.stress(material, u)
        _, traction = evaluate(mesh, ufl.dot(P, normal))
        # Round-off of the stiff side's moduli.
        assert traction[:, on] == pytest.approx(t[:, on], abs=1e-11 * material.parameters["mu"])
