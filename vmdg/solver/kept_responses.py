"""Displacements under loads that come again and again, by superposition."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

#: Loads that are kept, and the share of a load that is new enough to be kept.
KEPT, NEW = 6, 1e-3

Vector = NDArray[np.float64]


class KeptResponses:
    """Solves K.u = f, where f is a combination of earlier ones without a solve.

    The loads of a run are few fields times functions of the load factor. Solved loads are kept as
    an orthonormal basis q_i with the displacements u_i under them:

        u = sum_i (q_i.f) u_i + K^-1.(f - sum_i (q_i.f) q_i),

    and the last term is left out where its load is negligible.

    Args:
        solve: u from f.
    """

    def __init__(self, solve: Callable[[Vector], Vector]):
        self._solve = solve
        self._loads: list[Vector] = []
        self._displacements: list[Vector] = []

    def __call__(self, forces: Vector, negligible: float) -> Vector:
        """u, but for what a load of the norm ``negligible`` does [mm].

        Args:
            forces: f (N,), zero where displacements are held [N].
            negligible: [N].
        """
        rest, u = forces.copy(), np.zeros(len(forces))
        for load, displacement in zip(self._loads, self._displacements, strict=True):
            share = load @ rest
            rest -= share * load
            u += share * displacement
        size = float(np.linalg.norm(rest))
        if size <= negligible:
            return u
        more = self._solve(rest)
        if size > NEW * np.linalg.norm(forces):
            if len(self._loads) == KEPT:
                self._loads, self._displacements = [], []
            self._loads.append(rest / size)
            self._displacements.append(more / size)
        return u + more
