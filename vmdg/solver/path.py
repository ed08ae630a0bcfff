"""The last states of an equilibrium path, and what lies ahead of them."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_any

#: States that are kept, and the longest step relative to the last one that is extrapolated.
KEPT, REACH = 3, 4.0


class Path:
    """The states at which the last steps started, as long as they follow each other.

    A step that is cut and tried again starts where it started before. One that starts elsewhere at
    the same parameter has passed an unstable stage: what was before it says nothing of what
    follows.

    Args:
        comm: Ranks that share the displacement.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        self._comm = comm
        self._states: list[tuple[float, NDArray[np.float64]]] = []

    def start(self, t: float, u: NDArray[np.float64]) -> None:
        """A step starts from displacement ``u`` at the path parameter ``t``; collective."""
        if self._states and self._states[-1][0] == t:
            if global_any(self._comm, not np.array_equal(self._states[-1][1], u)):
                self._states = [(t, u.copy())]
            return
        self._states = [*self._states, (t, u.copy())][-KEPT:]

    def ahead(self, t: float) -> list[NDArray[np.float64]]:
        """Displacement at parameter ``t`` by the polynomials through two and three states.

        By Lagrange's formula; none where the path turns back or the step is much longer.
        """
        times = [state[0] for state in self._states]
        if len(times) < 2 or not 0 < (t - times[-1]) / (times[-1] - times[-2]) <= REACH:
            return []
        steps = np.diff(times)
        most = len(times) if (steps * steps[-1] > 0).all() else 2
        return [self._polynomial(t, count) for count in range(2, most + 1)]

    def _polynomial(self, t: float, count: int) -> NDArray[np.float64]:
        states = self._states[-count:]
        result = np.zeros_like(states[0][1])
        for i, (ti, u) in enumerate(states):
            others = [tj for j, (tj, _) in enumerate(states) if j != i]
            result += np.prod([(t - tj) / (ti - tj) for tj in others]) * u
        return result
