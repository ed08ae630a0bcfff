"""Work along a path: the trapezoidal rule and what the curvature of the path adds."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

from mpi4py import MPI

import numpy as np
import pytest

from vmdg.problem.work import next_arc


def work(states: np.ndarray, forces: Callable) -> tuple[float, float]:
    """int f.du over rows of states, by the trapezoidal rule and as it is corrected."""
    arc, plain, added = None, 0.0, 0.0
    for start, end in pairwise(states):
        f = forces(start), forces(end)
        plain += (f[0] + f[1]) @ (end - start) / 2
        arc, correction = next_arc(MPI.COMM_SELF, arc, f[1] - f[0], end - start)
        added += correction
    return plain, plain + added


def curve(steps: int) -> np.ndarray:
    """A path that turns back, in steps of different lengths."""
    s = np.linspace(0, 1, steps + 1) ** 1.3
    return np.stack([np.sin(2 * s), s**2], axis=1)


def test_smooth_path():
    """The error of a smooth path falls with the third power of the step (its end), from less."""

    def forces(u):
        return np.array([np.exp(u[1]) + u[0], u[0] * u[1]])

    exact = work(curve(20000), forces)[0]
    errors = np.abs([np.subtract(work(curve(steps), forces), exact) for steps in (20, 40)])
    assert errors[0, 1] < 0.2 * errors[0, 0]
    assert np.log2(errors[0] / errors[1])[1] > 2.8


@pytest.mark.parametrize("kink", [0.5, 0.53])
def test_kinks(kink):
    """Straight lines between steps stay exact; a kink inside one costs no more than before."""
    states = np.linspace(0, 1, 11)[:, None]
    plain, corrected = work(states, lambda u: np.minimum(u, 2 * kink - u))
    exact = kink**2 / 2 + (1 - kink) * (3 * kink - 1) / 2
    assert abs(corrected - exact) <= abs(plain - exact) + 1e-15


def test_rest():
    """A step of no length has no curvature, nor has the one after it."""
    arc, correction = next_arc(MPI.COMM_SELF, None, np.zeros(2), np.zeros(2))
    assert next_arc(MPI.COMM_SELF, arc, np.ones(2), np.ones(2))[1] == correction == 0
