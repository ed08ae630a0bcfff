"""Friction that weakens with slip: return map, tangent, works, and a block that slides."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vmdg.laws import Contact, Mode

STATIC, DYNAMIC, D = 0.6, 0.4, 0.05
LAW = Contact(STATIC, dynamic_friction=DYNAMIC, slip_distance=D)
SETTINGS = settings(deadline=None, max_examples=40, derandomize=True)
dims, seeds = st.sampled_from([2, 3]), st.integers(0, 2**31)


def states(d, seed, n=60):
    """Trial tractions, normals, gaps, slip paths and penalties above the steepest descent."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(n, d))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    trial, path = rng.normal(0, 40, (n, d)), rng.uniform(0, 1.5 * D, n)
    gap = rng.normal(0, 0.01, (n, d))
    gap -= np.minimum(np.einsum("pi,pi->p", gap, normal), 0)[:, None] * normal
    gap[::2] -= np.einsum("pi,pi->p", gap[::2], normal[::2])[:, None] * normal[::2]
    pressure = np.maximum(-np.einsum("pi,pi->p", trial, normal), 0)
    return trial, normal, gap, path, 10.0 + 3 * (STATIC - DYNAMIC) / D * pressure


@SETTINGS
@given(dims, seeds)
def test_return_map(d, seed):
    """|T_T| = mu(s)|T_N| where a point slips and less where it sticks; s is the length of slip."""
    trial, normal, gap, path, r = states(d, seed)
    with np.errstate(all="raise"):
        update = LAW.return_map(trial, normal, gap, path, r)
    T, change = update.traction, update.gap - gap
    assert T == pytest.approx(trial - r[:, None] * change, abs=1e-9)
    T_N = np.einsum("pi,pi->p", T, normal)
    T_T = np.linalg.norm(T - T_N[:, None] * normal, axis=1)
    mu = STATIC - (STATIC - DYNAMIC) * np.minimum(update.softening / D, 1)
    assert (T_N <= 1e-12).all()
    assert (T_T <= -mu * T_N + 1e-9).all()
    pressed = np.einsum("pi,pi->p", trial, normal) < 0
    slips = pressed & (update.multiplier > 0)
    assert slips.any()
    assert T_T[slips] == pytest.approx((-mu * T_N)[slips], abs=1e-9)
    assert update.softening[pressed] == pytest.approx((path + update.multiplier)[pressed])
    assert np.array_equal(update.softening[~pressed], path[~pressed])
    # The trapezoidal rule is exact on each of the two straight pieces of mu.
    before = STATIC - (STATIC - DYNAMIC) * np.minimum(path / D, 1)
    kink = np.clip(D - path, 0, update.multiplier)
    at_kink = STATIC - (STATIC - DYNAMIC) * np.minimum((path + kink) / D, 1)
    work = kink * (before + at_kink) / 2 + (update.multiplier - kink) * mu
    assert update.friction_work[slips] == pytest.approx((-T_N * work)[slips], rel=1e-9)


@SETTINGS
@given(dims, seeds)
def test_tangent(d, seed):
    """d zeta/dT_tr equals differences in every branch."""
    trial, normal, gap, path, r = states(d, seed)
    h, tangent = 1e-6, LAW.return_map(trial, normal, gap, path, r).tangent
    for i in range(d):
        ends = []
        for sign in (1, -1):
            load = trial.copy()
            load[:, i] += sign * h
            ends.append(LAW.return_map(load, normal, gap, path, r))
        smooth = np.all([np.isclose(e.multiplier > 0, ends[0].multiplier > 0) for e in ends], 0)
        smooth &= ends[0].mode == ends[1].mode
        smooth &= (ends[0].softening > D) == (ends[1].softening > D)
        found = (ends[0].gap - ends[1].gap) / (2 * h)
        assert tangent[smooth, :, i] == pytest.approx(found[smooth], abs=1e-6)
        assert smooth.mean() > 0.9


def test_coarse_penalty():
    """With r below the descent a point that slips ends on the dynamic branch, which is unique."""
    update = LAW.return_map([[-100.0, 61.0]], [[1.0, 0.0]], [[0.0, 0.0]], [0.0], 300.0)
    assert update.traction[0] == pytest.approx([-100.0, 40.0])
    assert update.softening[0] == pytest.approx(21.0 / 300)
    assert update.mode[0] == Mode.FRICTION


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"dynamic_friction": 0.3}, "has both"),
        ({"slip_distance": 0.3}, "has both"),
        ({"dynamic_friction": 0.7, "slip_distance": 0.1}, "can weaken only"),
        ({"dynamic_friction": 0.3, "slip_distance": 0.0}, "must be positive"),
        ({"dynamic_friction": -0.1, "slip_distance": 0.1}, "zero or positive"),
    ],
)
def test_what_is_refused(given, message):
    """Coefficients that grow, or half a law."""
    with pytest.raises(ValueError, match=message):
        Contact(0.5, **given)
