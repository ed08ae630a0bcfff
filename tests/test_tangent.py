"""The staged tangent is the derivative of the residual that is assembled, damage included."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from scenes import (
    CELLS,
    DIMENSION,
    EVERY_CELL,
    EVERY_DEGREE,
    gather,
    global_norm,
    joined,
    multiply,
    set_displacement,
    two_blocks,
)

import vmdg
from vmdg import Mode
from vmdg.kernels import compile_form

STRETCH = np.array([[0.06, 0.03, -0.02], [0.02, -0.03, 0.04], [-0.03, 0.02, 0.05]])
PUSH = np.array([0.03, 0.008, -0.006])
DIRECTIONS = 3


def displace(problem, scene, factor: float) -> None:
    """A rough deformation of both blocks, and side 2 away from side 1, more so at the top."""
    d = problem.mesh.geometry.dim

    def field(x, tag):
        u = factor * STRETCH[:d, :d] @ x[:d] + 0.01 * np.sin(3 * x[:d][::-1] + tag)
        if tag == 2:
            u += factor * np.outer(PUSH[:d], x[:d].sum(axis=0))
        return u

    set_displacement(problem.u, scene.cell_tags, field)


def trial_tractions(problem) -> np.ndarray:
    """|T_tr| at all points of all ranks, ascending."""
    problem.assemble_residual(hold=True)
    return np.sort(np.linalg.norm(gather(problem.comm, problem.state[0].traction), axis=1))


def partly_damaged(comm, cell: str, degree: int, **options):
    """Second step of a state in which some points were damaged and go on, and others are whole."""
    options["degree"] = degree
    scene = two_blocks(comm, cell, n=2 if DIMENSION[cell] == 2 else 1, distortion=0.05)
    fixed = {"safety": 4.0}  # the probe must have the r of the problem, whose H is another
    probe = joined(
        scene, vmdg.Debonding(strength=1e5, critical_gap=1e3), interface=fixed, **options
    )
    displace(probe, scene, 1.0)
    sizes = trial_tractions(probe)
    # Strength inside the widest gap between two points, near its upper end: no point is at a
    # switch, and the second step, a little further, turns no whole point into a damaged one.
    widest = np.argmax(np.diff(sizes))
    strength = sizes[widest] + 0.8 * (sizes[widest + 1] - sizes[widest])
    # H = 1000 MPa/mm, below every r here; no point is near separation at these openings.
    law = vmdg.Debonding(strength=strength, critical_gap=strength / 1000.0)
    problem = joined(scene, law, interface=fixed, **options)
    problem.begin_step(1.0, 1.0)
    displace(problem, scene, 1.0)
    problem.assemble_residual()
    problem.commit()
    problem.begin_step(2.0, 1.0)
    displace(problem, scene, 1.02)
    return problem


def tangent_matrix(problem, damage=True):
    """The assembled tangent at the current displacement."""
    problem.assemble_residual()
    matrix = problem.create_matrix()
    problem.assemble_tangent(matrix, damage)
    return matrix


def directions(problem):
    """Some random displacements, ghosts included, of unit size."""
    rng = np.random.default_rng(17 + problem.comm.rank)
    for _ in range(DIRECTIONS):
        direction = fem.Function(problem.space)
        direction.x.array[:] = rng.uniform(-1, 1, len(direction.x.array))
        direction.x.scatter_forward()
        yield direction.x.array.copy()


def finite_difference_error(problem, matrix) -> float:
    """Largest relative difference of K.du from central differences of the residual.

    Fourth-order differences: with e = 2e-5 their own error is below 1e-9; with 1e-4 it reaches 5e-7
    for stiff rubber in some of the directions, which follow the numbers of the dofs.
    """
    u = problem.u.x.array
    start = u.copy()
    owned = len(problem.assemble_residual())
    worst, e = 0.0, 2e-5

    def residual_at(step, du):
        u[:] = start + step * du
        return problem.assemble_residual().copy()

    for du in directions(problem):
        one = residual_at(e, du) - residual_at(-e, du)
        two = residual_at(2 * e, du) - residual_at(-2 * e, du)
        difference = (8 * one - two) / (12 * e)
        product = multiply(matrix, du[:owned])
        error = global_norm(problem.comm, product - difference)
        worst = max(worst, error / global_norm(problem.comm, difference))
    u[:] = start
    return worst


def modes(problem):
    """Branches of the return maps of the current step, at all points of all ranks."""
    state = problem.state[0]
    problem.assemble_residual(hold=True)
    trial = problem.state[0].traction
    coupling = problem.couplings[0]
    r = coupling.stabilization.norm[coupling.quadrature.facet]
    update = coupling.law.return_map(trial, state.normal, state.gap, state.softening, r)
    return gather(problem.comm, update.mode)


@EVERY_CELL
@EVERY_DEGREE
def test_elastic_interface(comm, cell, degree):
    """No point yields: K is the derivative of (27) with zeta held, and symmetric."""
    scene = two_blocks(comm, cell, distortion=0.05)
    problem = joined(scene, vmdg.Debonding(strength=1e5, critical_gap=1e3), degree=degree)
    displace(problem, scene, 1.0)
    matrix = tangent_matrix(problem)
    assert finite_difference_error(problem, matrix) < 1e-7
    assert matrix.isSymmetric(1e-12 * matrix.norm())
    assert (modes(problem) == Mode.ELASTIC).all()


@EVERY_CELL
@EVERY_DEGREE
def test_active_damage(comm, cell, degree):
    """Some points in tension, some elastic: K is the derivative through the return maps."""
    problem = partly_damaged(comm, cell, degree)
    matrix = tangent_matrix(problem)
    assert finite_difference_error(problem, matrix) < 1e-7
    assert matrix.isSymmetric(1e-12 * matrix.norm())
    active = modes(problem)
    assert set(active) == {Mode.ELASTIC, Mode.TENSION}
    # Damage matters: without its part the tangent is another one.
    problem.assemble_residual()
    held = problem.create_matrix()
    problem.assemble_tangent(held, damage=False)
    du = next(directions(problem))[: held.getLocalSize()[0]]
    with_damage, without = multiply(matrix, du), multiply(held, du)
    assert global_norm(comm, with_damage - without) > 1e-3 * global_norm(comm, without)


@EVERY_CELL
@EVERY_DEGREE
def test_tied_interface(comm, cell, degree):
    """The tie has the tensor tau_s in residual and tangent."""
    scene = two_blocks(comm, cell, distortion=0.05)
    problem = joined(scene, vmdg.Bonded(), degree=degree)
    displace(problem, scene, 1.0)
    matrix = tangent_matrix(problem)
    assert finite_difference_error(problem, matrix) < 1e-7
    assert matrix.isSymmetric(1e-12 * matrix.norm())


@pytest.mark.parametrize("law", [vmdg.Bonded(), vmdg.Debonding(1e5, 1e3)], ids=["tie", "law"])
def test_small_strain(comm, law):
    """kinematics="small": the residual is linear in u, and K is its matrix."""
    scene = two_blocks(comm, "quadrilateral", distortion=0.05)
    problem = joined(scene, law, kinematics="small")
    rest = problem.assemble_residual().copy()
    displace(problem, scene, 1.0)
    matrix = tangent_matrix(problem)
    residual = problem.assemble_residual().copy()
    product = multiply(matrix, problem.u.x.array[: len(residual)])
    # Linear: no difference quotient is needed, so only rounding separates the two.
    assert global_norm(comm, rest) < 1e-12 * global_norm(comm, residual)
    assert global_norm(comm, product - residual) < 1e-12 * global_norm(comm, residual)


def symbolic_damage(problem, du):
    """-Tt(eta).C.Tt(du) of (84), Tt the symbolic derivative of {P.N} + r g, C from the law."""
    coupling, d = problem.couplings[0], problem.mesh.geometry.dim
    (group,) = coupling.groups
    q, r = coupling.quadrature, coupling.stabilization.norm
    problem.assemble_residual(hold=True)
    state = problem.state[0]
    update = coupling.law.return_map(
        state.traction, state.normal, state.gap, state.softening, r[q.facet]
    )
    C = fem.Function(q.space((d, d)))
    C.x.array[:] = update.tangent.ravel()
    delta, tau = fem.Function(q.facet_space((d, d))), fem.Function(q.facet_space(()))
    q.set_facet_values(delta, coupling.stabilization.delta[:, 0])
    q.set_facet_values(tau, r)
    N, one = ufl.FacetNormal(problem.mesh)("+"), ufl.Identity(d)
    tractions = []
    for body, side in zip(group.bodies, ("+", "-"), strict=True):
        F = ufl.variable(one + ufl.grad(problem.u)(side))
        tractions.append(ufl.dot(ufl.diff(body(side).energy(F), F), N))
    mean = ufl.dot(delta("+"), tractions[0]) + ufl.dot(one - delta("+"), tractions[1])
    total = mean + tau("+") * (problem.u("-") - problem.u("+"))
    eta = ufl.TestFunction(problem.space)
    by_eta, by_du = (ufl.derivative(total, problem.u, w) for w in (eta, du))
    rows = coupling.facets.rows(np.ones(len(coupling.facets.facets), dtype=bool))
    dS = ufl.Measure(
        "dS",
        domain=problem.mesh,
        subdomain_data=[(0, rows)],
        metadata={"quadrature_degree": q.degree},
    )
    return -ufl.dot(by_eta, ufl.dot(C("+"), by_du)) * dS(0)


@pytest.mark.parametrize("cell", [cell for cell in CELLS if DIMENSION[cell] == 2])
@EVERY_DEGREE
def test_staged_tangent_is_the_symbolic_one(comm, cell, degree):
    """Staged or by ufl.derivative of the symbolic residual: the same matrix to round-off.

    In 2D only: the symbolic kernels of 3D take minutes to compile, which is why there are stages.
    """
    problem = partly_damaged(comm, cell, degree)
    du = ufl.TrialFunction(problem.space)
    submeshes = problem.couplings[0].submeshes

    def assembled(form):
        matrix = fem_petsc.assemble_matrix(compile_form(form, submeshes, comm))
        matrix.assemble()
        return matrix

    # Before the residual, which sets zeta: a coefficient of the second form only.
    damage_part = assembled(symbolic_damage(problem, du))
    problem.assemble_residual()
    symbolic = assembled(ufl.derivative(problem.residual_ufl(), problem.u, du))
    for damage in (False, True):
        staged = problem.create_matrix()
        problem.assemble_tangent(staged, damage)
        if damage:
            assert damage_part.norm() > 1e-3 * symbolic.norm()
            symbolic.axpy(1.0, damage_part, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        staged.axpy(-1.0, symbolic, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        assert staged.norm() < 1e-13 * symbolic.norm()
