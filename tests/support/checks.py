"""What tests ask of a problem: integrals, values of all ranks, errors of the tangent."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

import vmdg
from vmdg.base.kernels import compile_form
from vmdg.base.parallel import global_sum

from .symbolic import SymbolicForm


def integral(comm: MPI.Comm, form: ufl.Form) -> float:
    """Value of a functional on all ranks."""
    return float(global_sum(comm, fem.assemble_scalar(compile_form(form, comm))))


def gather(comm: MPI.Comm, array: NDArray) -> NDArray:
    """Rows of all ranks, on every rank."""
    return np.concatenate(comm.allgather(np.asarray(array)))


def by_position(comm: MPI.Comm, points: NDArray, *values: NDArray) -> list[NDArray]:
    """Points of all ranks and their values, in an order that no partition can change."""
    points = gather(comm, points)
    # Positions of different partitions differ by rounding; points are much further apart.
    order = np.lexsort(np.round(points, 8).T)
    return [points[order], *(gather(comm, value)[order] for value in values)]


def global_norm(comm: MPI.Comm, values: NDArray) -> float:
    """Euclidean norm of a vector of which every rank has its own entries."""
    return float(np.sqrt(comm.allreduce(float(np.sum(values**2)))))


def multiply(matrix: PETSc.Mat, vector: NDArray) -> NDArray:
    """Matrix times a vector of owned entries."""
    x, y = matrix.createVecs()
    x.array[:] = vector
    matrix.mult(x, y)
    result = y.array.copy()
    x.destroy()
    y.destroy()
    return result


def in_frame(problem: vmdg.Problem) -> tuple[NDArray, NDArray, NDArray]:
    """R^T.T, R^T.zeta and Q at the points of all ranks, ordered by position."""
    state = problem.state[0]
    T, zeta = (
        np.einsum("pji,pj->pi", state.rotation, vector) for vector in (state.traction, state.gap)
    )
    _, T, zeta, Q = by_position(problem.comm, state.points, T, zeta, state.softening)
    return T, zeta, Q


def modes(problem):
    """Branches of the return maps of the current step, at all points of all ranks."""
    state = problem.state[0]
    problem.step.assemble_residual(hold=True)
    trial = problem.state[0].traction
    active = problem.discretization.active[0]
    r = active.stabilization.norm[active.quadrature.facet]
    update = active.law.return_map(trial, state.normal, state.gap, state.softening, r)
    return gather(problem.comm, update.mode)


def tangent_matrix(problem: vmdg.Problem, damage: bool = True, dt: float = 1.0) -> PETSc.Mat:
    """The assembled tangent at the current displacement."""
    problem.step.assemble_residual(dt)
    matrix = problem.discretization.create_matrix()
    problem.discretization.assemble_tangent(matrix, damage)
    return matrix


def directions(problem: vmdg.Problem, count: int = 3) -> Iterator[NDArray]:
    """Some random displacements, ghosts included, of unit size."""
    rng = np.random.default_rng(17 + problem.comm.rank)
    for _ in range(count):
        direction = fem.Function(problem.space)
        direction.x.array[:] = rng.uniform(-1, 1, len(direction.x.array))
        direction.x.scatter_forward()
        yield direction.x.array.copy()


def tangent_error(problem: vmdg.Problem, matrix: PETSc.Mat | None = None) -> float:
    """Largest |K.v - dR/dv| / |dR/dv| at the current displacement, for some rough v.

    Fourth-order differences: with e = 2e-5 their own error is below 1e-9; with 1e-4 it reaches 5e-7
    for stiff rubber in some of the directions, which follow the numbers of the dofs. Ends with the
    residual assembled at the displacement it started with.
    """
    matrix = matrix or tangent_matrix(problem)
    return product_error(problem, lambda v: multiply(matrix, v))


def product_error(
    problem: vmdg.Problem, product: Callable[[NDArray], NDArray], dt: float = 1.0
) -> float:
    """The same of products K.v of owned entries."""
    u = problem.u.x.array
    start = u.copy()
    worst, e = 0.0, 2e-5

    def residual_at(step, v):
        u[:] = start + step * v
        return problem.step.assemble_residual(dt).copy()

    along = list(directions(problem))
    # A product is that of the current state.
    products = [product(v[: problem.discretization.owned]) for v in along]
    for v, predicted in zip(along, products, strict=True):
        one = residual_at(e, v) - residual_at(-e, v)
        two = residual_at(2 * e, v) - residual_at(-2 * e, v)
        difference = (8 * one - two) / (12 * e)
        error = global_norm(problem.comm, predicted - difference)
        worst = max(worst, error / global_norm(problem.comm, difference))
    u[:] = start
    problem.step.assemble_residual(dt)
    return worst


def assert_residual_is_energy_derivative(problem: vmdg.Problem) -> None:
    """The residual equals d/du of the stored energies with zeta held, to rounding."""
    symbolic, parts = SymbolicForm(problem), problem.discretization
    eta = ufl.TestFunction(problem.space)
    derivative = ufl.derivative(symbolic.energy(), problem.u, eta)
    expected = fem.assemble_vector(symbolic.compile(derivative)).array[: parts.owned]
    found = parts.assemble_residual(None)
    scale = problem.comm.allreduce(np.abs(found).max(initial=0), op=MPI.MAX)
    assert scale > 10
    assert np.abs(expected - found).max(initial=0) < 1e-12 * scale
