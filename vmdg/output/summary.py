"""Extremes, averages and integrals over an interface, over all ranks.

``problem.state`` has the points of this rank only.
"""

from __future__ import annotations

import numpy as np

from ..base.parallel import global_max, global_sum
from ..points.interface import Which
from ..problem.problem import Problem
from .values import Quantity, values_at_points


def extremes(problem: Problem, interface: Which, quantity: Quantity) -> tuple[float, float]:
    """Lowest and highest value at the points of an interface, the same on every rank; collective.

    Args:
        problem: The problem.
        interface: Its number, its name or itself.
        quantity: "opening", "gap", "traction": g, zeta and T along the current normal, positive in
            opening and tension [mm, mm, MPa]; "slip", "shear": norm of the tangential part of zeta
            and T [mm, MPa]; "damage": Q relative to the strength; "mode": :class:`vmdg.Mode`;
            "fine_scale": size of the fine scales (24) [mm]. Or a function of an
            :class:`vmdg.InterfaceState`, for example ``lambda state: state.traction[:, 0]``.

    Returns:
        Two numbers, NaN if no facet is open.

    Raises:
        ValueError: no such scalar or interface, or a function that returns something else.
    """
    values = values_at_points(problem, interface, quantity)
    ends = [-values.min(initial=np.inf), values.max(initial=-np.inf)]
    low, high = (global_max(problem.comm, float(end)) for end in ends)
    return (float("nan"),) * 2 if high == -np.inf else (-low, high)


def integral(problem: Problem, interface: Which, quantity: Quantity) -> float:
    """Integral over an interface, for tractions a force [N]; collective.

    Over the reference area, including the thickness of a plane body or the full circle of a body of
    revolution.

    Args:
        problem: The problem.
        interface: Its number, its name or itself.
        quantity: As for :func:`extremes`.

    Raises:
        ValueError: as :func:`extremes`.
    """
    return _integral_and_area(problem, interface, quantity)[0]


def average(problem: Problem, interface: Which, quantity: Quantity) -> float:
    """Average over the open area of an interface, NaN if no facet is open; collective.

    Args:
        problem: The problem.
        interface: Its number, its name or itself.
        quantity: As for :func:`extremes`.

    Raises:
        ValueError: as :func:`extremes`.
    """
    whole, area = _integral_and_area(problem, interface, quantity)
    return whole / area if area > 0 else float("nan")


def _integral_and_area(
    problem: Problem, interface: Which, quantity: Quantity
) -> tuple[float, float]:
    values, weights = (
        values_at_points(problem, interface, quantity),
        problem.state[interface].weights,
    )
    thickness = float(problem.discretization.geometry.thickness)
    whole, area = global_sum(problem.comm, [weights @ values, weights.sum()])
    return thickness * float(whole), thickness * float(area)
