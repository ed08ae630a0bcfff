"""Points of an interface that are led along a path, without a mesh."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from vmdg.laws import Law
from vmdg.laws.base import Update


def follow(law: Law, loads: Iterable, normal: NDArray, r: float) -> list[Update]:
    """Updates of points that start intact; ``loads`` are T + r zeta after each step, (n, d)."""
    gap, softening, updates = np.zeros_like(normal), np.zeros(len(normal)), []
    for load in loads:
        update = law.return_map(load - r * gap, normal, gap, softening, r)
        gap, softening = update.gap, update.softening
        updates.append(update)
    return updates


def total(updates: Iterable[Update], work: str = "damage_work") -> float:
    """Sum of one of the works of a point."""
    return sum(getattr(update, work)[0] for update in updates)
