"""`Update.work_gradient`, d damage_work/d T_tr, of every law, and by differences where unknown."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import laws_scalar as oracle

from vmdg.laws import (
    Debonding,
    ExponentialDebonding,
    FatigueDebonding,
    IntrinsicExponential,
    MixedModeDebonding,
    Mode,
    TrapezoidalDebonding,
)
from vmdg.laws.base import work_gradient

P, ZETA, POINTS = 100.0, 0.2, 200
H = P / ZETA
MIXED = (P, 60.0, 10.0, 18.0)
BK, POWER = {"criterion": "BK", "exponent": 2.3}, {"criterion": "power", "exponent": 1.7}
SECANT, GRADUAL = {"unloading": "secant"}, {"gradual_friction": True}

# Of friction and viscosity.
LAWS = {
    "linear": lambda mu, nu: Debonding(P, ZETA, mu, nu),
    "exponential": lambda mu, nu: ExponentialDebonding(P, 10.0, mu, nu),
    "trapezoidal": lambda mu, nu: TrapezoidalDebonding(P, 0.05, 0.15, mu, nu),
    "mixed": lambda mu, nu: MixedModeDebonding(*MIXED, mu, nu),
    "BK": lambda mu, nu: MixedModeDebonding(*MIXED, mu, nu, **BK),
    "power": lambda mu, nu: MixedModeDebonding(P, 150.0, 10.0, 30.0, mu, nu, **POWER),
    "linear gradual": lambda mu, nu: Debonding(P, ZETA, mu, nu, **GRADUAL),
    "trapezoidal gradual": lambda mu, nu: TrapezoidalDebonding(P, 0.05, 0.15, mu, nu, **GRADUAL),
    "mixed gradual": lambda mu, nu: MixedModeDebonding(*MIXED, mu, nu, **GRADUAL),
    "intrinsic": lambda mu, nu: IntrinsicExponential(P, 10.0, 2.0, nu),
    "linear secant": lambda mu, nu: Debonding(P, ZETA, mu, **SECANT),
    "exponential secant": lambda mu, nu: ExponentialDebonding(P, 10.0, mu, **SECANT),
    "trapezoidal secant": lambda mu, nu: TrapezoidalDebonding(P, 0.05, 0.15, mu, **SECANT),
    "mixed secant": lambda mu, nu: MixedModeDebonding(*MIXED, mu, **SECANT),
    "BK secant": lambda mu, nu: MixedModeDebonding(*MIXED, mu, **BK, **SECANT),
    "fatigue": lambda mu, nu: FatigueDebonding(*MIXED, mu),
    "fatigue BK": lambda mu, nu: FatigueDebonding(*MIXED, mu, **BK),
    "fatigue power": lambda mu, nu: FatigueDebonding(P, 150.0, 10.0, 30.0, mu, **POWER),
}

cases = {
    "d": st.sampled_from([2, 3]),
    "seed": st.integers(0, 2**32 - 1),
    "ratio": st.sampled_from([1.5, 4.0, 100.0]),
    "mu": st.sampled_from([0.0, 0.475, 2.0]),
    "nu": st.sampled_from([0.0, 0.5 * H, 50.0 * H]),
}


def mapped(law, state, cycles):
    return law.return_map(*state, 1.0, *((cycles,) if law.fatigues else ()))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.long] * (name in ("fatigue", "fatigue power")))
        for name in LAWS
    ],
)
@settings(max_examples=6, deadline=None, derandomize=True)
@given(**cases)
def test_is_the_derivative_of_the_damage_work(name, d, seed, ratio, mu, nu):
    """Central differences away from kinks; zero where nothing is spent; it is there in all laws."""
    law, rng = LAWS[name](mu, nu), np.random.default_rng(seed)
    state, cycles = (
        oracle.random_state(rng, law, POINTS, d, ratio),
        10 ** rng.uniform(-1, 8, POINTS),
    )
    update = mapped(law, state, cycles)
    assert not update.work_gradient[update.damage_work == 0.0].any()
    assert not update.work_gradient[update.mode == Mode.ELASTIC].any()

    h, smooth, difference = 1e-5 * P, np.ones(POINTS, dtype=bool), np.zeros((POINTS, d))
    for j, axis in enumerate(np.eye(d)):
        ends = [
            mapped(law, state._replace(trial=state.trial + s * h * axis), cycles)
            for s in (1.0, -1.0, 30.0, -30.0)
        ]
        one, other, far, back = (end.damage_work for end in ends)
        difference[:, j] = (one - other) / (2.0 * h)
        wide = (far - back) / (60.0 * h)
        # a kink, or a direction that turns fast, changes the difference with its width
        smooth &= np.abs(wide - difference[:, j]) <= 1e-3 * np.abs(wide) + 1e-6 * P / state.penalty
    assert smooth.mean() > 0.5
    error = np.abs(update.work_gradient - difference).max(1) * state.penalty / P
    size = np.abs(difference).max(1) * state.penalty / P
    assert (error[smooth] <= 2e-5 * (size[smooth] + 1.0)).all()
    assert size[smooth].max() > 0.01


@dataclass(frozen=True)
class Silent(Debonding):
    """Says nothing of the gradient, or zero, as one that fills `Update.elastic` without it."""

    says: str = "nothing"

    def return_map(self, *arguments):
        """That of the base class, less the gradient."""
        update = super().return_map(*arguments)
        none = None if self.says == "nothing" else np.zeros_like(update.work_gradient)
        return replace(update, work_gradient=none)


@pytest.mark.parametrize("says", ["nothing", "zero"])
@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e9])
def test_laws_that_do_not_say_it_are_asked_by_differences(says, scale):
    """In any unit of stress, where something is spent; what a law says is taken as it is."""
    law, silent = Debonding(scale * P, ZETA, 0.3), Silent(scale * P, ZETA, 0.3, says=says)
    state = oracle.random_state(np.random.default_rng(2), law, POINTS, 3, 3.0)
    update = law.return_map(*state)
    said = work_gradient(law, update, *state, 1.0)
    np.testing.assert_array_equal(said, update.work_gradient)
    found = work_gradient(silent, silent.return_map(*state), *state, 1.0)
    error = np.abs(found - said).max(1) / np.abs(said).max()
    # but for kinks in the increment
    assert np.median(error[said.any(1)]) < 1e-8
    assert (error > 1e-6).sum() <= 2
    assert not found[update.damage_work == 0.0].any()
