"""Shapes of arrays, also of those without rows, and scaling that units do not change."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray


def joined_axes(array: NDArray, first: int) -> NDArray:
    """The axes from number ``first`` on as one.

    A -1 in reshape does not say how long an axis is where a rank has no points.
    """
    return array.reshape(*array.shape[:first], math.prod(array.shape[first:]))


def power_of_two(sizes: ArrayLike) -> NDArray[np.float64]:
    """The next power of two above each of some positive sizes.

    A number divided by it has the same digits in all units that differ by powers of two, and so has
    its square root.
    """
    return np.ldexp(1.0, np.frexp(sizes)[1])
