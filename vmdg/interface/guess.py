"""What the tangent of a first guess takes points without bond for: open, or closed and held.

Every function changes C = d zeta/dT of the values of an interface that can fail, or says at which
points it may be changed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..laws import Mode
from ..laws.base import dot
from .active import ActiveInterface
from .points import PointValues

Points = NDArray[np.bool_]


def free_points(active: ActiveInterface) -> Points:
    """Whether points begin the step without bond and traction (nq,)."""
    gone = active.history.softening >= active.law.strength
    return gone & ~active.history.traction.any(axis=1)


def touching_points(active: ActiveInterface) -> Points:
    """Whether free points have no gap either: they are neither open nor closed (nq,)."""
    return free_points(active) & ~active.history.gap.any(axis=1)


def pressed_points(active: ActiveInterface) -> Points:
    """Whether the last return map has T_N < 0 (nq,)."""
    return dot(active.values.update.traction, active.quadrature.normal) < 0


def open_free_points(active: ActiveInterface) -> None:
    """C = I/r at points without bond and traction: the next tangent takes them for open.

    Taken for closed, a crack would open like a zip: behind the points that have opened the lips
    press on each other, so that a correction opens one or two facets more.
    """
    r = active.stabilization.norm[active.quadrature.facet][:, None, None]
    _assume(active, free_points(active), np.eye(active.quadrature.d) / r)


def hold_sliding_points(active: ActiveInterface) -> None:
    """C = 0 at points that have slid: the next tangent takes them for held.

    The first guess of a step that does not go on as the last one. Where points slide nothing
    couples the lips along the slip, so that all would follow the load. Take a point with r on a
    body of stiffness k that is pushed by f, |f| < c = mu |T_N|: from sliding one way, k s + c = f,
    it slides back, s < 0, from sliding back on again, and so forth. Held, (k + r) s = f, it stays
    where it is; if |f| > c its slip s has the sign of the end.
    """
    _assume(active, active.history.mode == Mode.FRICTION, 0.0)


def hold_points(active: ActiveInterface, begun: PointValues, points: Points) -> None:
    """The values in which the step began, and C = 0 at some points.

    Args:
        active: The interface.
        begun: The values, with C of the guess before.
        points: Which (nq,).
    """
    active.values = begun
    _assume(active, points, 0.0)


def _assume(active: ActiveInterface, points: Points, C: NDArray[np.float64] | float) -> None:
    """C of the next tangent at some points (nq,)."""
    compliance = np.where(points[:, None, None], C, active.values.compliance)
    active.values = replace(active.values, compliance=compliance)
