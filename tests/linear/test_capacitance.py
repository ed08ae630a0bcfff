"""Systems at small strain by the capacitance matrix: the solutions of the assembled tangent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import eye_array
from support.budgets import over_budget
from support.problems import MATERIALS, displace, joined
from support.scenes import everywhere, tag_cells, two_blocks, unit_box

import vmdg
from vmdg.base.parallel import global_norm, global_sum
from vmdg.base.timers import timings, timings_since
from vmdg.linear.capacitance import MAX_DIRECT_GAPS, Capacitance, GapSystem
from vmdg.linear.ksp import LU
from vmdg.linear.system import AssembledSystem

LAW = vmdg.Debonding(strength=20.0, critical_gap=0.05, friction=0.4)
TWO_CELLS = pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])


def held(comm, cell: str, n: int = 4, law: vmdg.Law = LAW) -> vmdg.Problem:
    """Two blocks, both of their ends prescribed."""
    scene = two_blocks(comm, cell, n)
    problem = joined(scene, law, kinematics="small")
    for tag in (1, 2):
        problem.dirichlet(scene.facet_tags.find(tag), 0.0)
    problem.step.begin(1.0, 1.0)
    problem.step.assemble_residual()
    return problem


def rings(comm) -> vmdg.Problem:
    """A section of revolution of three rings, one interface tied and two that fail."""
    scene = unit_box(comm, "quadrilateral", 8)
    inner = (lambda x: x[0] > 0.25, lambda x: x[0] > 0.5, lambda x: x[0] > 0.75)
    tags = tag_cells(scene, {1: everywhere} | dict(enumerate(inner, start=2)))
    laws = {(1, 2): LAW, (2, 3): vmdg.Bonded(), (3, 4): LAW}
    problem = vmdg.Problem(
        scene,
        tags,
        {i: MATERIALS[i % 2] for i in (1, 2, 3, 4)},
        [vmdg.Interface(between=pair, law=law) for pair, law in laws.items()],
        kinematics="small",
        symmetry="axisymmetric",
    )
    problem.dirichlet(lambda x: np.isclose(x[0], 1), 0.0)
    problem.dirichlet(lambda x: np.isclose(x[0], 0), 0.0, "y")
    problem.step.begin(1.0, 1.0)
    problem.step.assemble_residual()
    return problem


def damage(problem: vmdg.Problem, share: float, factor: float = 1 / 1.02) -> None:
    """Give a share of the points compliances of about ``factor`` / r that are not symmetric."""
    rng = np.random.default_rng(3 + problem.comm.rank)
    for active in problem.discretization.active.values():
        if not active.law.inelastic:
            continue
        count, d = active.quadrature.normal.shape
        r = active.stabilization.norm[active.quadrature.facet]
        one, other = rng.uniform(-0.6, 0.6, (2, count, d))
        C = np.eye(d) - one[:, :, None] * other[:, None, :]
        C *= factor * (rng.random(count) < share)[:, None, None] / r[:, None, None]
        active.values = replace(active.values, compliance=C)


def assert_solves(problem, solver, rel: float = 1e-8, count: int = 2) -> None:
    """Displacements are those of the assembled tangent and LU."""
    rng, shape = (
        np.random.default_rng(11 + problem.comm.rank),
        (count, problem.discretization.owned),
    )
    forces, moved = rng.uniform(-1, 1, shape), rng.uniform(-1e-3, 1e-3, shape)
    assembled = AssembledSystem(problem, LU)
    expected = assembled.solve(forces, moved, 0.0)
    assembled.free()
    for du, other in zip(solver.solve(forces, moved, 0.0), expected, strict=True):
        assert global_norm(problem.comm, du - other) <= rel * global_norm(problem.comm, other)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
@TWO_CELLS
def test_random_damage(comm, cell, share):
    """Directly and iteratively, one and two right-hand sides at once."""
    problem = held(comm, cell)
    direct, iterative = Capacitance(problem), Capacitance(problem, max_direct=-1)
    for number in (1, 2):
        damage(problem, share)
        assert_solves(problem, direct, count=number)
        assert_solves(problem, iterative, count=number)
    assert direct.iterations == 0
    assert (iterative.iterations > 0) == (share > 0)
    assert not over_budget("systems of gaps", krylov=iterative.iterations)
    direct.free()
    iterative.free()


def test_several_interfaces(comm):
    """In axisymmetry, with a tie between: every interface has its place among the points."""
    problem = rings(comm)
    for max_direct in (MAX_DIRECT_GAPS, -1):
        solver = Capacitance(problem, max_direct)
        damage(problem, 0.5)
        assert_solves(problem, solver)
        solver.free()


@pytest.mark.parametrize(
    "law",
    [LAW, vmdg.ExponentialDebonding(strength=20.0, fracture_energy=0.5, friction=0.3)],
)
@TWO_CELLS
def test_return_maps(comm, cell, law):
    """With the compliances of laws, of points that are whole, soften, slide or have parted."""
    scene = two_blocks(comm, cell, 4)
    problem = joined(scene, law, kinematics="small")
    for tag in (1, 2):
        problem.dirichlet(scene.facet_tags.find(tag), 0.0)
    problem.step.begin(1.0, 1.0)
    solver = Capacitance(problem)
    for factor in (0.03, 0.3, -0.3):
        displace(problem, scene, factor)
        problem.step.assemble_residual()
        C = problem.discretization.active[0].values.compliance
        assert global_sum(comm, C.any(axis=(1, 2)).sum()) > 0
        assert_solves(problem, solver)
    solver.free()


def test_no_damage(comm):
    """Below the strength the dense matrix is never made, and a system takes one solve with K_0."""
    problem, before = held(comm, "quadrilateral"), timings()
    solver = Capacitance(problem)
    assert_solves(problem, solver)
    assert "flexibility at points" not in {timing.name for timing in timings_since(before)}
    solver.free()


def gap_system(n: int, max_direct: int) -> tuple[np.ndarray, GapSystem]:
    """S of random eigenvectors and eigenvalues from 1 to 2, and its system."""
    vectors, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(n, n)))
    S = (vectors * np.linspace(1, 2, n)) @ vectors.T
    S = (S + S.T) / 2
    return S, GapSystem(S, eye_array(n, format="csr"), np.ones(n), max_direct)


@pytest.mark.parametrize("max_direct", [MAX_DIRECT_GAPS, -1])
def test_almost_singular(max_direct):
    """Next to a limit point the solution has the digits that are left."""
    S, system = gap_system(20, max_direct)
    c = (1 + 1e-9) / 2
    t = np.random.default_rng(6).uniform(-1, 1, (20, 2))
    expected = np.linalg.solve(np.eye(20) - c * S, c * t)
    assert np.linalg.norm(expected) > 1e6 * np.linalg.norm(t)
    found = system.solve(np.tile(c * np.eye(2), (10, 1, 1)), c * t)
    assert np.linalg.norm(found - expected) < 1e-4 * np.linalg.norm(expected)


@pytest.mark.parametrize("max_direct", [MAX_DIRECT_GAPS, -1])
def test_singular(max_direct):
    """A singular system gives NaN, and the next one is solved."""
    n = 6
    system = GapSystem(np.eye(n), eye_array(n, format="csr"), np.ones(n), max_direct)
    t = np.arange(1.0, n + 1)[:, None]
    blocks = np.tile(np.eye(2), (3, 1, 1))
    assert np.isnan(system.solve(blocks, t)).all()
    assert system.solve(blocks / 2, t / 2) == pytest.approx(t)
