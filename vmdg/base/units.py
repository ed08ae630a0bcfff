"""What makes rounding the same in all units."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def power_of_two(sizes: ArrayLike) -> NDArray[np.float64]:
    """The one next above each of some positive sizes.

    What is divided by it has the same digits in all units that differ by powers of two, and so have
    its roots.
    """
    return np.ldexp(1.0, np.frexp(sizes)[1])
