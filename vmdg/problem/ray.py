"""Loads that are linear in the load factor."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..assembly.values import Load

Array = NDArray[np.float64]

#: Positions between two load factors at which loads are checked for linearity, and its tolerance
#: relative to the largest value at an end.
PROBES, STRAIGHT = (0.382, 0.5), 1e-9


class Ray:
    """A list of loads, each linear between its given values at two load factors, and beyond."""

    def __init__(self, loads: Iterable[Load], start: float, end: float):
        self.start, self.end = start, end
        self.ends = {load: (load.values(start), load.values(end)) for load in loads}

    def at(self, load: Load, t: float) -> Array:
        """Values of a load at load factor ``t``, also beyond the ends."""
        share = (t - self.start) / (self.end - self.start)
        first, last = self.ends[load]
        return (1 - share) * first + share * last

    def rate(self, load: Load) -> Array:
        first, last = self.ends[load]
        return (last - first) / (self.end - self.start)

    def changes(self, load: Load) -> bool:
        first, last = self.ends[load]
        return bool((first != last).any())

    def reproduces(self, t: float) -> bool:
        """Whether the ray reproduces all given loads at load factor ``t``, on this rank."""
        off = [np.abs(load.values(t) - self.at(load, t)).max(initial=0.0) for load in self.ends]
        sizes = [np.abs(pair).max(initial=0.0) for pair in self.ends.values()]
        return bool((np.array(off) <= STRAIGHT * np.array(sizes)).all())

    def is_straight(self) -> bool:
        length = self.end - self.start
        # All of them: ranks that stopped at the first one would call users' functions less often.
        return all([self.reproduces(self.start + share * length) for share in PROBES])
