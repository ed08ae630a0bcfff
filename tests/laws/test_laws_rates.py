"""Rate dependence: a bond and a spring against their differential equation; one root a step."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vmdg.laws import (
    Debonding,
    ExponentialDebonding,
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
