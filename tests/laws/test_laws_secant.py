"""Unloading to the origin: curves, cycles, energies, gradual friction."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from support.points import follow, total

from vmdg.laws import (
    Debonding,
    ExponentialDebonding,
    MixedModeDebonding,
    Mode,
    TrapezoidalDebonding,
)

P_N, P_S, G_N, G_S = 40.0, 60.0, 0.3, 1.1
NORMAL = np.array([[1.0, 0.0]])
MU, PRESSURE = 0.5, 50.0

CRITERIA = {"linear": None, "BK": 2.284, "power": 2.0}


def mixed(criterion="linear", friction=0.0, unloading="secant"):
    return MixedModeDebonding(
        *(P_N, P_S, G_N, G_S, friction),
        criterion=criterion,
        exponent=CRITERIA[criterion],
        unloading=unloading,
    )


LAWS = {
    "linear": lambda mu=0.0: Debonding(P_N, 0.02, mu, unloading="secant"),
    "exponential": lambda mu=0.0: ExponentialDebonding(P_N, 0.4, mu, unloading="secant"),
    "trapezoidal": lambda mu=0.0: TrapezoidalDebonding(P_N, 0.004, 0.02, mu, unloading="secant"),
    "BK": lambda mu=0.0: mixed("BK", mu),
}
EVERY_LAW = pytest.mark.parametrize("make", LAWS.values(), ids=LAWS.keys())


def led(law, gaps, ratio=3.0, pressure=0.0):
    """Updates of a point between rigid bodies that open along a path (m, 2), N = first axis."""
    r = ratio * law.softening_modulus
    loads = r * np.asarray(gaps)[:, None]
    loads[:, :, 0] -= pressure
    return follow(law, loads, NORMAL, r)


def path(corners, steps):
    s = np.linspace(0.0, 1.0, steps + 1)[1:, None]
    return np.concatenate([a + s * (b - a) for a, b in pairwise(np.asarray(corners))])


@EVERY_LAW
def test_below_the_largest_gap_the_bond_is_a_spring_that_costs_nothing(make):
    """Cycles of constant amplitude, also in other directions: T = K (H_n zeta_N, H_s zeta_T)."""
    law, top = make(), np.array([0.006, 0.004])
    r = 3.0 * law.softening_modulus
    there = led(law, [1.5 * top])
    gap, traction, softening = there[-1].gap, there[-1].traction, there[-1].softening
    ratio = (traction / gap)[0]
    state, spent = (gap, softening), 0.0
    for part in (0.5, 0.1, 0.9, 0.0, 0.7, 0.9999) * 50:
        wanted = part * gap
        trial = ratio * wanted + r * (wanted - state[0])
        update = law.return_map(trial, NORMAL, *state, r)
        np.testing.assert_allclose(update.gap, wanted, atol=1e-15)
        np.testing.assert_allclose(update.traction, ratio * wanted, atol=1e-11)
        spent += update.damage_work[0] + update.friction_work[0]
        state = update.gap, update.softening
    assert spent == 0.0
    assert state[1][0] == softening[0]
    turned = 0.5 * gap * [[1.0, -1.0]]
    update = law.return_map(ratio * turned + r * (turned - state[0]), NORMAL, *state, r)
    np.testing.assert_allclose(update.traction, ratio * turned, atol=1e-11)
    assert update.mode[0] == Mode.ELASTIC
    # from the largest gap on it softens as if nothing had been in between
    beyond = 1.2 * traction + r * 2.0 * gap
    further = law.return_map(beyond - r * state[0], NORMAL, *state, r)
    again = law.return_map(beyond - r * gap, NORMAL, gap, softening, r)
    np.testing.assert_allclose(further.traction, again.traction, rtol=1e-12)
    assert further.damage_work[0] == pytest.approx(again.damage_work[0], rel=1e-9)
    assert again.damage_work[0] > 0.0


@EVERY_LAW
def test_traction_is_the_derivative_of_the_stored_energy(make):
    law, h = make(), 1e-8
    softening = np.full(1, 0.4 * law.strength)
    r, gap = 3.0 * law.softening_modulus, np.array([[1.2e-3, 0.9e-3]])
    update = law.return_map(np.zeros((1, 2)), NORMAL, gap, softening, r)
    assert update.softening[0] == softening[0]
    for i in range(2):
        ends = [update.gap + sign * h * np.eye(2)[i] for sign in (1, -1)]
        above, below = (law.stored_energy(end, NORMAL, softening)[0] for end in ends)
        assert (above - below) / (2 * h) == pytest.approx(update.traction[0, i], rel=1e-6)


# --- friction of the parted share -----------------------------------------------------------------


@pytest.mark.parametrize("unloading", ["secant", "plastic"])
@pytest.mark.parametrize("steps", [1, 8, 60])
def test_slip_at_constant_pressure(steps, unloading):
    """T = (1 - d) P_s + d mu p with d = zeta/zeta_s; works by the areas (Alfano and Sacco 2006)."""
    law, end = mixed(friction=MU, unloading=unloading), 0.7
    law = replace(law, gradual_friction=True)
    zeta_s = 2 * G_S / P_S
    r, d = 3.0 * law.softening_modulus, end * np.arange(1, steps + 1) / steps
    shear = (1.0 - d) * P_S + d * MU * PRESSURE
    loads = [np.array([[-PRESSURE, t + r * zeta_s * x]]) for t, x in zip(shear, d, strict=True)]
    updates = follow(law, loads, NORMAL, r)
    for update, t, x in zip(updates, shear, d, strict=True):
        np.testing.assert_allclose(update.gap, [[0.0, zeta_s * x]], rtol=1e-11)
        np.testing.assert_allclose(update.traction, [[-PRESSURE, t]], rtol=1e-11)
        assert update.mode[0] == Mode.SHEAR
    stored = law.stored_energy(updates[-1].gap, NORMAL, updates[-1].softening)[0]
    assert stored == pytest.approx(G_S * end * (1 - end) * (unloading == "secant"), rel=1e-11)
    assert total(updates) + stored == pytest.approx(G_S * (1 - (1 - end) ** 2), rel=1e-11)
    rubbed = 0.5 * end**2 * zeta_s * MU * PRESSURE
    assert total(updates, "friction_work") == pytest.approx(rubbed, rel=1e-11)


def test_wrong_options_are_refused():
    with pytest.raises(ValueError, match="unloading = 'elastic': must be one of"):
        Debonding(P_N, 0.02, unloading="elastic")
    with pytest.raises(ValueError, match=r"gradual_friction = False: .*leave it None"):
        Debonding(P_N, 0.02, unloading="secant", gradual_friction=False)
    with pytest.raises(ValueError, match=r"gradual_friction = 'yes': must be"):
        Debonding(P_N, 0.02, gradual_friction="yes")
    with pytest.raises(ValueError, match=r'viscosity = 2\.0: .*use viscosity=0, or unloading="pl'):
        Debonding(P_N, 0.02, viscosity=2.0, unloading="secant")
