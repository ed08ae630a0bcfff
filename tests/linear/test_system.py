"""Linear systems: products, last tangents again, and how exact a second solution is."""

from __future__ import annotations

import numpy as np
from support.problems import MATERIALS, couple, joined, pressed
from support.scenes import two_blocks

import vmdg
from vmdg.base.parallel import global_max, global_norm
from vmdg.linear.system import System

LAW = vmdg.Debonding(strength=20.0, critical_gap=0.05, friction=0.4)
VISCOUS = vmdg.Debonding(strength=20.0, critical_gap=0.05, viscosity=10.0)


def sheared(comm, cell, n=3) -> vmdg.Problem:
    """Two blocks pulled apart and sheared, then pressed: by .02, .04 and -.01 t mm."""
    scene = two_blocks(comm, cell, n)
    problem = joined(scene, LAW, kinematics="small")
    d = scene.mesh.geometry.dim
    problem.dirichlet(scene.facet_tags.find(1), 0.0)

    def move(t):
        return np.array([0.02 * t if t < 0.6 else 0.012 - 0.06 * (t - 0.6), 0.04 * t, 0.0][:d])

    problem.dirichlet(scene.facet_tags.find(2), move)
    return problem


def assert_same(comm, first, second, rel=1e-9):
    """Arrays agree relative to their largest entries, or to .01 where all but vanish.

    Where blocks have parted a traction is the rounding of r times the gap, some 1e-12 MPa.
    """
    for one, other in zip(first, second, strict=True):
        size = global_max(comm, np.abs(one).max(initial=1e-2))
        assert global_max(comm, np.abs(one - other).max(initial=0.0)) <= rel * size


def test_last_tangent_again(comm):
    """A last tangent serves where the state has changed, with the motion of a rigid face and all
    right-hand sides but the first."""
    scene = two_blocks(comm, "quadrilateral", 3)
    problem = couple(scene, LAW, MATERIALS)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.rigid_face(scene.facet_tags.find(2), "y", force=lambda t: 5.0 * t)
    system = System(problem, None)
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


def test_many_right_hand_sides(comm):
    """Responses that are found together are those found one by one, whether supports move or not,
    with a rigid face, by fresh factors and by those of another state."""
    scene = two_blocks(comm, "quadrilateral", 3)
    problem = couple(scene, LAW, MATERIALS)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.rigid_face(scene.facet_tags.find(2), "y", force=lambda t: 5.0 * t)
    forces = 1.0 + problem.step.assemble_residual()
    wave, nothing = np.sin(np.arange(len(forces))), np.zeros_like(forces)
    right, moved = [forces, wave, nothing], [nothing, nothing, wave]
    together, alone = System(problem, None), System(problem, None)
    for stretch in (0.0, 1e-3):
        problem.u.x.array[:] = stretch * np.sin(np.arange(len(problem.u.x.array)))
        problem.step.assemble_residual()
        found = together.respond(right, moved)
        for (du, work), *one in zip(found, right, moved, strict=True):
            ((expected, known),) = alone.respond(*([array] for array in one))
            assert_same(comm, [expected], [du], rel=1e-8)
            assert_same(comm, [known], [work], rel=1e-8)
    for system in (together, alone):
        system.free()


def test_steps_end_with_the_last_tangent(comm):
    """Where one more correction with the last tangent ends a step, it has none of its own."""
    ends, spared = [], []
    for tolerance in (1e-8, 1e-12):
        problem = pressed(comm, "quadrilateral", VISCOUS, opening=0.02)
        result = vmdg.solve(
            problem, np.linspace(0.2, 1.0, 5), vmdg.SolveOptions(relative_tolerance=tolerance)
        )
        assert not result.failures
        spared.append(result.counts.solves - result.counts.tangents)
        ends.append(problem.u.x.array.copy())
    assert spared[0] >= 4 > 1 >= spared[1]
    assert_same(comm, ends[:1], ends[1:], rel=1e-8)


def test_product(comm):
    """K.du of the solution is the right-hand side on free dofs, with faces, supports and damage."""
    problem = sheared(comm, "quadrilateral")
    vmdg.solve(problem, [0.4, 0.8])
    system = System(problem, None)
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
        system = System(problem, options)
        system.multiplier = multiplier
        _, du = system.solve([forces, nothing], [nothing, moved], 1e-4)
        left.append(global_norm(comm, problem.loading.balance(system.product(du))))
        system.free()
    assert left[1] <= 1e-4 / 0.1 * 1.01 < left[0]
