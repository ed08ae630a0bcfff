"""Linear solvers: which is chosen, the way back, and that all of them end at the same solution."""

from __future__ import annotations

import warnings

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from support.budgets import over_budget
from support.problems import FRICTION, pressed, pulled
from support.scenes import two_blocks

import vmdg
from vmdg.base.timers import timings, timings_since
from vmdg.linear.ksp import (
    CG_GAMG,
    FACTORIZATION,
    FEW,
    GMRES,
    GMRES_GAMG,
    GMRES_LDLT,
    GMRES_LU,
    LDLT,
    LU,
    MAX_RTOL,
    MIN_RTOL,
    SWEEPS,
    LinearSolver,
    automatic_options,
    destroy,
    linear_tolerance,
    make_ksp,
)
from vmdg.solver.result import Counts

SMOOTH = vmdg.Debonding(strength=50.0, critical_gap=0.2)
#: No friction, but no potential either.
WEIGHTED = vmdg.IntrinsicExponential(strength=50.0, fracture_energy=10.0)


#: Bounds for which a problem is small, medium or large.
SMALL, MEDIUM, LARGE = (10**9, 10**9), (0, 10**9), (0, 0)


@pytest.mark.parametrize(
    ("cell", "law", "sizes", "chosen"),
    [
        ("quadrilateral", FRICTION, SMALL, LU),
        ("quadrilateral", SMOOTH, SMALL, LDLT),
        ("quadrilateral", WEIGHTED, SMALL, LU),
        ("quadrilateral", FRICTION, LARGE, LU),
        ("quadrilateral", SMOOTH, LARGE, LDLT),
        ("hexahedron", FRICTION, SMALL, LU),
        ("hexahedron", SMOOTH, SMALL, LDLT),
        ("hexahedron", FRICTION, MEDIUM, GMRES_LU),
        ("hexahedron", SMOOTH, MEDIUM, GMRES_LDLT),
        ("hexahedron", WEIGHTED, MEDIUM, GMRES_LU),
        ("hexahedron", FRICTION, LARGE, GMRES_GAMG | FEW),
        ("hexahedron", SMOOTH, LARGE, GMRES_GAMG | FEW),
        ("hexahedron", vmdg.Bonded(), LARGE, CG_GAMG | FEW),
    ],
)
def test_choice(comm, cell, law, sizes, chosen):
    """Direct in 2D and if small, with lagged factors if medium, multigrid for large problems in 3D;
    symmetric where the law is."""
    options, fallback = automatic_options(pressed(comm, cell, law), *sizes)
    assert options == chosen
    assert fallback == (LDLT if law.symmetric else LU)


def test_choice_where_bodies_flow(comm):
    """Sweeps smooth; a tie of plastic bodies has no symmetric tangent, for which CG would fail."""
    scene, metal = two_blocks(comm, "hexahedron", 2), vmdg.J2(1000.0, 0.3, 5.0, hardening=50.0)
    for law, krylov in ((vmdg.Bonded(), GMRES_GAMG), (None, CG_GAMG)):
        bonds = [] if law is None else [vmdg.Interface(between=(1, 2), law=law)]
        problem = vmdg.Problem(scene.mesh, scene.cell_tags, {1: metal, 2: metal}, bonds, degree=2)
        assert automatic_options(problem, *LARGE)[0] == krylov | SWEEPS | FEW


def tangent_asymmetry(comm, law: vmdg.Law, opening: float = -0.01) -> float:
    """|K x - K^T x| / |K x| for a random x, after a step that damages and slides."""
    problem = pressed(comm, "hexahedron", law, 2, opening)
    vmdg.solve(problem, [0.5, 1.0])
    matrix = problem.discretization.create_matrix()
    problem.discretization.assemble_tangent(matrix)
    x, once, transposed = (matrix.createVecRight() for _ in range(3))
    x.array[:] = np.random.default_rng(0).uniform(-1, 1, x.getLocalSize())
    matrix.mult(x, once)
    matrix.multTranspose(x, transposed)
    size = once.norm()
    once.axpy(-1.0, transposed)
    return once.norm() / size


def test_symmetric_without_friction(comm):
    """The tangent of a law with a potential is symmetric, its turning frame included."""
    weak = {"strength": 10.0, "critical_gap": 0.02}
    assert tangent_asymmetry(comm, vmdg.Debonding(**weak)) < 1e-13
    assert tangent_asymmetry(comm, vmdg.Debonding(**weak, friction=0.5)) > 1e-4
    assert tangent_asymmetry(comm, WEIGHTED, opening=0.01) > 1e-4


def test_quadratic_without_symmetry(comm):
    """Damage grows in all steps of a law without potential, and none takes many corrections."""
    problem = pressed(comm, "quadrilateral", WEIGHTED, opening=0.02)
    result = vmdg.solve(problem, np.linspace(0.1, 1.0, 10))
    assert not result.failures
    assert not over_budget("law without potential", result)


@pytest.mark.parametrize(
    "law",
    [FRICTION, pytest.param(SMOOTH, marks=pytest.mark.long), vmdg.Bonded()],
    ids=["mu", "smooth", "tie"],
)
def test_solvers_agree(comm, law):
    """Direct, lagged factors, multigrid and fallback end at the same displacement.

    All meet the residual tolerance of 1e-9, which leaves 1e-8 of the displacement.
    """
    ends = []
    one_iteration = {"ksp_max_it": 1, "ksp_rtol": 1e-12}
    levels = {"pc_gamg_coarse_eq_limit": 50}
    for sizes, more in ((SMALL, {}), (MEDIUM, {}), (LARGE, {}), (LARGE, one_iteration)):
        problem = pressed(comm, "hexahedron", law)
        petsc = automatic_options(problem, *sizes)[0] | more
        petsc |= levels if sizes == LARGE else {}
        result = vmdg.solve(problem, [0.5, 1.0], vmdg.SolveOptions(max_iterations=20, petsc=petsc))
        assert not result.failures
        counts = result.counts
        assert counts.solves > 0
        assert (counts.krylov > 0) == (sizes != SMALL)
        assert (counts.factorizations > 0) == (sizes == SMALL or more != {})
        if sizes != SMALL and not more:
            assert 0 < counts.preconditioners < counts.solves
        ends.append(problem.u.x.array.copy())
    for end in ends[1:]:
        assert np.abs(end - ends[0]).max() < 1e-8


def test_options_have_two_names():
    """``petsc_options`` is ``petsc``; both together are one too many, and all go by name."""
    assert vmdg.SolveOptions(petsc_options=LU) == vmdg.SolveOptions(petsc=LU)
    assert vmdg.SolveOptions(petsc_options=LU).petsc == LU
    with pytest.raises(ValueError, match="petsc and petsc_options are the same"):
        vmdg.SolveOptions(petsc=LU, petsc_options=LU)
    with pytest.raises(TypeError, match="SolveOptions: give the arguments by name"):
        vmdg.SolveOptions(1e-9)


def test_options_that_nothing_uses(comm):
    """Misspelt ones, and those of levels that a direct solver does not have, are named, once a run.

    Those of factors, which are made in the first solve, and of the line search are known.
    """
    petsc = {**LU, "ksp_rtoll": 1e-8, "snes_linesearch_typ": "basic", "mg_levels_pc_type": "sor"}
    problem = pressed(comm, "quadrilateral", FRICTION)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        vmdg.solve(problem, [0.5, 1.0], vmdg.SolveOptions(petsc=petsc))
    told = [str(one.message) for one in caught if one.category is vmdg.ModelWarning]
    found = [text.partition(" among")[0].partition(" use ")[2] for text in told]
    expected = ["ksp_rtoll, mg_levels_pc_type", "snes_linesearch_typ"]
    assert found == (expected if comm.rank == 0 else [])


#: Options that PETSc refuses, and what is said of them.
REFUSED = {
    "ksp_type": ("gmress", "Unable to find .* gmress. Did you mean 'gmres' or"),
    "pc_type": ("gamgg", "Unable to find .* gamgg. Did you mean 'gamg' or"),
    "pc_factor_mat_solver_type": ("mumpss", "Could not locate .* mumpss .* Did you mean 'mumps'"),
    "mg_levels_ksp_type": ("chebychev", "Unable to find .* chebychev. Did you mean 'chebyshev'"),
    "ksp_rtol": ("small", "Input string small has no numeric value"),
    "ksp_pc_side": ("middle", "Available options: left right"),
    "snes_type": ("newtonlss", "Unable to find .* newtonlss. Did you mean 'newtonls' or"),
    "snes_linesearch_type": ("btt", "Unable to find .* btt"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_options_that_petsc_refuses(comm, name):
    """Named with their value, on every rank."""
    value, message = REFUSED[name]
    petsc = {**(GMRES_GAMG if name.startswith("mg") else GMRES_LU), name: value}
    problem = pressed(comm, "quadrilateral", FRICTION)
    with pytest.raises(ValueError, match=f"^SolveOptions: petsc: {name} = '{value}': .*{message}"):
        vmdg.solve(problem, [0.5, 1.0], vmdg.SolveOptions(petsc=petsc))


def tridiagonal(diagonal: float) -> PETSc.Mat:
    """100 x 100 with the off-diagonals -1 and 2; ILU factorizes it exactly."""
    matrix = PETSc.Mat().createAIJ(100, nnz=3, comm=MPI.COMM_SELF)
    for i in range(100):
        for j, value in ((i - 1, -1.0), (i, diagonal), (i + 1, 2.0)):
            if 0 <= j < 100:
                matrix.setValue(i, j, value)
    matrix.assemble()
    return matrix


def test_stale_preconditioner_is_renewed():
    """Where an old preconditioner does not do a fresh one is tried before a direct solve."""
    options = {"ksp_type": "gmres", "ksp_max_it": 5, "ksp_rtol": 1e-12, "pc_type": "ilu"}
    matrix = tridiagonal(4.0)
    solver, before = LinearSolver(matrix, options, LU), timings()
    x, b = matrix.createVecs()
    b.set(1.0)
    solver.solve(b, x, 1e-6)
    tridiagonal(1.5).copy(matrix)
    solver.solve(b, x, 1e-6)
    counts = Counts.from_timings(timings_since(before), solver.iterations)
    assert (counts.preconditioners, counts.factorizations) == (2, 0)
    matrix.mult(x, b)
    assert b.array == pytest.approx(np.ones(100), abs=1e-9)


def test_old_preconditioner_is_given_up():
    """One that takes as many iterations more as a fresh one costs: a fresh one takes over."""
    iterations = []
    for factors in (4.0, 0.5):
        matrix = tridiagonal(factors)
        solver = LinearSolver(matrix, {**LU, **GMRES}, LU)
        x, b = matrix.createVecs()
        b.set(1.0)
        solver.solve(b, x, 1e-6)
        tridiagonal(0.5).copy(matrix)
        x.set(0.0)
        before = solver.iterations
        solver.solve(b, x, 1e-6)
        iterations.append(solver.iterations - before)
        matrix.mult(x, b)
        assert b.array == pytest.approx(np.ones(100), abs=1e-4)
    assert iterations[1] == 1
    assert FACTORIZATION < iterations[0] <= FACTORIZATION + 6 + 1


def test_old_preconditioner_that_serves_is_kept():
    """As many iterations a digit as a fresh one takes are no reason for another, however often."""
    matrix, before = tridiagonal(4.0), timings()
    solver = LinearSolver(matrix, {**GMRES, "pc_type": "jacobi"}, LU)
    x, b = matrix.createVecs()
    b.set(1.0)
    for _ in range(8):
        x.set(0.0)
        solver.solve(b, x, 1e-8)
    assert solver.iterations > 2 * FACTORIZATION
    counts = Counts.from_timings(timings_since(before), solver.iterations)
    assert (counts.preconditioners, counts.factorizations) == (1, 0)


def test_stability_is_known_of_the_last_matrix():
    """Factors are those of one matrix: others than it are not known to be unstable, and no system
    with it is tried by the Krylov method that did not serve."""
    options = {**GMRES, "ksp_max_it": 2, "pc_type": "jacobi"}
    matrix = tridiagonal(4.0)
    matrix.setValue(0, 0, -4.0)
    matrix.assemble()
    solver, before = LinearSolver(matrix, options, LU), timings()
    x, b = matrix.createVecs()
    b.set(1.0)
    solver.solve(b, x, 1e-6)
    assert solver.unstable
    iterations = solver.iterations
    b.set(2.0)
    solver.solve(b, x, 1e-6)
    assert solver.iterations == iterations
    tridiagonal(1e9).copy(matrix)
    x.set(0.0)
    solver.solve(b, x, 1e-6)
    assert not solver.unstable
    assert Counts.from_timings(timings_since(before), solver.iterations).factorizations == 1


def test_options_of_what_is_made_later():
    """Factors and smoothers of multigrid take their options too, and all are gone at the end."""
    matrix = tridiagonal(4.0)
    direct = make_ksp(matrix, {**LU, "mat_mumps_icntl_14": 77})
    levels = {"mg_levels_ksp_type": "richardson", "mg_levels_pc_type": "sor"}
    coarsened = {"pc_gamg_coarse_eq_limit": 10, **levels}
    multigrid = make_ksp(matrix, {"pc_type": "gamg", **coarsened})
    for solver in (direct, multigrid):
        solver.setUp()
    assert direct.getPC().getFactorMatrix().getMumpsIcntl(14) == 77
    assert multigrid.getPC().getMGLevels() > 1
    smoother = multigrid.getPC().getMGSmoother(1)
    assert (smoother.getType(), smoother.getPC().getType()) == ("richardson", "sor")
    prefixes = [solver.getOptionsPrefix() for solver in (direct, multigrid)]
    assert prefixes[0] != prefixes[1]
    for solver in (direct, multigrid):
        destroy(solver)
    assert not any(name.startswith(tuple(prefixes)) for name in PETSc.Options().getAll())


@pytest.mark.parametrize("options", [LU, GMRES_LU], ids=["direct", "lagged"])
def test_factors_after_a_failure(options):
    """MUMPS does no more after a factorization that failed: it is made anew."""
    matrix = tridiagonal(4.0)
    solver = LinearSolver(matrix, options, LU)
    x, b = matrix.createVecs()
    b.set(1.0)
    tridiagonal(np.nan).copy(matrix)
    solver.solve(b, x, 1e-6)
    assert not np.isfinite(x.array).any()
    tridiagonal(4.0).copy(matrix)
    solver.solve(b, x, 1e-6)
    matrix.mult(x, b)
    assert b.array == pytest.approx(np.ones(100), abs=1e-12)


def test_linear_tolerance():
    """Looser while the residual falls slowly, never more exact than the step still needs."""
    assert linear_tolerance([1.0, 0.9], 1e-12) == MAX_RTOL
    assert linear_tolerance([1.0, 1e-4], 1e-12) == MIN_RTOL
    assert linear_tolerance([1.0], 0.9) == MAX_RTOL


def test_linear_tolerance_ends_the_step():
    """A correction that may end the step is made to: not by how far a Krylov method overshoots."""
    for size in np.geomspace(1e-9, 1.0, 91):
        left = linear_tolerance([1.0, size], 1e-6) * size
        assert left <= 0.03e-6 * (1 + 1e-9) or left >= 30e-6 * (1 - 1e-9)


@pytest.mark.parametrize("option", [{"mat_mumps_icntl_23": 1}, {"mat_mumps_icntl_14": -90}])
def test_out_of_memory(comm, option):
    """It is named, with what MUMPS says; the problem is in its last state."""
    problem = pulled(comm, vmdg.Debonding(strength=10.0, critical_gap=0.1), 60)
    with pytest.raises(MemoryError, match=r"14884 unknowns ran out of memory \(MUMPS: INFOG\(1\)"):
        vmdg.solve(problem, [0.01], vmdg.SolveOptions(petsc=LU | option))
    assert problem.t == 0 and not problem.u.x.array.any()
