"""Sliding distance of the points of an interface relative to the size of their facets."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .active import ActiveInterface, pressed


class Sliding(NamedTuple):
    """Sliding distance of a point in contact."""

    ratio: float  # The slip relative to the size of the facet; if 0 the other values are undefined
    facet: int = -1
    point: NDArray[np.float64] | None = None  # Its position (3,) [mm]
    slip: float = 0.0  # |zeta_T| [mm]
    size: float = 0.0  # Length of the facet, in 3D the square root of its area [mm]


def sliding(active: ActiveInterface) -> Sliding:
    """The point in contact on this rank with the largest slip relative to its facet, if it keeps
    its partner."""
    q, history = active.quadrature, active.history
    if not active.law.inelastic or not len(q.weights) or active.facets.slides:
        return Sliding(0.0)
    N, zeta = q.normal, history.gap
    slip = np.linalg.norm(zeta - np.einsum("pi,pi->p", zeta, N)[:, None] * N, axis=1)
    slip[~pressed(active)] = 0
    ratio = slip / q.extent[q.facet]
    i = int(np.argmax(ratio))
    f = q.facet[i]
    place = int(active.facets.facets[f]), q.points[i]
    return Sliding(float(ratio[i]), *place, float(slip[i]), float(q.extent[f]))
