"""Linear systems of both kinds, assembled and condensed to the interface: the same path."""

from __future__ import annotations

import numpy as np
import pytest
from support.problems import MATERIALS, couple, joined, pressed
from support.scenes import everywhere, tag_cells, two_blocks, unit_box

import vmdg
from vmdg.base.parallel import global_max, global_norm
from vmdg.linear.capacitance import Capacitance
from vmdg.linear.system import AssembledSystem

LAW = vmdg.Debonding(strength=20.0, critical_gap=0.05, friction=0.4)
LAWS = {
    "friction": LAW,
    "viscous": vmdg.Debonding(strength=20.0, critical_gap=0.05, viscosity=10.0),
    "exponential": vmdg.ExponentialDebonding(strength=20.0, fracture_energy=0.5, friction=0.3),
    "contact": vmdg.Contact(friction=0.3),
}
TEN, FIVE = np.linspace(0.1, 1.0, 10), np.linspace(0.2, 1.0, 5)


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
    """Displacement, gaps, tractions, softening and forces at the end, and the run."""
    options = {"relative_tolerance": 1e-11, "energy": True} | options
    result = vmdg.solve(problem, loads, vmdg.SolveOptions(condensed=condensed, **options))
    values = [problem.u.x.array.copy(), problem.discretization.forces.x.array.copy()]
    for i in problem.discretization.active:
        state = problem.state[i]
        values += [state.gap, state.traction, state.softening]
    values += [np.array([row[name] for row in result.history.rows]) for name in ("load", "damage")]
    return values, result


def assert_same(comm, first, second, rel=1e-9):
    """Arrays agree relative to their largest entries, or to .01 where all but vanish.

    Where blocks have parted a traction is the rounding of r times the gap, some 1e-12 MPa.
    """
    for one, other in zip(first, second, strict=True):
        size = global_max(comm, np.abs(one).max(initial=1e-2))
        assert global_max(comm, np.abs(one - other).max(initial=0.0)) <= rel * size


def assert_same_path(comm, make, loads, most=1) -> tuple[vmdg.Result, vmdg.Result]:
    """Problems end in the same state with both systems, the bodies factorized ``most`` times."""
    assembled, off = run(make(), loads, False)
    condensed, on = run(make(), loads, True)
    assert_same(comm, assembled, condensed)
    assert 1 <= on.counts.factorizations <= most
    assert on.counts.condensed > 0
    assert off.counts.condensed == 0
    return off, on


@pytest.mark.parametrize("law", LAWS)
def test_same_path(comm, law):
    """For every law, with the same corrections but for one where the goal is just met.

    Contact that opens is left out of the bodies' factors, and taken in where it closes.
    """
    make, most = lambda: sheared(comm, "quadrilateral", law=LAWS[law]), 3 if law == "contact" else 1
    off, on = assert_same_path(comm, make, TEN, most)
    assert np.abs(off.history["iterations"] - on.history["iterations"]).max() <= 1


@pytest.mark.parametrize("cell", ["triangle", "tetrahedron", "hexahedron"])
def test_same_path_on_cells(comm, cell):
    """Other cells, degree 2 on triangles, with a body force."""

    def make():
        problem = sheared(comm, cell, 2, degree=2 if cell == "triangle" else 1)
        d = problem.mesh.geometry.dim
        problem.body_force(np.arange(1.0, d + 1), tag=1)
        return problem

    assert_same_path(comm, make, FIVE)


@pytest.mark.parametrize("unstable", ["jump", "trace"])
def test_same_snap(comm, unstable):
    """A bond that snaps back is carried over, or followed, to the same states."""
    law = vmdg.Debonding(strength=60.0, critical_gap=0.02)

    def make():
        scene = two_blocks(comm, "quadrilateral", 3)
        problem = joined(scene, law, kinematics="small")
        problem.dirichlet(scene.facet_tags.find(1), 0.0)
        problem.dirichlet(scene.facet_tags.find(2), lambda t: np.array([t, 0.3 * t]))
        return problem

    ends = []
    for condensed in (False, True):
        values, result = run(make(), np.linspace(0.005, 0.06, 12), condensed, unstable=unstable)
        ends.append((values[:-2], result))
    assert_same(comm, ends[0][0], ends[1][0])
    snaps = [
        result.history["jump_steps"].sum() or (np.diff(result.history["load"]) < 0).sum()
        for _, result in ends
    ]
    assert min(snaps) > 0


def test_same_axisymmetric_with_a_tie(comm):
    """A section of revolution, one interface tied and one that fails."""

    def make():
        scene = unit_box(comm, "quadrilateral", 6)
        third = {1: everywhere, 2: lambda x: x[0] > 1 / 3, 3: lambda x: x[0] > 2 / 3}
        tie = vmdg.Interface(between=(2, 3), law=vmdg.Bonded())
        problem = vmdg.Problem(
            scene,
            tag_cells(scene, third),
            {1: MATERIALS[0], 2: MATERIALS[1], 3: MATERIALS[0]},
            [tie, vmdg.Interface(between=(1, 2), law=LAW)],
            kinematics="small",
            symmetry="axisymmetric",
        )
        problem.dirichlet(lambda x: np.isclose(x[0], 1), 0.0)
        problem.dirichlet(lambda x: np.isclose(x[0], 0), lambda t: 0.05 * t, "y")
        return problem

    assert_same_path(comm, make, FIVE)


def test_continues_the_other(comm, out):
    """A run may go on from a checkpoint with the other systems."""
    expected, _ = run(sheared(comm, "quadrilateral"), TEN, False)
    run(sheared(comm, "quadrilateral"), TEN[:5], True, checkpoint=out)
    problem = sheared(comm, "quadrilateral")
    vmdg.read_checkpoint(problem, out)
    found, _ = run(problem, TEN[5:], False)
    assert_same(comm, expected[:-2], found[:-2])


def test_elastic_steps_need_no_flexibility(comm):
    """Below the strength a step takes no correction and the dense matrix is never made."""
    problem = sheared(comm, "hexahedron")
    result = vmdg.solve(problem, [1e-3, 2e-3], vmdg.SolveOptions(condensed=True))
    assert not result.history["iterations"].any()
    assert result.counts.condensed == 0
    assert not any(timing.name == "flexibility at points" for timing in result.timings)


def test_last_tangent_again(comm):
    """A last tangent serves where the state has changed, with the motion of a rigid face and all
    right-hand sides but the first."""
    scene = two_blocks(comm, "quadrilateral", 3)
    problem = couple(scene, LAW, MATERIALS)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.rigid_face(scene.facet_tags.find(2), "y", force=lambda t: 5.0 * t)
    system = AssembledSystem(problem, None)
    forces = 1.0 + problem.step.assemble_residual()
    nothing = np.zeros_like(forces)
    first = system.solve([forces, 2 * forces], [nothing, nothing], 1e-10)
    problem.u.x.array[:] = 0.02 * np.sin(np.arange(len(problem.u.x.array)))
    problem.step.assemble_residual()
    system.lags = True
    again = system.solve([3 * forces, nothing], [nothing, nothing], 1e-10)
    assert_same(comm, [3 * first[0], first[1]], again, rel=1e-12)
    system.lags = False
    fresh = system.solve([3 * forces], [nothing], 1e-10)[0]
    assert global_max(comm, np.abs(fresh - again[0]).max(initial=0.0)) > 1e-3
    system.free()


def test_steps_end_with_the_last_tangent(comm):
    """Where one more correction with the last tangent ends a step, it has none of its own."""
    ends, spared = [], []
    for tolerance in (1e-8, 1e-12):
        problem = pressed(comm, "quadrilateral", LAWS["viscous"], opening=0.02)
        result = vmdg.solve(problem, FIVE, vmdg.SolveOptions(relative_tolerance=tolerance))
        assert not result.failures
        spared.append(result.counts.solves - result.counts.tangents)
        ends.append(problem.u.x.array.copy())
    assert spared[0] >= 4 > 1 >= spared[1]
    assert_same(comm, ends[:1], ends[1:], rel=1e-8)


@pytest.mark.parametrize("condensed", [False, True])
def test_product(comm, condensed):
    """K.du of the solution is the right-hand side on free dofs, with faces, supports and damage."""
    problem = sheared(comm, "quadrilateral")
    vmdg.solve(problem, [0.4, 0.8])
    system = Capacitance(problem) if condensed else AssembledSystem(problem, None)
    forces = np.sin(np.arange(problem.discretization.owned, dtype=float))
    moved = np.cos(np.arange(problem.discretization.owned, dtype=float))
    (du,) = system.solve([forces], [moved], 1e-12)
    free = np.setdiff1d(np.arange(len(forces)), problem.loading.owned_prescribed)
    off = np.abs(system.product(du) - forces)[free].max(initial=0.0)
    system.free()
    assert global_max(comm, off) < 1e-9 * global_max(comm, np.abs(forces).max(initial=0.0))


def test_second_solution_as_exact_as_needed(comm):
    """What an error of the response to a load adds to the residual is no more than that of the
    correction, though a support that moves is a load as large as the body is stiff."""
    problem = sheared(comm, "hexahedron")
    problem.step.assemble_residual()
    options = {"ksp_type": "gmres", "pc_type": "jacobi", "ksp_max_it": 500}
    nothing = np.zeros(problem.discretization.owned)
    held = problem.loading.owned_prescribed
    forces, moved, left = nothing + 1e-4, nothing.copy(), []
    moved[held] = 1.0
    forces[held] = 0.0
    for multiplier in (0.0, 0.1):
        system = AssembledSystem(problem, options)
        system.multiplier = multiplier
        _, du = system.solve([forces, nothing], [nothing, moved], 1e-4)
        left.append(global_norm(comm, problem.loading.balance(system.product(du))))
        system.free()
    assert left[1] <= 1e-4 / 0.1 * 1.01 < left[0]
