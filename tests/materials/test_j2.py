"""Return map of J2: yield condition, paths in one and many steps, cycles in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from scipy.optimize import brentq
from support.plastic import DT, ELASTIC, J2, KINDS, TENSORS, E, after, deformed, kirchhoff

import vmdg
from vmdg.materials.plasticity import unpack

G = ELASTIC[0] / (2 * (1 + ELASTIC[1]))
EVERY = pytest.mark.parametrize(("name", "small"), [kind for kind in KINDS if kind[0] in J2])


@EVERY
@given(first=TENSORS, second=TENSORS)
def test_yield_condition(name, small, first, second):
    """q = sigma_y + rate dalpha/dt where alpha grows, and no more elsewhere."""
    material, found = after(name, small, first, second)
    before = 0.0
    for gradient, answer in zip((first, second), found, strict=True):
        tau = kirchhoff(answer, gradient, small)
        assert np.abs(tau - tau.T).max() < 1e-10 * (1 + np.abs(tau).max())
        alpha = answer.state[:, 0]
        strain = answer.state[:, 7:] if material.numbers["recovery"] else answer.state[:, 1:7]
        back = 2 / 3 * material.numbers["kinematic"] * unpack(strain)[0]
        xi = tau - np.trace(tau) / 3 * np.eye(3) - back
        q = np.sqrt(1.5 * (xi**2).sum())
        grown = float(alpha[0] - before)
        allowed = material.yield_stress(alpha)[0] + material.numbers["rate"] * grown / DT
        assert grown >= 0
        assert q <= allowed * (1 + 1e-9)
        if grown > 1e-12:
            assert q == pytest.approx(allowed[0], rel=1e-8)
        before = float(alpha[0])


@pytest.mark.parametrize("small", [True, False])
@given(first=TENSORS, second=TENSORS)
def test_function_of_hardening(small, first, second):
    """Voce hardening as a function of one's own: the same stress, work, history and moduli."""
    own = vmdg.J2(
        *ELASTIC, hardening=lambda a: 20.0 + 40.0 * a + 10.0 * (1 - np.exp(-15.0 * a)), rate=None
    )
    _, found = after("voce", small, first, second)
    state = own.start(1)
    for gradient, other in zip((first, second), found, strict=True):
        before, one = state, own(deformed(gradient, small), state, small=small)
        state = one.state
        assert one.stress == pytest.approx(other.stress, abs=1e-9 * E)
        assert one.state == pytest.approx(other.state, abs=1e-11)
        assert one.dissipated == pytest.approx(other.dissipated, abs=1e-10)
        # Where a point is about to flow, rounding decides.
        if one.state[0, 0] > before[0, 0] + 1e-9:
            assert one.moduli == pytest.approx(other.moduli, abs=1e-7 * E)


C, R, YIELD = 900.0, 40.0, 20.0


def test_cycles_in_shear():
    """A half cycle in one step: sqrt(3) tau = beta + sigma_y with the exact back stress
    beta = +-C/R + (beta_0 -+ C/R) exp(-R dalpha); cycles settle at C/R tanh(R dalpha/2).
    """
    material = vmdg.J2(*ELASTIC, YIELD, kinematic=C, recovery=R)
    state, slip, beta, sizes = material.start(1), 0.0, 0.0, []
    for cycle in range(60):
        sign, shear = (-1) ** cycle, 0.03 * (-1) ** cycle

        def stress(a, slip=slip, sign=sign, shear=shear):
            """sqrt(3) tau after a growth of alpha."""
            return np.sqrt(3) * 2 * G * (shear - slip - sign * np.sqrt(3) / 2 * a)

        def back(a, beta=beta, sign=sign):
            return sign * C / R + (beta - sign * C / R) * np.exp(-R * a)

        a = brentq(lambda a, s=sign: s * (stress(a) - back(a)) - YIELD, 0.0, 0.2, xtol=1e-16)
        strain = np.zeros((1, 3, 3))
        strain[0, 0, 1] = strain[0, 1, 0] = shear
        answer = material(strain, state, DT, True)
        assert np.sqrt(3) * answer.stress[0, 0, 1] == pytest.approx(stress(a), rel=1e-10)
        assert answer.state[0, 0] - state[0, 0] == pytest.approx(a, rel=1e-10)
        slip, beta, state = slip + sign * np.sqrt(3) / 2 * a, back(a), answer.state
        sizes.append(abs(beta))
    assert sizes[-1] == pytest.approx(C / R * np.tanh(R * a / 2), rel=1e-10)
    assert np.abs(sizes[-1] - sizes[0]) > 0.01 * sizes[-1]


def test_refused_parameters():
    """Words at the door."""
    for arguments, words in (
        ({"yield_stress": -1.0}, "positive"),
        ({"yield_stress": 1.0, "hardening": -1.0}, "not negative"),
        ({"yield_stress": 1.0, "saturation": 2.0}, "exponent"),
        ({"yield_stress": 2.0, "saturation": 1.0, "exponent": 1.0}, "soften"),
        ({"yield_stress": 2.0, "recovery": 1.0}, "fades"),
        ({"yield_stress": 2.0, "hardening": [(0, 1.0), (1, 2.0)]}, "begins with"),
        ({"hardening": lambda a: 20.0 - a}, "not decreasing"),
        ({"hardening": lambda a: 20.0}, "must return the yield stress of an array"),
        ({"yield_stress": 2.0, "hardening": lambda a: 20.0 + a}, "begins with"),
        ({"hardening": [(0.1, 1.0), (1, 2.0)]}, "start at alpha = 0"),
        ({"hardening": [(0, 2.0), (1, 1.0)]}, "does not decrease"),
    ):
        with pytest.raises(ValueError, match=words):
            vmdg.J2(*ELASTIC, **arguments)
    with pytest.raises(TypeError, match="yield_stress"):
        vmdg.J2(*ELASTIC)
    with pytest.raises(TypeError, match="hyperelastic"):
        vmdg.PointMaterial(J2["voce"])
