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

    def at(self, t: float, h: float) -> tuple[Array, Array]:
        """Velocity [mm/s] and acceleration [mm/s2] of owned prescribed dofs at a time, by
        differences over ``h``; collective."""
        before, after = max(t - h, self._start), min(t + h, self._end)
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
        values = together(self._comm, lambda: self._loading.prescribed_values(t))
        # Owned dofs come first.
        return values[: len(self._loading.owned_prescribed)]
