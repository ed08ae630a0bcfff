"""Motions without strain."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..forms.geometry import Axisymmetric


def rigid_motions(x: NDArray[np.float64], geometry: Any) -> NDArray[np.float64]:
    """Translations, then rotations, of small angle (modes, n, d); along z only in axisymmetry.

    Args:
        x: Points (n, d).
        geometry: Of the problem.
    """
    d = x.shape[1]
    translations = [np.tile(direction, (len(x), 1)) for direction in np.eye(d)]
    if isinstance(geometry, Axisymmetric):
        return np.array(translations[1:])
    rotations = []
    for i, j in combinations(range(d), 2):
        rotation = np.zeros((len(x), d))
        rotation[:, i], rotation[:, j] = -x[:, j], x[:, i]
        rotations.append(rotation)
    return np.array([*translations, *rotations])
