"""Smooth maxima of the force between two steps."""

from __future__ import annotations

from typing import NamedTuple

from ..base.parallel import global_norm, global_sum
from ..problem.problem import Problem


class Place(NamedTuple):
    """A state on the path.

    Attributes:
        way: Its distance along the path from an earlier state, in any measure that grows.
        force: See :func:`force_of`.
    """

    way: float
    force: float


def force_of(problem: Problem) -> float:
    """Power of the supports by load factor, relative to the norm of their displacement by it, in
    the present state of a ray; 0 where they do not move; collective [N]."""
    loading, comm = problem.loading, problem.comm
    rate = loading.rate()
    size = global_norm(comm, rate)
    forces = problem.discretization.forces.x.array[: len(rate)]
    return float(global_sum(comm, forces @ rate)) / size if size > 0 else 0.0


def share_of_peak(last: list[Place], end: Place, least: float, small: float) -> float:
    """Share of a step at which the force is largest; 1 if it is at no state inside.

    The parabola through the last two states and the end of the step has its vertex there, and
    exceeds all forces so far by a fraction of it.

    Args:
        last: The last two states, without a kink of the path after the first; fewer for none.
        end: That at the end of the step.
        least: Largest force so far [N].
        small: This fraction.
    """
    if len(last) < 2:
        return 1.0
    (x0, F0), (x1, F1), (x2, F2) = *last, end
    if not x0 < x1 < x2:
        return 1.0
    first, second = (F1 - F0) / (x1 - x0), (F2 - F1) / (x2 - x1)
    bend = (second - first) / (x2 - x0)
    if bend >= 0:
        return 1.0
    x = (x1 + x2) / 2 - second / (2 * bend)
    F = F1 + second * (x - x1) + bend * (x - x1) * (x - x2)
    return (x - x1) / (x2 - x1) if x1 < x < x2 and F - max(F2, least) > small * F else 1.0
