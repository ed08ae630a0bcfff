"""Assumptions of the predictor's tangent on points without bond: open, or closed and sticking.

The functions change C = d zeta/dT in the values of an interface that can fail, or select the points
where it may be changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..laws import Mode
from ..laws.base import dot
from .active import ActiveInterface, at_rest
from .values import PointValues

Points = NDArray[np.bool_]


def free_points(active: ActiveInterface) -> Points:
    """Whether points begin the step without bond and traction (nq,)."""
    gone = active.history.softening >= active.law.strength
    return gone & ~active.history.traction.any(axis=1)


def touching_points(active: ActiveInterface) -> Points:
    """Whether free points have no gap either, neither open nor closed (nq,)."""
    return free_points(active) & ~active.history.gap.any(axis=1)


def pressed_points(active: ActiveInterface) -> Points:
    """Whether the last return map has T_N < 0 (nq,)."""
    return dot(active.values.update.traction, active.quadrature.normal) < 0


def open_free_points(active: ActiveInterface) -> None:
    """C = I/r at points without bond and traction: the next tangent treats them as open.

    Treated as closed, a crack would open like a zip: behind the open points the faces press on each
    other, so each correction would open only one or two more facets. Points at a distance open
    all at once; in the first step, where they may close as well, they are treated as closed.
    """
    r = active.stabilization.norm[active.quadrature.facet][:, None, None]
    points = touching_points(active) if at_rest(active) else free_points(active)
    _assume(active, points, np.eye(active.quadrature.d) / r)


def hold_modes(active: ActiveInterface, modes: Sequence[Mode]) -> None:
    """C = 0 at points that have slid or softened: the next tangent treats them as sticking.

    For the predictor of a step that does not continue the last one. Where points slide nothing
    couples the faces along the slip, so all would follow the load. Consider a point with penalty r
    on a body of stiffness k under a force f, |f| < c = mu |T_N|. From sliding forward, k x + c = f,
    it slides back, x < 0, then forward again, and so on. Treated as sticking, (k + r) x = f, it
    stays in place; if |f| > c, its displacement x has the sign of the solution. Where points soften
    C makes the traction rise as the gap is closed, so that a crack that is unloaded would be pulled
    shut.
    """
    _assume(active, np.isin(active.history.mode, modes), 0.0)


def without_couples(active: ActiveInterface) -> None:
    """No moments of T at the gaps: undeformed bodies that overlap carry nothing yet, and T = r g of
    several cells' depth would turn them by its moment, of second order in g."""
    if (moment := active.values.moment) is not None:
        active.values = replace(active.values, moment=np.zeros_like(moment))


def hold_unstressed(active: ActiveInterface) -> None:
    """The values of undeformed bodies in contact, for the next tangent: with g in place of zero its
    terms g.d{P.N}/dF, as large as r h where g is a cell's depth, would outweigh the bodies."""
    active.values = replace(active.start(), compliance=active.values.compliance)


def hold_here(active: ActiveInterface, C: NDArray[np.float64]) -> None:
    """C (nq, d, d), and the frame at the present displacement with the zeta of the history: values
    with zeta held are otherwise in the frame of the last return map, which a state from elsewhere
    does not have. Not with an initial gap."""
    values, trial = replace(active.values, compliance=C), active.trial()
    if (R := values.rotation) is not None:
        total, T = (np.einsum("pji,pj->pi", R, one) for one in (trial.total, values.traction))
        inside = {"frame_gap": active.history.gap, "frame_traction": T}
        values = replace(values, frame_gradient=trial.F, frame_total=total, **inside)
    active.values = values


def hold_points(active: ActiveInterface, begun: PointValues, points: Points) -> None:
    """Restore the values at the start of the step, with C = 0 at some points."""
    active.values = begun
    _assume(active, points, 0.0)


def _assume(active: ActiveInterface, points: Points, C: NDArray[np.float64] | float) -> None:
    """Set C of the next tangent at some points (nq,)."""
    compliance = np.where(points[:, None, None], C, active.values.compliance)
    active.values = replace(active.values, compliance=compliance)
