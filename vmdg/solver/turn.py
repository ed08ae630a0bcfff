"""Predictor for rotating supports: the body rotates with them.

If prescribed displacements are a rigid motion of their nodes, the rotated body is in equilibrium. A
tangent predictor would instead treat a rotation by 90 degrees as a stretch to 1.9 times the size.
So if the motion of the supports is nearly rigid, the body first follows its rigid part.
"""

from __future__ import annotations

import numpy as np

from ..base.parallel import global_any, global_norm
from ..domain.geometry import rigid_part
from ..forms.geometry import Axisymmetric
from ..problem.problem import Problem


def turn(problem: Problem, most: float) -> bool:
    """Rotate a body with its supports, if that is most of their motion; collective.

    Returns:
        False, without changes, if it is not, at small strain, with rigid faces, which cannot rotate
        so far, or with unknown means: the mean gradient of a periodic cell contains the rotation.
    """
    discretization, loading = problem.discretization, problem.loading
    apart = loading.rigid or discretization.means is not None
    if discretization.bodies.small or apart or isinstance(discretization.geometry, Axisymmetric):
        return False
    space, d = discretization.space, discretization.space.dofmap.index_map_bs
    u, owned = problem.u.x.array, discretization.owned
    held = loading.owned_prescribed
    target = u.copy()
    target[loading.prescribed] = loading.prescribed_values(problem.t)
    if not global_any(problem.comm, not np.array_equal(u[held], target[held])):
        return False
    points = space.tabulate_dof_coordinates()[:, :d]
    nodes = np.flatnonzero(np.bincount(held // d, minlength=owned // d) == d)
    x, y = ((points + values.reshape(-1, d))[nodes] for values in (u, target))
    found = rigid_part(problem.comm, x, y)
    if found is None:
        return False
    R, before, after = found
    moved = ((points + u.reshape(-1, d) - before) @ R.T + after - points).ravel()
    way, left = (global_norm(problem.comm, (v - target)[held]) for v in (u, moved))
    if not left < most * way:
        return False
    u[:] = moved
    return True
