"""Safeguarded Newton iteration for many scalar equations at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .base import Array

# Newton's method converges quadratically: after a correction below this only round-off is left. Not
# so for bisection.
_LAST_NEWTON = 1e-10
_LAST_BISECTION = 1e-15
_MAX_ITERATIONS = 100


def increasing_root(
    function: Callable[[Array], tuple[Array, Array]], lower: Array, upper: Array, start: Array
) -> Array:
    """Root (n,) of n increasing functions, each bracketed by lower <= root <= upper.

    A Newton step that leaves the bracket, or reverses more than half of the one before, is replaced
    by bisection, so the iteration neither diverges nor oscillates at a kink.

    Args:
        function: x (n,) to values (n,) and slopes (n,).

    Returns:
        The roots, to round-off of the initial `upper` and, away from zero, of the root itself.
    """
    x, last = start, np.zeros_like(start)
    round_off = np.finfo(float).eps * upper
    for _ in range(_MAX_ITERATIONS):
        value, slope = function(x)
        lower = np.where(value < 0.0, x, lower)
        upper = np.where(value > 0.0, x, upper)
        # A zero slope, possible only by round-off, leads to bisection.
        newton = x - value / np.where(slope > 0.0, slope, 1.0)
        inside = (slope > 0.0) & (newton >= lower) & (newton <= upper)
        # converged values may still oscillate in their last digits
        back = -np.sign(last) * (newton - x)
        inside &= back <= np.maximum(0.5 * np.abs(last), _LAST_NEWTON * np.abs(x) + round_off)
        previous, x = x, np.where(inside, newton, 0.5 * (lower + upper))
        last = x - previous
        enough = np.where(inside, _LAST_NEWTON, _LAST_BISECTION)
        if np.all(np.abs(last) <= enough * np.abs(x) + round_off):
            break
    return x
