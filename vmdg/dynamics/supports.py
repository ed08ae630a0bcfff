"""Velocity and acceleration of supports that move as given."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ..base.agreement import together
from ..base.parallel import global_any
from ..problem.loading import Loading

Array = NDArray[np.float64]


class SupportMotion:
    """Velocity and acceleration of prescribed dofs, by differences over a step.

    For a function that bends within a step the accelerations are those of the impulse: their sum
    times the step is the change of the velocity.

    Args:
        start: First time, before which the functions are not evaluated [s].
        end: Last time, beyond which they are evaluated by a step where they are defined, so that a
            run that is continued is one run [s].
    """

    def __init__(self, comm: MPI.Comm, loading: Loading, start: float, end: float):
        self._comm, self._loading = comm, loading
        self._start, self._end = start, end
        self._known: dict[float, Array] = {}

    def at(self, before: float, t: float, after: float) -> tuple[Array, Array]:
        """Velocity [mm/s] and acceleration [mm/s2] of owned prescribed dofs at ``t``, by
        differences between a time before and one after it; collective."""
        before, here, ahead = max(before, self._start), self._values(t), self._ahead(after)
        a, b = t - before, after - t
        first = (here - self._values(before)) / a if a > 0 else None
        last = None if ahead is None else (ahead - here) / b
        if first is None or last is None:
            known = last if first is None else first
            return np.zeros_like(here) if known is None else known, np.zeros_like(here)
        return (b * first + a * last) / (a + b), 2 * (last - first) / (a + b)

    def _ahead(self, t: float) -> Array | None:
        """Displacement at a time that may be beyond the last one, where the function need not be
        defined; then None; collective."""
        if t <= self._end:
            return self._values(t)
        try:
            values = self._values(t)
        except Exception:  # a user's function may raise anything; on all ranks
            return None
        return None if global_any(self._comm, not np.isfinite(values).all()) else values

    def _values(self, t: float) -> Array:
        """Displacement of owned prescribed dofs [mm]."""
        if t not in self._known:
            values = together(self._comm, lambda: self._loading.prescribed_values(t))
            # Owned dofs come first. Of the last three times, some are needed again.
            recent = list(self._known.items())[-2:]
            self._known = dict(recent) | {t: values[: len(self._loading.owned_prescribed)]}
        return self._known[t]


def support_work(
    held: NDArray[np.int32], inertia: Array, moved: Array, jump: Array, momentum: Array
) -> float:
    """Work of supports on the mass of their nodes in a step, this rank's [N mm].

    Newmark's relations hold for free dofs f only; supports h move as given, and velocities by
    differences jump at a kink. With means v_m of the velocities and a_m of the accelerations of a
    step, and j = v_1 - v_0 - h a_m, the kinetic energy changes by

        (v_1 - v_0).M.v_m = h v_m.(M.a_m) + j.(M.v_m),

    of which h v_m.(M.a_m) on free dofs is the work of the other forces on them, and the rest is
    that of supports.

    Args:
        inertia: M.a_m of owned dofs [N].
        moved: h v_m of owned dofs [mm].
        jump: j of owned dofs [mm/s].
        momentum: M.v_m of owned dofs [N s].
    """
    return float(inertia[held] @ moved[held] + jump[held] @ momentum[held])
