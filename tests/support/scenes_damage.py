"""Two blocks whose bond is partly damaged, or pressed and sheared, and what tests ask of them."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from scenes import (
    DIMENSION,
    MATERIALS,
    gather,
    global_norm,
    joined,
    multiply,
    set_displacement,
    two_blocks,
)

import vmdg

FRICTION = vmdg.Debonding(strength=50.0, critical_gap=0.2, friction=0.5)
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
    active = problem.discretization.active[0]
    r = active.stabilization.norm[active.quadrature.facet]
    update = active.law.return_map(trial, state.normal, state.gap, state.softening, r)
    return gather(problem.comm, update.mode)


def pressed(comm, cell: str, law: vmdg.Law, n: int = 3, opening: float = -0.01) -> vmdg.Problem:
    """Two blocks pressed together by .01 t, or opened, and sheared by .04 t mm."""
    scene = two_blocks(comm, cell, n)
    interface = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(
        scene.mesh, scene.cell_tags, dict(enumerate(MATERIALS, start=1)), [interface]
    )
    d = scene.mesh.geometry.dim
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    move = np.array([opening, 0.04, 0.0][:d])
    problem.dirichlet(scene.facet_tags.find(2), lambda t: t * move)
    return problem
