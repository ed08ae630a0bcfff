"""Steps condensed to the interface: its matrices, its solver, and the same results as without."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from support.checks import multiply
from support.problems import MATERIALS, joined
from support.scenes import everywhere, tag_cells, two_blocks, unit_box

import vmdg
from vmdg.solver.condensed_newton import CondensedNewton, backtrack, full_step, least_energy
from vmdg.solver.condensed_solver import CondensedSolver
from vmdg.solver.flexibility import Flexibility, Superposition
from vmdg.solver.gap_equation import Direction
from vmdg.solver.iteration import LoadStep
from vmdg.solver.newton import Newton

LAW = vmdg.Debonding(strength=20.0, critical_gap=0.05, friction=0.4)
ONE_RANK = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="condensed on one rank only")
TWO_CELLS = pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])


def sheared(comm, cell, n=3, law=LAW, **options) -> vmdg.Problem:
    """Two blocks pulled apart and sheared, then pressed: by .02, .04 and -.01 t mm."""
    scene = two_blocks(comm, cell, n)
    problem = joined(scene, law, kinematics="small", **options)
    d = scene.mesh.geometry.dim
    problem.dirichlet(scene.facet_tags.find(1), 0.0)

    def move(t):
        return np.array([0.02 * t if t < 0.6 else 0.012 - 0.06 * (t - 0.6), 0.04 * t, 0.0][:d])

    problem.dirichlet(scene.facet_tags.find(2), move)
    return problem


def run(problem, loads, condensed, **options):
    """Displacement, gap, softening, forces and energies at the end, and the result of the run."""
    options = {"relative_tolerance": 1e-11, "energy": True} | options
    result = vmdg.solve(problem, loads, vmdg.SolveOptions(condensed=condensed, **options))
    state = problem.state[0]
    energy = problem.energy()
    values = [problem.u.x.array.copy(), state.gap, state.traction, state.softening]
    values += [
        problem.discretization.forces.x.array.copy(),
        np.array([energy.stored, energy.external]),
    ]
    values += [np.array([row["damage"] for row in result.history.rows])]
    return values, result


def assert_same(first, second, rel=1e-8):
    """Arrays agree relative to their largest entries, or to .001 where all but vanish."""
    for one, other in zip(first, second, strict=True):
        assert np.abs(one - other).max() <= rel * max(np.abs(one).max(), 1e-3)


@ONE_RANK
@TWO_CELLS
def test_compliance_matrix(comm, cell):
    """W^-1.S by dense matrices: K of the general tangent, B by differences of trial tractions.

    The problem is linear with the gap held, so the differences are exact to rounding.
    """
    problem = sheared(comm, cell, 1)
    problem.step.begin(0.1, 1.0)
    matrix = problem.discretization.create_matrix()
    problem.discretization.assemble_tangent(matrix, damage=False)
    N = problem.discretization.owned
    K = np.column_stack([multiply(matrix, e) for e in np.eye(N)])
    active = problem.discretization.active[0]

    def trial(u):
        problem.u.x.array[:] = u
        problem.step.assemble_residual(hold=True)
        return active.values.traction.ravel().copy()

    B = np.column_stack([trial(e) - trial(np.zeros(N)) for e in np.eye(N)])
    free = np.setdiff1d(np.arange(N), problem.loading.prescribed)
    flexibility = Flexibility(problem)
    W = np.repeat(active.quadrature.weights, problem.mesh.geometry.dim)
    expected = B[:, free] @ np.linalg.solve(K[np.ix_(free, free)], B[:, free].T * W)
    gap = np.random.default_rng(1).uniform(-1, 1, len(W))
    assert flexibility.response(gap) == pytest.approx(expected @ gap, rel=1e-10)
    assert flexibility.gap_forces(gap)[free] == pytest.approx(B[:, free].T @ (W * gap), rel=1e-10)
    u = np.random.default_rng(2).uniform(-1, 1, N)
    assert flexibility.tractions(u) == pytest.approx(B @ u, rel=1e-10)
    flexibility.destroy()


@ONE_RANK
@pytest.mark.parametrize("damaged", [0.0, 2 / 3, 1.0])
@TWO_CELLS
def test_solver(comm, cell, damaged):
    """Directly, iteratively in few steps and in double precision: the solution of the dense system.

    What is refined once has a residual of 1e-8 at most.
    """
    problem = sheared(comm, cell, 4)
    d = problem.mesh.geometry.dim
    flexibility = Flexibility(problem)
    n, W = flexibility.size, flexibility.areas
    r = problem.stabilization[0].norm.min()
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(n // d, d))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    C = (
        (rng.random(n // d) < damaged)[:, None, None]
        * (np.eye(d) - 0.5 * normals[:, :, None] * normals[:, None, :])
        / (1.02 * r)
    )
    right = rng.uniform(-1, 1, n)
    stiffness = (flexibility.matrix / W[:, None]).reshape(-1, d, n)
    dense = np.eye(n) - np.einsum("pij,pjm->pim", C, stiffness).reshape(n, n)
    expected = np.linalg.solve(dense, right)

    def assert_solves(solver, rel):
        value, response = solver.solve(C, right)
        assert np.linalg.norm(value - expected) <= rel * np.linalg.norm(expected)
        assert response == pytest.approx(flexibility.response(value), rel=1e-9, abs=1e-9)

    solver = CondensedSolver(flexibility)
    assert_solves(solver, 1e-9)
    assert solver.iterations == 0
    solver = CondensedSolver(flexibility, max_direct=-1, max_iterations=12)
    assert_solves(solver, 1e-6)
    assert (solver.iterations > 0) == (damaged > 0)
    # Where one iteration is not enough.
    assert_solves(CondensedSolver(flexibility, max_direct=-1, max_iterations=1), 1e-2)
    flexibility.destroy()


@ONE_RANK
def test_almost_singular_system(comm):
    """Where single precision has no digits left the solution is still that of the dense system."""
    problem = sheared(comm, "quadrilateral", 2)
    flexibility = Flexibility(problem)
    stiffness = flexibility.matrix / flexibility.areas[:, None]
    largest = np.linalg.eigvals(stiffness).real.max()
    C = np.tile(np.eye(2) * (1 + 1e-9) / largest, (flexibility.size // 2, 1, 1))
    right = np.random.default_rng(5).uniform(-1, 1, flexibility.size)
    expected = np.linalg.solve(np.eye(len(right)) - C[0, 0, 0] * stiffness, right)
    value, _ = CondensedSolver(flexibility).solve(C, right)
    assert np.linalg.norm(expected) > 1e6 * np.linalg.norm(right)
    assert np.linalg.norm(value - expected) < 1e-4 * np.linalg.norm(expected)
    flexibility.destroy()


def test_superposition():
    """Combinations of loads that were solved for need no solve; small rests are left out."""
    rng = np.random.default_rng(4)
    inverse, solved = np.diag(rng.uniform(1, 2, 5)), []

    def solve(forces):
        solved.append(forces)
        return inverse @ forces

    respond = Superposition(solve)
    first, second, noise = np.eye(5)[0] + np.eye(5)[1], np.eye(5)[1], 1e-9 * np.eye(5)[4]
    for forces in (first, second, 2 * first - 3 * second, first + noise):
        assert respond(forces, 1e-8) == pytest.approx(inverse @ forces, rel=1e-12, abs=3e-9)
    assert len(solved) == 2
    assert respond(first + noise, 1e-12) == pytest.approx(inverse @ (first + noise), rel=1e-12)
    assert len(solved) == 3


class Line:
    """A gap equation of one unknown with a given residual, to watch line searches."""

    def __init__(self, residual):
        self._residual, self.lengths = residual, []

    def along(self, start, direction, length):
        self.lengths.append(length)
        return _State(self._residual(length))

    def work(self, state, direction):
        return -state.residual


class _State:
    def __init__(self, residual):
        self.residual, self.norm = residual, abs(residual)


DIRECTION = Direction(np.ones(1), np.ones(1))


def test_backtracking():
    """Steps are halved until the residual falls, eight times at most; NaN does not fall."""
    line = Line(lambda x: 0.9 if x < 0.3 else np.nan)
    assert backtrack(line, _State(1.0), DIRECTION).residual == 0.9
    assert line.lengths == [1.0, 0.5, 0.25]
    line = Line(lambda x: 1.0)
    backtrack(line, _State(1.0), DIRECTION)
    assert line.lengths == [0.5**k for k in range(9)]
    line = Line(lambda x: 7.0)
    assert full_step(line, _State(1.0), DIRECTION).residual == 7.0


def test_least_energy():
    """The secant finds where a linear residual does no work, as PETSc's search for 1 - 4 x."""
    line = Line(lambda x: 1 - 4 * x)
    assert least_energy(line, _State(1.0), DIRECTION).residual == 0
    assert line.lengths == [1.0, 0.25]
    line = Line(lambda x: 1 - 0.5 * x)
    assert least_energy(line, _State(1.0), DIRECTION).residual == 0
    assert line.lengths == [1.0, 2.0]


LAWS = {
    "friction": LAW,
    "viscous": vmdg.Debonding(strength=20.0, critical_gap=0.05, viscosity=10.0),
    "exponential": vmdg.ExponentialDebonding(strength=20.0, fracture_energy=0.5, friction=0.3),
    "contact": vmdg.Contact(friction=0.3),
}


@ONE_RANK
@pytest.mark.parametrize("law", LAWS)
def test_same_path(comm, law):
    """Every law ends where the general iteration ends, with the same history on the way.

    One extrapolates gaps and the other displacements: that may cost or spare a correction.
    """
    loads = np.linspace(0.1, 1.0, 10)
    general, off = run(sheared(comm, "quadrilateral", law=LAWS[law]), loads, False)
    condensed, on = run(sheared(comm, "quadrilateral", law=LAWS[law]), loads, True)
    assert_same(general, condensed)
    assert np.array_equal(off.history["load"], on.history["load"])
    assert np.abs(off.history["iterations"] - on.history["iterations"]).max() <= 1


@ONE_RANK
@pytest.mark.parametrize("cell", ["triangle", "tetrahedron", "hexahedron"])
def test_same_path_on_cells(comm, cell):
    """Other cells, degree 2 on triangles, with a body force."""
    loads, ends = np.linspace(0.2, 1.0, 5), []
    for condensed in (False, True):
        problem = sheared(comm, cell, 2, degree=2 if cell == "triangle" else 1)
        d = problem.mesh.geometry.dim
        problem.body_force(np.arange(1.0, d + 1), tag=1)
        ends.append(run(problem, loads, condensed)[0])
    assert_same(*ends)


@ONE_RANK
def test_same_corrections(comm):
    """Newton's corrections are those of the whole problem: the residual norms of a step agree.

    Both start with the gaps held; rounding of norms that fall to 1e-9 leaves 1e-6 of them.
    """
    norms = []
    for kind in (Newton, CondensedNewton):
        problem = sheared(comm, "quadrilateral", 4)
        arguments = (problem, 1e-9, 20) + ((None,) if kind is Newton else ())
        newton = kind(*arguments)
        problem.step.begin(0.5, 1.0)
        report = newton.step(LoadStep(0.5), 1.0, predictor="elastic")
        assert report.converged
        norms.append([norm for norm in report.norms if norm > 1e-6 * report.norms[0]])
        newton.destroy()
    assert len(norms[0]) >= 3
    assert norms[1] == pytest.approx(norms[0], rel=1e-6)


@ONE_RANK
def test_bodies_out_of_balance(comm):
    """What the condensed state misses shows in the residual of the whole, and is made good."""
    loads = np.linspace(0.25, 1.0, 4)
    expected, _ = run(sheared(comm, "quadrilateral"), loads, False)
    problem = sheared(comm, "quadrilateral")
    # No load is ever solved for before the step.
    newton = CondensedNewton(problem, 1e-11, 20, negligible=1e15)
    for t in loads:
        problem.step.begin(t, 1.0)
        assert newton.step(LoadStep(t), 1.0).converged
        problem.step.commit()
    newton.destroy()
    state = problem.state[0]
    assert_same(expected[:4], [problem.u.x.array, state.gap, state.traction, state.softening])


@ONE_RANK
def test_same_jump(comm):
    """A bond that snaps back is carried over by a jump to the same state.

    What viscosity and friction take on the way depends on the steps of the jump.
    """
    law = vmdg.Debonding(strength=60.0, critical_gap=0.02)
    ends = []
    for condensed in (False, True):
        scene = two_blocks(comm, "quadrilateral", 3)
        problem = joined(scene, law, kinematics="small")
        problem.dirichlet(scene.facet_tags.find(1), 0.0)
        problem.dirichlet(scene.facet_tags.find(2), lambda t: np.array([t, 0.3 * t]))
        values, result = run(problem, np.linspace(0.005, 0.06, 12), condensed)
        assert result.history["jump_steps"].sum() > 0
        ends.append(values[:6])
    assert_same(*ends)


@ONE_RANK
def test_continues_the_other(comm, out):
    """A run may go on from a checkpoint with the other iteration."""
    loads = np.linspace(0.1, 1.0, 10)
    expected, _ = run(sheared(comm, "quadrilateral"), loads, False)
    run(sheared(comm, "quadrilateral"), loads[:5], True, checkpoint=out)
    problem = sheared(comm, "quadrilateral")
    vmdg.read_checkpoint(problem, out)
    found, _ = run(problem, loads[5:], False)
    assert_same(expected[:6], found[:6])


@ONE_RANK
def test_elastic_steps_need_no_flexibility(comm):
    """Below the strength a step takes no correction and the dense matrix is never made."""
    problem = sheared(comm, "hexahedron")
    result = vmdg.solve(problem, [1e-3, 2e-3], vmdg.SolveOptions(condensed=True))
    assert not result.history["iterations"].any()
    assert not any(timing.name == "flexibility at points" for timing in result.timings)


@ONE_RANK
def test_eigenstrain(comm):
    """Bodies that swell push and shear the interface before any load does."""
    ends = []
    for condensed in (False, True):
        problem = sheared(comm, "quadrilateral", eigenstrain={2: lambda t: 0.01 * t})
        ends.append(run(problem, np.linspace(0.25, 1.0, 4), condensed)[0])
    assert ends[0][1].any()
    assert_same(*ends)


@ONE_RANK
def test_axisymmetric_with_a_tie(comm):
    """A section of revolution, one interface tied and one that fails: the same path."""
    ends = []
    for condensed in (False, True):
        scene = unit_box(comm, "quadrilateral", 6)
        tags = tag_cells(
            scene, {1: everywhere, 2: lambda x: x[0] > 1 / 3, 3: lambda x: x[0] > 2 / 3}
        )
        problem = vmdg.Problem(
            scene,
            tags,
            {1: MATERIALS[0], 2: MATERIALS[1], 3: MATERIALS[0]},
            [
                vmdg.Interface(between=(2, 3), law=vmdg.Bonded()),
                vmdg.Interface(between=(1, 2), law=LAW),
            ],
            kinematics="small",
            symmetry="axisymmetric",
        )
        problem.dirichlet(lambda x: np.isclose(x[0], 1), 0.0)
        problem.dirichlet(lambda x: np.isclose(x[0], 0), lambda t: 0.05 * t, "y")
        values, _ = run(problem, np.linspace(0.2, 1.0, 5), condensed)
        ends.append([*values, problem.state[1].gap, problem.state[1].softening])
    assert ends[0][-1].max() > 0
    assert_same(*ends)
