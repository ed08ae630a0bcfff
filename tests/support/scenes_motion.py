"""Two blocks that are opened, sheared, pressed and turned: scenes for laws in motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray
from scenes import DIMENSION, by_position, global_norm, multiply, set_displacement

import vmdg
from vmdg.meshes import TaggedMesh, blocks

SAME = (vmdg.NeoHookean(E=5000.0, nu=0.25),) * 2
LEFT, RIGHT = 1, 2  # facet tags of the ends


def rotation(d: int, angle: float) -> NDArray:
    """Rotation by ``angle``, in the plane or about the axis (2, -1, 2)/3."""
    if d == 2:
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, -s], [s, c]])
    axis = np.array([2.0, -1.0, 2.0]) / 3
    W = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * W + (1 - np.cos(angle)) * W @ W


def turned(X: NDArray, move: NDArray, angle: float) -> NDArray:
    """Displacement (d, n) of points X (3, n) that move by ``move`` (d,) and then turn."""
    d = len(move)
    return rotation(d, angle) @ (X[:d] + move[:, None]) - X[:d]


def couple(
    scene: TaggedMesh, law: vmdg.Law, materials: Sequence[vmdg.Material] = SAME, **options
) -> vmdg.Problem:
    """Problem of two blocks; ``options`` are those of their interface, turning by default."""
    interface = vmdg.Interface(between=(1, 2), law=law, **options)
    return vmdg.Problem(
        scene.mesh, scene.cell_tags, dict(enumerate(materials, start=1)), [interface]
    )


def driven(
    comm: MPI.Comm,
    cell: str,
    law: vmdg.Law,
    path: Callable[[float], tuple[Sequence[float], float]],
    n: int = 1,
    materials: Sequence[vmdg.Material] = SAME,
    **options,
) -> tuple[vmdg.Problem, TaggedMesh]:
    """Blocks with rigid ends: the left one turns, the right one moves and turns.

    Args:
        comm: Communicator.
        cell: Cell type.
        law: Of the interface.
        path: Displacement of the right end before it turns [mm] and angle, by load factor.
        n: Cells along each unit of length.
        materials: Of the two blocks.
        options: Of the interface.
    """
    d = DIMENSION[cell]
    scene = blocks(comm, cell, (n, n, n))
    problem = couple(scene, law, materials, **options)

    def left(X, t):
        return turned(X, np.zeros(d), path(t)[1])

    def right(X, t):
        move, angle = path(t)
        return turned(X, np.asarray(move, dtype=float), angle)

    problem.dirichlet(scene.facet_tags.find(LEFT), left)
    problem.dirichlet(scene.facet_tags.find(RIGHT), right)
    return problem, scene


def in_frame(problem: vmdg.Problem) -> tuple[NDArray, NDArray, NDArray]:
    """R^T.T, R^T.zeta and Q at the points of all ranks, ordered by position."""
    state = problem.state[0]
    T, zeta = (
        np.einsum("pji,pj->pi", state.rotation, vector) for vector in (state.traction, state.gap)
    )
    _, T, zeta, Q = by_position(problem.comm, state.points, T, zeta, state.softening)
    return T, zeta, Q


def put(problem: vmdg.Problem, scene: TaggedMesh, move: Sequence[float], angle: float) -> None:
    """Set a displacement: bend both blocks a little, move block 2 by ``move``, turn everything."""
    d = scene.mesh.geometry.dim
    waves = np.array([[2.0, 1.0, 0.5], [-1.0, 2.0, 1.5], [0.7, -1.0, 2.0]])[:d, :d]

    def field(x, tag):
        bent = x.copy()
        bent[:d] += 0.004 * np.sin(waves @ x[:d] + np.arange(1, d + 1)[:, None])
        bent[:d] += (tag == 2) * np.asarray(move)[:d, None]
        return rotation(d, angle) @ bent[:d] - x[:d]

    set_displacement(problem.u, scene.cell_tags, field)


def tangent_error(problem: vmdg.Problem, scene: TaggedMesh, dt: float = 1.0) -> float:
    """|K.v - dR/dv| / |dR/dv| at the current displacement, for a rough v that jumps.

    The central difference with step 1e-6 errs by 1e-12 of the third derivative and by 1e-10 from
    rounding. Ends with the residual assembled at the displacement it started with.
    """
    d = scene.mesh.geometry.dim
    waves = 5 * np.array([[2.0, -1.0, 3.0], [1.0, 3.0, -2.0], [-3.0, 1.0, 1.0]])[:d, :d]
    u = problem.u.x.array.copy()
    problem.assemble_residual(dt)
    matrix = problem.create_matrix()
    problem.assemble_tangent(matrix)
    set_displacement(problem.u, scene.cell_tags, lambda x, tag: np.sin(tag + waves @ x[:d]))
    v = problem.u.x.array.copy()
    forces = []
    for h in (1e-6, -1e-6):
        problem.u.x.array[:] = u + h * v
        forces.append(problem.assemble_residual(dt).copy())
    difference = (forces[0] - forces[1]) / 2e-6
    product = multiply(matrix, v[: len(difference)])
    matrix.destroy()
    problem.u.x.array[:] = u
    problem.assemble_residual(dt)
    comm = problem.comm
    return global_norm(comm, product - difference) / global_norm(comm, difference)
