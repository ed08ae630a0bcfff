"""Shapes of arrays, also of those without rows."""

from __future__ import annotations

import math

from numpy.typing import NDArray


def joined_axes(array: NDArray, first: int) -> NDArray:
    """The axes from number ``first`` on as one.

    A -1 in reshape does not say how long an axis is where a rank has no points.
    """
    return array.reshape(*array.shape[:first], math.prod(array.shape[first:]))
