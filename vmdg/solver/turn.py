"""The first guess of a step in which supports turn: the body turns with them.

Prescribed displacements that are a rigid motion of where their nodes are leave a body in its state:
turned with them it is in equilibrium. The tangent does not know: it takes a turn by 90 degrees for
a stretch to 1.9 of the size. So where little is left of the motion of the supports without its
rigid part, the body follows that first.
"""

from __future__ import annotations

import numpy as np

from ..base.parallel import global_norm
from ..domain.geometry import rigid_part
from ..forms.geometry import Axisymmetric
from ..problem.problem import Problem


def turn(problem: Problem, most: float) -> bool:
    """Turn a body with its supports, if that is most of their way; collective.

    Args:
        problem: The problem.
        most: Share of the way that may be left then.

    Returns:
        False, and nothing has changed, where it is not, at small strain, where faces are rigid,
        which do not turn so far, or where means are unknowns: the mean gradient of a periodic cell
        turns all of it.
    """
    parts, loading = problem.discretization, problem.loading
    apart = loading.rigid or parts.means is not None
    if parts.bodies.small or apart or isinstance(parts.geometry, Axisymmetric):
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
    moved = ((points + u.reshape(-1, d) - before) @ R.T + after - points).ravel()
    way, left = (global_norm(problem.comm, (v - target)[held]) for v in (u, moved))
    if not left < most * way:
        return False
    u[:] = moved
    return True
