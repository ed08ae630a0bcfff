"""Rate dependence: a bond and a spring against their differential equation; one root a step."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from support import laws_scalar as oracle

from vmdg.laws import (
    Debonding,
    ExponentialDebonding,
    IntrinsicExponential,
    MixedModeDebonding,
    TrapezoidalDebonding,
)

P, ZETA, SPEED = 100.0, 0.2, 3.0
H = P / ZETA
NORMAL = np.array([[1.0, 0.0]])

# Each with its R(zeta) in pure opening.
LAWS = {
    "linear": (lambda nu: Debonding(P, ZETA, viscosity=nu), lambda z: P - H * z),
    "exponential": (
        lambda nu: ExponentialDebonding(P, P**2 / H, viscosity=nu),
        lambda z: P * np.exp(-z * H / P),
    ),
    "trapezoidal": (
        lambda nu: TrapezoidalDebonding(P, 0.05, 0.05 + ZETA, viscosity=nu),
        lambda z: min(P, H * (0.05 + ZETA - z)),
    ),
    "mixed": (
        lambda nu: MixedModeDebonding(P, P / 2, P * ZETA / 2, P * ZETA / 3, viscosity=nu),
        lambda z: P - H * z,
    ),
}


def exact(resistance, spring, viscosity):
    """Spring and bond in series, led at SPEED from the onset until 70% of the bond is gone.

    T = k (u - zeta) = R + viscosity dzeta/dt R/P: the time it takes, and T of a time.
    """

    def traction(t, zeta):
        return P + spring * (SPEED * t - zeta)

    def rate(t, zeta):
        R = resistance(zeta[0])
        return [max(traction(t, zeta[0]) - R, 0.0) * P / (viscosity * R)]

    def gone(t, zeta):
        return resistance(zeta[0]) - 0.3 * P

    gone.terminal = True
    close = {"method": "Radau", "rtol": 1e-10, "atol": 1e-13, "max_step": 0.005}
    solution = solve_ivp(rate, (0.0, 10.0), [0.0], events=gone, dense_output=True, **close)
    return solution.t[-1], lambda t: traction(t, solution.sol(t)[0])


def marched(law, spring, times, penalty):
    """T of the return maps at these times; T_tr = k (u - g) + r (g - zeta_n), g = zeta at the end.

    The equation for g is solved by Newton's method with the tangent of the law.
    """
    gap, softening, tractions, dt = np.zeros((1, 2)), np.zeros(1), [], times[0]
    for t in times:
        g = gap[0, 0]
        for _ in range(50):
            load = P + spring * (SPEED * t - g) + penalty * (g - gap[0, 0])
            update = law.return_map(load * NORMAL, NORMAL, gap, softening, penalty, dt)
            excess = update.gap[0, 0] - g
            g -= excess / (update.tangent[0, 0, 0] * (penalty - spring) - 1.0)
            if abs(excess) < 1e-14:
                break
        gap, softening = update.gap, update.softening
        tractions.append(update.traction[0, 0])
    return np.array(tractions)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize(("stiff", "overstress"), [(2.0, 0.1), (20.0, 1.0), (2.0, 100.0)])
def test_spring_and_bond_follow_their_differential_equation(name, stiff, overstress):
    """Overstress of so many strengths at the speed of the spring; first order in the step; r, a
    number of the mesh, does not enter."""
    make, resistance = LAWS[name]
    viscosity, spring = overstress * P / SPEED, stiff * H
    law = make(viscosity)
    end, traction = exact(resistance, spring, viscosity)
    errors = []
    for steps in (220, 440):
        times = end * np.arange(1, steps + 1) / steps
        wanted = traction(times)
        found, other = (marched(law, spring, times, r) for r in (2.0 * H, 40.0 * H))
        assert np.abs(found - other).max() < 1e-9 * wanted.max()
        errors.append(np.abs(found - wanted).max() / wanted.max())
    assert errors[1] < 0.02
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.35)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    name=st.sampled_from(sorted(LAWS)),
    ratio=st.sampled_from([1.01, 2.0, 50.0]),
    eta=st.floats(-3.0, 5.0).map(lambda power: 10.0**power * H),
    worn=st.floats(0.0, 0.999),
    mode=st.sampled_from(["opening", "shear"]),
)
def test_one_root_whatever_the_viscosity(name, ratio, eta, worn, mode):
    """The trial traction r x + R(x) + eta x R_n/P grows with x, and every x comes back from its
    own, also beyond the end of the bond, in opening and in shear."""
    law = LAWS[name][0](eta)
    bond = law.in_opening if mode == "opening" else law.in_shear
    r, x = ratio * law.softening_modulus, np.linspace(0.0, 2.0 * ZETA, 2001)[1:]
    left = np.full_like(x, (1.0 - worn) * bond.strength)
    c = eta * bond.resistance(left) / bond.strength
    R = bond.soften(left, x)[0]
    load = (r + c) * x + R
    assert (np.diff(np.append(bond.resistance(left[:1]), load)) > 0.0).all()
    normal, softening = np.tile(NORMAL, (len(x), 1)), np.full_like(x, worn * law.strength)
    pressed = np.full_like(x, -1e-30)
    parts = (load, 0.0 * x) if mode == "opening" else (pressed, load)
    trial = np.stack(parts, axis=1)
    update = law.return_map(trial, normal, 0.0 * trial, softening, r)
    slack = max(1.0, 0.1 / (ratio - 1.0))
    np.testing.assert_allclose(update.multiplier, x, rtol=1e-10 * slack)
    borne = np.linalg.norm(update.traction, axis=1)
    np.testing.assert_allclose(borne, R + c * x, rtol=1e-9 * slack, atol=1e-11 * load.max() * slack)


IN_CONTACT = {
    "linear": Debonding(P, ZETA, 0.4, H),
    "gradual": Debonding(P, ZETA, 0.4, 9.0 * H, gradual_friction=True),
    "exponential": ExponentialDebonding(P, 10.0, 0.4, 0.2 * H),
    "mixed": MixedModeDebonding(P, 60.0, 10.0, 18.0, 0.4, H),
    "BK": MixedModeDebonding(P, 60.0, 10.0, 18.0, 0.4, 30.0 * H, criterion="BK", exponent=2.0),
    "intrinsic": IntrinsicExponential(P, 10.0, viscosity=2.0 * H),
}


@pytest.mark.parametrize("name", IN_CONTACT)
@settings(max_examples=10, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), d=st.sampled_from([2, 3]))
def test_what_is_not_overstress_is_borne_without_a_rate(name, seed, d):
    """T - V is what the law without viscosity bears at the same gap, but where friction alone would
    be more than the bond alone; each point has its own time step."""
    law, rng = IN_CONTACT[name], np.random.default_rng(seed)
    state, dt = oracle.random_state(rng, law, 200, d, 3.0), 10.0 ** rng.uniform(-3.0, 3.0, 200)
    update = law.return_map(*state, dt=dt)
    for i in range(0, 200, 29):
        alone = law.return_map(*(a[i : i + 1] for a in state), dt=float(dt[i]))
        np.testing.assert_allclose(alone.traction[0], update.traction[i], rtol=1e-12, atol=1e-12)
    step = update.gap - state.gap
    load = update.traction - update.overstress + state.penalty[:, None] * step
    again = replace(law, viscosity=0.0).return_map(load, *state[1:])
    borne = update.traction - update.overstress
    normal = np.einsum("ij,ij->i", borne, state.normal)
    shear = np.linalg.norm(borne - normal[:, None] * state.normal, axis=1)
    same = (normal >= 0.0) | (shear >= -law.friction * normal) | ~update.overstress.any(axis=1)
    assert same.mean() > 0.9
    np.testing.assert_allclose(again.gap[same], update.gap[same], rtol=1e-9, atol=1e-11 * ZETA)
    left, wanted = again.softening[same], update.softening[same]
    np.testing.assert_allclose(left, wanted, rtol=1e-9, atol=1e-9 * P)
    assert (update.overstress.any(axis=1) & (update.damage_work > 0.0)).sum() > 40
    assert not update.overstress[update.multiplier == 0.0].any()
