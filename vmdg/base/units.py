"""Scaling that makes rounding independent of units."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def power_of_two(sizes: ArrayLike) -> NDArray[np.float64]:
    """The next power of two above each of some positive sizes.

    A number divided by it has the same digits in all units that differ by powers of two, and so has
    its square root.
    """
    return np.ldexp(1.0, np.frexp(sizes)[1])
