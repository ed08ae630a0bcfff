"""The tangent with older bodies: right where they are linear, renewed where they are not."""

import numpy as np
import pytest
from dolfinx import fem
from support.problems import MATERIALS
from support.scenes import two_blocks

import vmdg
from vmdg.base.parallel import global_norm, global_sum
from vmdg.base.timers import timings, timings_since
from vmdg.solver.linear import GMRES_LU, LU
from vmdg.solver.tangent import MAX_LAG_ERROR, LaggedBulk

LAW = vmdg.Debonding(strength=50.0, critical_gap=0.2, friction=0.5)
TWO_CELLS = pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])


def opened(comm, cell, kinematics="finite"):
    """Two blocks pulled apart by .02 t and sheared by .04 t mm, with a dead load."""
    scene = two_blocks(comm, cell, 3)
    problem = vmdg.Problem(
        scene.mesh,
        scene.cell_tags,
        dict(enumerate(MATERIALS, start=1)),
        [vmdg.Interface(between=(1, 2), law=LAW)],
        kinematics=kinematics,
    )
    d = scene.mesh.geometry.dim
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(scene.facet_tags.find(2), lambda t: t * np.array([0.02, 0.04, 0.0][:d]))
    problem.body_force(np.array([1.0, 2.0, 3.0][:d]), tag=1)
    return problem


def move(problem, scale, seed):
    """Add a random displacement and assemble the residual there."""
    u = problem.u.x
    u.array[:] += scale * np.random.default_rng(seed).uniform(-1, 1, len(u.array))
    u.scatter_forward()
    problem.step.assemble_residual(1.0)


def error(problem, matrix, damage=True):
    """|A - K| / |K| in the Frobenius norm, K assembled anew."""
    new = problem.discretization.create_matrix()
    problem.discretization.assemble_tangent(new, damage)
    rest = matrix.copy()
    rest.axpy(-1.0, new)
    return rest.norm() / new.norm()


@TWO_CELLS
@pytest.mark.parametrize("damage", [True, False])
def test_linear_bodies_are_assembled_once(comm, cell, damage):
    """At small strain the kept part is right wherever the bodies go: the tangent is the new one."""
    problem = opened(comm, cell, "small")
    problem.step.begin(1.0, 1.0)
    matrix = problem.discretization.create_matrix()
    tangent, before = LaggedBulk(problem, matrix), timings()
    for seed in range(3):
        move(problem, 0.02, seed)
        tangent.assemble(damage)
        assert error(problem, matrix, damage) < 1e-14
    # Once, and three times to compare.
    assert [t.runs for t in timings_since(before) if t.name == "assemble tangent"] == [4]


@TWO_CELLS
def test_curved_bodies_are_assembled_again(comm, cell):
    """A strain that changes the stiffness makes the kept part stale, a small one does not."""
    problem = opened(comm, cell)
    problem.step.begin(1.0, 1.0)
    matrix = problem.discretization.create_matrix()
    tangent = LaggedBulk(problem, matrix)
    for scale, renewed in ((0.0, True), (1e-7, False), (0.02, True), (1e-7, False)):
        move(problem, scale, 1)
        tangent.assemble()
        assert (error(problem, matrix) == 0) == renewed
        assert error(problem, matrix) < MAX_LAG_ERROR


@TWO_CELLS
def test_bulk_forces(comm, cell):
    """Forces of the bodies are the derivative of their strain energy, interfaces and loads apart.

    Central differences with h = 1e-5 are exact to h^2 and to rounding over h.
    """
    problem = opened(comm, cell)
    problem.step.begin(1.0, 1.0)
    move(problem, 0.02, 3)
    u, h = problem.u.x, 1e-5
    forces, start = problem.discretization.bulk_forces(), u.array.copy()
    v = np.random.default_rng(comm.rank).uniform(-1, 1, len(u.array))
    direction = fem.Function(problem.space)
    direction.x.array[:] = v
    direction.x.scatter_forward()
    energies = []
    for sign in (1, -1):
        u.array[:] = start + sign * h * direction.x.array
        energies.append(global_sum(comm, problem.discretization.stored_energy()[0]))
    work = global_sum(comm, forces @ direction.x.array[: len(forces)])
    assert (energies[0] - energies[1]) / (2 * h) == pytest.approx(work, rel=1e-7)


@TWO_CELLS
def test_same_path(comm, cell):
    """Steps with kept bodies end where a direct solver ends with bodies of its own.

    They cost few corrections more.
    """
    ends, corrections, interface_alone = [], [], []
    for petsc in (LU, {**GMRES_LU, "ksp_rtol": 1e-8}):
        problem = opened(comm, cell)
        result = vmdg.solve(problem, np.linspace(0.1, 1.0, 10), vmdg.SolveOptions(petsc=petsc))
        ends.append(global_norm(comm, problem.u.x.array[: problem.discretization.owned]))
        corrections.append(result.history["iterations"].sum())
        runs = {timing.name: timing.runs for timing in result.timings}
        interface_alone.append(result.counts.tangents > runs["assemble tangent"])
    assert interface_alone == [False, True]
    assert ends[1] == pytest.approx(ends[0], rel=1e-8)
    assert corrections[1] <= 1.4 * corrections[0]
