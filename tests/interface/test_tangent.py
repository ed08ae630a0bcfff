"""The tangent is the derivative of the residual that is assembled, damage included."""

from __future__ import annotations

from petsc4py import PETSc

import pytest
from support.checks import directions, global_norm, modes, multiply, tangent_error, tangent_matrix
from support.problems import displace, joined, partly_damaged
from support.scenes import CELLS_BY_TURNS, two_blocks

import vmdg
from vmdg import Mode
from vmdg.assembly.point_matrices import add_fields, add_tangent
from vmdg.points.jets import FacetJets


@CELLS_BY_TURNS
def test_active_damage(comm, cell, degree):
    """Some points in tension, some elastic: K is the derivative through the return maps."""
    problem = partly_damaged(comm, cell, degree)
    matrix = tangent_matrix(problem)
    assert tangent_error(problem, matrix) < 1e-7
    assert matrix.isSymmetric(1e-12 * matrix.norm())
    active = modes(problem)
    assert set(active) == {Mode.ELASTIC, Mode.TENSION}
    # The products in C are those of matrices B of all points.
    (part,) = problem.discretization.active.values()
    D, w = part.tangent()[0], FacetJets.displacement
    found, expected = (problem.discretization.create_matrix() for _ in range(2))
    add_tangent(found, part, D)
    add_fields(expected, part, D, w, w)
    for one in (found, expected):
        one.assemble()
    found.axpy(-1.0, expected, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    assert found.norm() < 1e-14 * expected.norm()
    # Damage matters: without its part the tangent is another one.
    problem.step.assemble_residual()
    held = problem.discretization.create_matrix()
    problem.discretization.assemble_tangent(held, damage=False)
    du = next(directions(problem))[: held.getLocalSize()[0]]
    with_damage, without = multiply(matrix, du), multiply(held, du)
    assert global_norm(comm, with_damage - without) > 1e-3 * global_norm(comm, without)


@CELLS_BY_TURNS
def test_tied_interface(comm, cell, degree):
    """The tie has the tensor tau_s in residual and tangent."""
    scene = two_blocks(comm, cell, distortion=0.05)
    problem = joined(scene, vmdg.Bonded(), degree=degree)
    displace(problem, scene, 1.0)
    matrix = tangent_matrix(problem)
    assert tangent_error(problem, matrix) < 1e-7
    assert matrix.isSymmetric(1e-12 * matrix.norm())


@pytest.mark.parametrize("law", [vmdg.Bonded(), vmdg.Debonding(1e5, 1e3)], ids=["tie", "law"])
def test_small_strain(comm, law):
    """kinematics="small": the residual is linear in u, and K is its matrix."""
    scene = two_blocks(comm, "quadrilateral", distortion=0.05)
    problem = joined(scene, law, kinematics="small")
    rest = problem.step.assemble_residual().copy()
    displace(problem, scene, 1.0)
    matrix = tangent_matrix(problem)
    residual = problem.step.assemble_residual().copy()
    product = multiply(matrix, problem.u.x.array[: len(residual)])
    # Linear: no difference quotient is needed, so only rounding separates the two.
    assert global_norm(comm, rest) < 1e-12 * global_norm(comm, residual)
    assert global_norm(comm, product - residual) < 1e-12 * global_norm(comm, residual)
