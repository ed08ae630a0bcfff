"""Velocity and acceleration of supports that move as given."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ..base.agreement import together
from ..problem.loading import Loading

Array = NDArray[np.float64]


class SupportMotion:
    """Velocity and acceleration of prescribed dofs, by differences over a step.

    For a function that bends within a step the accelerations are those of the impulse: their sum
    times the step is the change of the velocity.

    Args:
        comm: Communicator of the problem.
        loading: Loads and prescribed displacements.
        start: First time, before which the functions are not evaluated [s].
        end: Last time [s].
    """

    def __init__(self, comm: MPI.Comm, loading: Loading, start: float, end: float):
        self._comm, self._loading = comm, loading
        self._start, self._end = start, end
        self._known: dict[float, Array] = {}

    def at(self, before: float, t: float, after: float) -> tuple[Array, Array]:
        """Velocity [mm/s] and acceleration [mm/s2] of owned prescribed dofs at ``t``, by
        differences between a time before and one after it; collective."""
        before, after = max(before, self._start), min(after, self._end)
        here = self._values(t)
        if before == after:
            return np.zeros_like(here), np.zeros_like(here)
        a, b = t - before, after - t
        first = (here - self._values(before)) / a if a > 0 else np.zeros(0)
        last = (self._values(after) - here) / b if b > 0 else np.zeros(0)
        if a == 0 or b == 0:
            return (last if a == 0 else first), np.zeros_like(here)
        return (b * first + a * last) / (a + b), 2 * (last - first) / (a + b)

    def _values(self, t: float) -> Array:
        """Displacement of owned prescribed dofs [mm]."""
        if t not in self._known:
            values = together(self._comm, lambda: self._loading.prescribed_values(t))
            # Owned dofs come first. Of the last three times, some are needed again.
            recent = list(self._known.items())[-2:]
            self._known = dict(recent) | {t: values[: len(self._loading.owned_prescribed)]}
        return self._known[t]
