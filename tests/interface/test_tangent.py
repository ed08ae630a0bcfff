"""The tangent is the derivative of the residual that is assembled, damage included."""

from __future__ import annotations

from petsc4py import PETSc

import pytest
import ufl
from dolfinx.fem import petsc as fem_petsc
from support.checks import directions, global_norm, modes, multiply, tangent_error, tangent_matrix
from support.problems import displace, joined, partly_damaged
from support.scenes import CELLS_BY_TURNS, two_blocks
from support.symbolic import SymbolicForm

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


def symbolic_damage(problem, du):
    """-Tt(eta).C.Tt(du) of (84), Tt the symbolic derivative of {P.N} + r g, C from the law."""
    active, d = problem.discretization.active[0], problem.mesh.geometry.dim
    symbolic = SymbolicForm(problem)
    (oracle,) = symbolic.interfaces
    ((_, bodies),) = oracle.pairs
    q, r = active.quadrature, active.stabilization.norm
    problem.step.assemble_residual(hold=True)
    state = problem.state[0]
    update = active.law.return_map(
        state.traction, state.normal, state.gap, state.softening, r[q.facet]
    )
    C = oracle.field(update.tangent)
    delta, tau = (oracle.field(x[q.facet]) for x in (active.stabilization.delta[:, 0], r))
    N, one = ufl.FacetNormal(problem.mesh)("+"), ufl.Identity(d)
    tractions = []
    for body, side in zip(bodies, ("+", "-"), strict=True):
        F = ufl.variable(one + ufl.grad(problem.u)(side))
        tractions.append(ufl.dot(ufl.diff(body(side).energy(F), F), N))
    mean = ufl.dot(delta, tractions[0]) + ufl.dot(one - delta, tractions[1])
    total = mean + tau * (problem.u("-") - problem.u("+"))
    eta = ufl.TestFunction(problem.space)
    by_eta, by_du = (ufl.derivative(total, problem.u, w) for w in (eta, du))
    return -ufl.dot(by_eta, ufl.dot(C, by_du)) * oracle.measure(0), symbolic


@pytest.mark.parametrize(("cell", "degree"), [("triangle", 1), ("quadrilateral", 2)])
def test_tangent_is_the_symbolic_one(comm, cell, degree):
    """Made at the points or by ufl.derivative of the residual: the same matrix to round-off.

    In 2D only: the symbolic kernels of 3D take minutes to compile.
    """
    problem = partly_damaged(comm, cell, degree)
    du = ufl.TrialFunction(problem.space)

    def assembled(form, of):
        matrix = fem_petsc.assemble_matrix(of.compile(form))
        matrix.assemble()
        return matrix

    # Before the residual, which sets zeta: a coefficient of the second form only.
    damage_part = assembled(*symbolic_damage(problem, du))
    problem.step.assemble_residual()
    form = SymbolicForm(problem)
    whole = form.residual(ufl.TestFunction(problem.space))
    symbolic = assembled(ufl.derivative(whole, problem.u, du), form)
    for damage in (False, True):
        found = problem.discretization.create_matrix()
        problem.discretization.assemble_tangent(found, damage)
        if damage:
            assert damage_part.norm() > 1e-3 * symbolic.norm()
            symbolic.axpy(1.0, damage_part, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        found.axpy(-1.0, symbolic, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        assert found.norm() < 1e-13 * symbolic.norm()
