"""The zone at the interfaces: which dofs, the formula of its correction, and what it spares."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from support.problems import MATERIALS
from support.scenes import two_blocks

import vmdg
from vmdg.base.parallel import global_norm, global_sum
from vmdg.solver import linear as linear_solver
from vmdg.solver.linear import LU, ZoneCorrection, interface_zone
from vmdg.solver.newton import Newton

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
def test_zone_is_the_cells_at_the_interface(comm, monkeypatch, cell):
    """Two layers of nodes on each side of x = 1, wherever the cells live; none if that is much."""
    n = 4
    problem = sheared(comm, cell, n)
    d = problem.mesh.geometry.dim
    monkeypatch.setattr(linear_solver, "ZONE", 0.9)
    zone = interface_zone(problem)
    x = problem.space.tabulate_dof_coordinates()[zone[::d] // d]
    assert np.abs(x[:, 0] - 1).max(initial=0.0) < 1.001 / n
    assert global_sum(comm, len(zone)) == 4 * (n + 1) ** (d - 1) * d
    monkeypatch.setattr(linear_solver, "ZONE", 0.1)
    assert interface_zone(problem) is None


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


def test_fewer_iterations_with_old_factors(comm, monkeypatch):
    """Factors made before the damage serve on; without the correction they need more iterations.

    Both end at the same displacement: the residual tolerance of 1e-9 leaves 1e-8.
    """
    monkeypatch.setattr(linear_solver, "MEDIUM", 0)
    monkeypatch.setattr(linear_solver, "SETUP", 10**9)
    effort, ends = [], []
    for share in (0.9, 0.0):
        monkeypatch.setattr(linear_solver, "ZONE", share)
        problem = sheared(comm, "quadrilateral", 12, shear=0.2)
        newton = Newton(problem, 1e-9, 20, None)
        for t in np.linspace(0.25, 1.0, 4):
            problem.begin_step(t, 1.0)
            assert newton.step(1.0).converged
            problem.commit()
        counts = newton.linear.counts
        assert counts.setups == 1
        effort.append(counts.iterations / counts.solves)
        ends.append(global_norm(comm, problem.u.x.array[: problem.discretization.owned]))
        newton.destroy()
    assert ends[1] == pytest.approx(ends[0], rel=1e-8)
    assert effort[0] < 0.7 * effort[1]


def test_own_options_are_left_alone(comm, monkeypatch):
    """Neither a user's own solver nor a tied scene is corrected in a zone."""

    def unwanted(problem):
        raise AssertionError("no zone is needed")

    monkeypatch.setattr("vmdg.solver.newton.interface_zone", unwanted)
    own = {"ksp_type": "gmres", "pc_type": "jacobi"}
    Newton(sheared(comm, "quadrilateral", 2), 1e-9, 20, own).destroy()
    monkeypatch.setattr(linear_solver, "MEDIUM", 0)
    Newton(sheared(comm, "quadrilateral", 2, vmdg.Bonded()), 1e-9, 20, None).destroy()


def test_factors_of_nan_are_made_anew(comm, monkeypatch):
    """A trial state with NaN, whose factorizations fail, does not spoil the solver."""
    monkeypatch.setattr(linear_solver, "MEDIUM", 0)
    monkeypatch.setattr(linear_solver, "ZONE", 0.9)
    problem = sheared(comm, "quadrilateral", 3)
    newton = Newton(problem, 1e-9, 20, None)
    matrix, outer = problem.create_matrix(), PETSc.KSP().create(comm)
    problem.begin_step(0.1, 1.0)
    problem.assemble_residual(1.0)
    problem.assemble_tangent(matrix)
    matrix.shift(1.0)
    solver = linear_solver.LinearSolver(matrix, linear_solver.GMRES_LU, LU, interface_zone(problem))
    good = matrix.copy()
    x, b = matrix.createVecs()
    b.set(1.0)
    matrix.scale(np.nan)
    solver.solve(outer, b, x)
    assert outer.getConvergedReason() < 0
    good.copy(matrix)
    fallbacks = solver.counts.fallbacks
    solver.solve(outer, b, x)
    assert outer.getConvergedReason() > 0
    assert solver.counts.fallbacks == fallbacks
    solver.free()
    newton.destroy()
