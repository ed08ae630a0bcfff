"""The first guess of a step in which supports turn: the body turns with them.

Prescribed displacements that are a rigid motion of where their nodes are leave a body in its state:
turned with them it is in equilibrium. The tangent does not know: it takes a turn by 90 degrees for
a stretch to 1.9 of the size. So the rigid part of the motion of the supports is found, from the
positions x_i before and y_i after it (Kabsch 1976),

    R = argmin sum_i |y_i - c' - R (x_i - c)|^2,

c and c' the mean positions, and where little else is left the body follows it first.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_norm, global_sum
from ..forms.geometry import Axisymmetric
from ..problem.problem import Problem

Array = NDArray[np.float64]

#: Share of the motion of the supports that may be left when its rigid part is done, the angle below
#: which the tangent does as well [rad], and the square of the width of the points across their
#: longest line, relative to its length, below which a turn about it is not known.
LEFT, ANGLE, WIDTH = 0.1, 1e-2, 1e-6


def rigid_part(comm: MPI.Comm, x: Array, y: Array) -> tuple[Array, Array, Array] | None:
    """The rigid motion that takes points nearest to others; collective.

    Args:
        comm: Communicator.
        x: Points of this rank (n, d) [mm].
        y: Where they go (n, d) [mm].

    Returns:
        Rotation (d, d), mean of all x and mean of all y; None where they do not tell the rotation.
    """
    d = x.shape[1]
    count = int(global_sum(comm, len(x)))
    if count < d:
        return None
    before, after = (global_sum(comm, points.sum(axis=0)) / count for points in (x, y))
    U, sizes, V = np.linalg.svd(global_sum(comm, (y - after).T @ (x - before)))
    # In 3D points on a line leave the turn about it open, in 2D a single one.
    if sizes[d - 2] <= WIDTH * sizes[0]:
        return None
    mirror = np.ones(d)
    mirror[-1] = np.sign(np.linalg.det(U @ V))
    return U @ (mirror[:, None] * V), before, after


def turn(problem: Problem) -> bool:
    """Turn a body with its supports, if that is most of their way; collective.

    Returns:
        False, and nothing has changed, where it is not, at small strain, where faces are rigid,
        which do not turn so far, or where means are unknowns: the mean gradient of a periodic cell
        turns all of it.
    """
    parts, loading = problem.discretization, problem.loading
    if parts.bodies.small or loading.rigid or isinstance(parts.geometry, Axisymmetric):
        return False
    if parts.means is not None:
        return False
    space, d = parts.space, parts.space.dofmap.index_map_bs
    u, owned = problem.u.x.array, parts.owned
    held = loading.owned_prescribed
    target = u.copy()
    target[loading.prescribed] = loading.prescribed_values(problem.t)
    points = space.tabulate_dof_coordinates()[:, :d]
    nodes = np.flatnonzero(np.bincount(held // d, minlength=owned // d) == d)
    x, y = ((points + values.reshape(-1, d))[nodes] for values in (u, target))
    found = rigid_part(problem.comm, x, y)
    if found is None:
        return False
    R, before, after = found
    if np.linalg.norm(R - np.eye(d)) < ANGLE:
        return False
    moved = ((points + u.reshape(-1, d) - before) @ R.T + after - points).ravel()
    way, left = (global_norm(problem.comm, (v - target)[held]) for v in (u, moved))
    if not left < LEFT * way:
        return False
    u[:] = moved
    return True
