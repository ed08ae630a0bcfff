"""The zone at the interfaces: which dofs, the formula of its correction, and what it spares."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from support.problems import MATERIALS
from support.scenes import two_blocks

import vmdg
from vmdg.base.parallel import global_sum
from vmdg.base.timers import timings, timings_since
from vmdg.solver.linear import GMRES_LU, LU, LinearSolver, ZoneCorrection, interface_zone
from vmdg.solver.result import Counts

LAW = vmdg.Debonding(strength=20.0, critical_gap=0.2, friction=0.5)


def sheared(comm, cell: str, n: int, law: vmdg.Law = LAW, shear: float = 0.04) -> vmdg.Problem:
    """Two blocks pressed together by .01 t and sheared by .04 t mm, or more."""
    scene = two_blocks(comm, cell, n)
    interface = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(
        scene.mesh, scene.cell_tags, dict(enumerate(MATERIALS, start=1)), [interface]
    )
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    move = np.array([-0.01, shear, 0.0][: scene.mesh.geometry.dim])
    problem.dirichlet(scene.facet_tags.find(2), lambda t: t * move)
    return problem


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_zone_is_the_cells_at_the_interface(comm, cell):
    """Two layers of nodes on each side of x = 1, wherever the cells live; none if that is much."""
    n = 4
    problem = sheared(comm, cell, n)
    d = problem.mesh.geometry.dim
    zone = interface_zone(problem, share=0.9)
    x = problem.space.tabulate_dof_coordinates()[zone[::d] // d]
    assert np.abs(x[:, 0] - 1).max(initial=0.0) < 1.001 / n
    assert global_sum(comm, len(zone)) == 4 * (n + 1) ** (d - 1) * d
    assert interface_zone(problem, share=0.1) is None


def test_correction_formula(comm):
    """z = B.r, then the residual in the zone solved for, against dense matrices.

    B is the inverse of a diagonal, K is not symmetric; the zone is every third row.
    """
    n = 30
    rng = np.random.default_rng(5)
    dense = np.diag(rng.uniform(5, 6, n)) + rng.uniform(-0.5, 0.5, (n, n))
    matrix = PETSc.Mat().createAIJ((n, n), comm=comm)
    matrix.setUp()
    first, last = matrix.getOwnershipRange()
    for i in range(first, last):
        matrix.setValues(i, range(n), dense[i])
    matrix.assemble()
    kept = PETSc.PC().create(comm)
    kept.setOperators(matrix)
    kept.setType("jacobi")
    rows = np.arange(first, last)
    correction = ZoneCorrection(matrix, kept, np.flatnonzero(rows % 3 == 0).astype(np.int32))
    r, z = matrix.createVecs()
    right = rng.uniform(-1, 1, n)
    r.array[:] = right[first:last]
    for scale in (1.0, 2.0):  # the second time with new values
        zone = np.arange(0, n, 3)
        expected = right / np.diag(dense) / scale
        part = np.linalg.solve(
            scale * dense[np.ix_(zone, zone)], (right - scale * dense @ expected)[zone]
        )
        expected[zone] += part
        kept.setUp()
        correction.set_up()
        correction.apply(kept, r, z)
        assert z.array == pytest.approx(expected[first:last], abs=1e-13)
        matrix.scale(2.0)
        kept.setOperators(matrix)
    correction.free()


def test_fewer_iterations_with_old_factors(comm):
    """Factors made before the damage serve on; without the correction they need more iterations.

    Both find the same solution, to 1e-6 of it.
    """
    problem = sheared(comm, "quadrilateral", 8, shear=0.2)
    matrices = [problem.discretization.create_matrix() for _ in range(2)]
    problem.step.assemble_residual()
    problem.discretization.assemble_tangent(matrices[0])
    vmdg.solve(problem, np.linspace(0.25, 1.0, 4))
    problem.discretization.assemble_tangent(matrices[1])
    for matrix in matrices:
        matrix.zeroRowsColumnsLocal(problem.loading.owned_prescribed, 1.0)
    effort, ends = [], []
    for zone in (interface_zone(problem, share=0.9), None):
        matrix = matrices[0].copy()
        solver = LinearSolver(matrix, GMRES_LU, LU, zone)
        x, b = matrix.createVecs()
        b.set(1.0)
        before = timings()
        for state in matrices:
            state.copy(matrix)
            former = solver.iterations
            solver.solve(b, x, 1e-8)
        counts = Counts.from_timings(timings_since(before), solver.iterations)
        assert (counts.preconditioners, counts.factorizations) == (1, 0)
        effort.append(solver.iterations - former)
        ends.append(x.copy())
        solver.free()
    ends[1].axpy(-1.0, ends[0])
    assert ends[1].norm() < 1e-6 * ends[0].norm()
    assert effort[0] < 0.7 * effort[1]


def test_factors_of_nan_are_made_anew(comm):
    """A trial state with NaN, whose factorizations fail, does not spoil the solver."""
    problem = sheared(comm, "quadrilateral", 3)
    matrix = problem.discretization.create_matrix()
    problem.step.begin(0.1, 1.0)
    problem.step.assemble_residual(1.0)
    problem.discretization.assemble_tangent(matrix)
    matrix.shift(1.0)
    solver = LinearSolver(matrix, GMRES_LU, LU, interface_zone(problem, share=0.9))
    good = matrix.copy()
    x, b = matrix.createVecs()
    b.set(1.0)
    matrix.scale(np.nan)
    solver.solve(b, x, 1e-6)
    assert not np.isfinite(x.norm())
    good.copy(matrix)
    before = timings()
    solver.solve(b, x, 1e-6)
    assert np.isfinite(x.norm())
    assert Counts.from_timings(timings_since(before), 0).factorizations == 0
    solver.free()
