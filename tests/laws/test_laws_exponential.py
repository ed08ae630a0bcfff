"""`ExponentialDebonding` and `IntrinsicExponential` against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vmdg.laws import IntrinsicExponential

SETTINGS = settings(max_examples=50, deadline=None, derandomize=True)

# The two-inclusion problem of the benchmarks.
STRENGTH, ENERGY = 50.0, 0.5
DELTA_0 = ENERGY / (math.e * STRENGTH)
STIFFNESS = ENERGY / DELTA_0**2


# --- rigid ----------------------------------------------------------------------------------------


# --- intrinsic ------------------------------------------------------------------------------------


def tour(normal_opening, sliding, damage):
    """Traction of the tour's law and its damage, one opening after the other."""
    delta = math.hypot(normal_opening, 2.0 * sliding)
    damage = max(damage, 1.0 - math.exp(-delta / DELTA_0))
    secant = STIFFNESS * (1.0 - damage)
    return secant * normal_opening, secant * sliding, damage


@SETTINGS
@given(
    st.lists(st.tuples(st.floats(0.0, 0.05), st.floats(-0.05, 0.05)), min_size=1, max_size=12),
    st.sampled_from([1.001, 2.0, 1e3]),
)
def test_intrinsic_follows_the_tour_through_loading_and_unloading(path, ratio):
    """Where the trial is what makes zeta the wanted opening, T is the tour's T."""
    law = IntrinsicExponential(STRENGTH, ENERGY)
    assert law.stiffness == pytest.approx(STIFFNESS, rel=1e-14)
    r = ratio * law.softening_modulus
    gap, softening, damage = np.zeros((1, 2)), np.zeros(1), 0.0
    for wanted in path:
        t_n, t_t, damage = tour(*wanted, damage)
        trial = np.array([[t_n, t_t]]) + r * (np.array([wanted]) - gap)
        update = law.return_map(trial, np.array([[1.0, 0.0]]), gap, softening, r)
        # round-off of the trial, enlarged where the slope r + dT/dzeta is small
        tol = 1e-13 * (1.0 + 1.0 / (ratio - 1.0))
        np.testing.assert_allclose(update.gap, [wanted], atol=tol * 0.1)
        np.testing.assert_allclose(update.traction, [[t_n, t_t]], atol=tol * STRENGTH * ratio)
        assert update.softening[0] == pytest.approx(STRENGTH * damage, abs=tol * STRENGTH)
        gap, softening = update.gap, update.softening
