"""Laws whose parameters vary: at every point the law of the numbers there."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from vmdg.laws import (
    Contact,
    Debonding,
    ExponentialDebonding,
    FatigueDebonding,
    IntrinsicExponential,
    MixedModeDebonding,
    TrapezoidalDebonding,
    Update,
)
from vmdg.laws.base import joined_laws, same_law

N, R = 240, 4e3


def between(low: float, high: float, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, N)


P, G, MU = between(5, 15, 1), between(0.3, 0.6, 2), between(0.0, 0.8, 3)
SHEARED = {"shear_strength": between(8, 20, 4), "shear_energy": between(0.6, 1.2, 5)}
MIXED = {"normal_strength": P, "normal_energy": G, "friction": MU, **SHEARED}
CASES = {
    "contact": (Contact, {"friction": MU}),
    "weakening": (Contact, {"friction": MU, "dynamic_friction": MU / 2, "slip_distance": G / 50}),
    "linear": (Debonding, {"strength": P, "critical_gap": G, "friction": MU, "viscosity": 3.0}),
    "secant": (
        Debonding,
        {"strength": P, "critical_gap": 0.1, "friction": MU, "unloading": "secant"},
    ),
    "gradual": (
        Debonding,
        {"strength": 9.0, "critical_gap": G, "friction": MU, "gradual_friction": True},
    ),
    "exponential": (ExponentialDebonding, {"strength": P, "fracture_energy": G, "friction": MU}),
    "trapezoidal": (
        TrapezoidalDebonding,
        {"strength": P, "plateau_gap": G / 9, "critical_gap": G, "friction": 0.3},
    ),
    "intrinsic": (
        IntrinsicExponential,
        {"strength": P, "fracture_energy": G, "shear_weight": 1 + MU, "viscosity": 2.0},
    ),
    "mixed": (MixedModeDebonding, MIXED),
    "BK": (MixedModeDebonding, MIXED | {"criterion": "BK", "exponent": 1.6}),
    "power, secant": (
        MixedModeDebonding,
        MIXED | {"criterion": "power", "exponent": 1.3, "unloading": "secant"},
    ),
    "fatigue": (FatigueDebonding, MIXED),
}


def steps(law, choose=slice(None)) -> list[Update]:
    """Points open, slide under pressure, close and open again, each by its own amounts."""
    draws = np.random.default_rng(7)
    normal = np.tile([0.6, 0.8], (N, 1))[choose]
    gap, softening = np.zeros_like(normal), np.zeros(len(normal))
    updates = []
    for _ in range(5):
        load = draws.uniform(-60, 60, (N, 2))[choose]
        more = (1e3,) if law.fatigues else ()
        arguments = load - R * gap, normal, gap, softening, R, 0.1, *more
        update = law.return_map(*arguments)
        gap, softening = update.gap, update.softening
        updates.append(update)
    return updates


@pytest.mark.parametrize("case", CASES)
def test_equals_one_law_a_point(case):
    """All that a return map gives, in all branches, is what a law of one number gives there."""
    kind, parameters = CASES[case]
    together = steps(kind(**parameters))
    assert len({mode for update in together for mode in update.mode}) >= 3
    arrays = {name: v for name, v in parameters.items() if isinstance(v, np.ndarray)}
    for i in range(0, N, 7):
        law = kind(**parameters | {name: float(v[i]) for name, v in arrays.items()})
        for all_of, alone in zip(together, steps(law, slice(i, i + 1)), strict=True):
            for field in fields(Update):
                value = getattr(all_of, field.name)
                scale = np.abs(value).max()
                difference = np.abs(value[i] - getattr(alone, field.name)[0]).max()
                assert difference <= 1e-11 * scale, (i, field.name)


@pytest.mark.parametrize("case", CASES)
def test_energies_and_moduli(case):
    """So are H, the strength used up, what is stored and what rubs."""
    kind, parameters = CASES[case]
    law, arrays = kind(**parameters), [k for k, v in parameters.items() if np.ndim(v)]
    normal, gap = np.tile([0.6, 0.8], (N, 1)), np.full((N, 2), 0.02)
    softening = 0.4 * np.broadcast_to(law.strength, N)

    def values(law, rows):
        return (
            law.softening_modulus,
            law.utilization(normal[rows, 0], normal[rows, 1]),
            law.stored_energy(gap[rows], normal[rows], softening[rows]),
            law.rubbing(softening[rows]),
        )

    found = values(law, slice(None))
    for i in range(0, N, 40):
        one = law.with_values({name: float(parameters[name][i]) for name in arrays})
        expected = values(one, slice(i, i + 1))
        for value, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(np.broadcast_to(value, N)[i], other, rtol=1e-11)


def test_parts_and_whole():
    """Laws at some of their points, and joined again; what they have found goes with them."""
    law = MixedModeDebonding(**MIXED, criterion="BK", exponent=2.0)
    moduli, rows = law.softening_modulus, np.arange(N) % 3 == 0
    parts = [law.at(rows), law.at(np.flatnonzero(~rows))]
    np.testing.assert_array_equal(parts[0].softening_modulus, moduli[rows])
    np.testing.assert_array_equal(parts[0].in_shear.strength, SHEARED["shear_strength"][rows])
    whole = joined_laws(parts)
    np.testing.assert_array_equal(whole.softening_modulus[: rows.sum()], moduli[rows])
    np.testing.assert_array_equal(whole.normal_strength[rows.sum() :], P[~rows])
    assert Debonding(1.0, 2.0).at(rows) == Debonding(1.0, 2.0)


def test_equal_laws():
    """Equal numbers, arrays and functions make equal laws, whose points are mapped together."""
    field = lambda x: x[0]  # noqa: E731
    assert same_law(Debonding(P, 0.1), Debonding(P.copy(), 0.1))
    assert not same_law(Debonding(P, 0.1), Debonding(P, 0.2))
    assert not same_law(Debonding(P, 0.1), Debonding(P + 1, 0.1))
    assert same_law(Debonding(field, 0.1), Debonding(field, 0.1))
    assert not same_law(Debonding(field, 0.1), Debonding(lambda x: x[0], 0.1))
    assert not same_law(Debonding(1.0, 0.1), ExponentialDebonding(1.0, 0.1))


def test_refused():
    """Values out of range, of a wrong shape, without their points, and what may not vary."""
    for value, kind, message in (
        (np.array([1.0, -2.0]), ValueError, r"strength = -2.0: must be positive and finite"),
        ([1.0, np.nan], ValueError, r"strength = nan"),
        (np.ones((2, 2)), TypeError, r"(?s)strength = .* an array with a number for every facet"),
        ("strong", TypeError, "strength = 'strong': must be one number"),
    ):
        with pytest.raises(kind, match=message):
            Debonding(value, 0.1)
    with pytest.raises(TypeError, match=r"viscosity = .*must be one number"):
        Debonding(1.0, 0.1, viscosity=np.ones(3))
    with pytest.raises(ValueError, match="plateau_gap"):
        TrapezoidalDebonding(1.0, np.array([0.1, 0.3]), 0.2)
    for value in (lambda x: x[0], np.ones(3)):
        with pytest.raises(ValueError, match=r"strength varies: at 2 points it must be one number"):
            Debonding(value, 0.1).return_map(
                np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 2)), np.zeros(2), 1e3
            )
    values = np.ones(3)
    law = Debonding(values, 0.1)
    values[:] = 7.0
    assert law.strength.max() == 1.0
