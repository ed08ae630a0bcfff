"""`FatigueDebonding`: S-N lines, endurance, cycles at a held opening, tangents, works, doors."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import laws_scalar as oracle

from vmdg.laws import FatigueDebonding, MixedModeDebonding

SETTINGS = settings(max_examples=8, deadline=None, derandomize=True)

P_N, P_S, G_N, G_S = 40.0, 60.0, 0.3, 1.1
NORMAL = np.array([[1.0, 0.0]])
CRITERIA = [("linear", None), ("BK", 2.284), ("power", 2.0)]
RESULTS = ("traction", "gap", "softening", "multiplier", "tangent", "mode", "damage_work")

seeds, dims = st.integers(0, 2**32 - 1), st.sampled_from([2, 3])
criteria, frictions = st.sampled_from(CRITERIA), st.sampled_from([0.0, 0.5])
ratios = st.sampled_from([1.01, 3.0, 1e3])


def fatigue(criterion="linear", exponent=None, friction=0.0, **more):
    values = P_N, P_S, G_N, G_S, friction
    return FatigueDebonding(*values, criterion=criterion, exponent=exponent, **more)


def state_of(law, seed, d, ratio, n=100):
    rng = np.random.default_rng(seed)
    return oracle.random_state(rng, law, n, d, ratio), 10 ** rng.uniform(-1, 8, n)


@SETTINGS
@given(seeds, dims, criteria, frictions, ratios)
def test_without_cycles_it_is_the_monotonic_law(seed, d, criterion, mu, ratio):
    law = fatigue(*criterion, mu)
    name, exponent = criterion
    values = P_N, P_S, G_N, G_S, mu
    plain = MixedModeDebonding(*values, criterion=name, exponent=exponent, unloading="secant")
    state, _ = state_of(law, seed, d, ratio)
    one, other = law.return_map(*state), plain.return_map(*state)
    for name in (*RESULTS, "friction_work"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


@SETTINGS
@given(seeds, dims, criteria, frictions, ratios)
def test_cycles_only_wear(seed, d, criterion, mu, ratio):
    """More cycles do more; T = T_tr - r dzeta; no penetration; no work is negative."""
    law = fatigue(*criterion, mu)
    state, cycles = state_of(law, seed, d, ratio)
    with np.errstate(all="raise"):
        few, many = (law.return_map(*state, 1.0, n) for n in (cycles, 10 * cycles))
    assert (few.softening >= law.return_map(*state).softening).all()
    assert (many.softening >= few.softening - 1e-9 * P_N).all()
    assert (many.softening <= P_N).all()
    step = few.gap - state.gap
    size = np.abs(state.trial).max() + (state.penalty[:, None] * np.abs(few.gap)).max()
    borne = state.trial - state.penalty[:, None] * step
    np.testing.assert_allclose(few.traction, borne, atol=1e-11 * size)
    assert (np.einsum("ij,ij->i", few.gap, state.normal) >= -1e-14).all()
    for work in (few.damage_work, few.friction_work, few.viscous_work):
        assert (work >= 0.0).all()


@SETTINGS
@given(seeds, dims, criteria, frictions, st.sampled_from([1.5, 10.0]))
def test_tangent_is_the_derivative(seed, d, criterion, mu, ratio):
    law, h = fatigue(*criterion, mu), 1e-5
    state, cycles = state_of(law, seed, d, ratio)
    rest = state[1:]

    def mapped(trial):
        return law.return_map(trial, *rest, 1.0, cycles)

    update = mapped(state.trial)
    ends = [[mapped(state.trial + s * h * np.eye(d)[j]) for s in (1, -1)] for j in range(d)]
    difference = np.stack([(a.gap - b.gap) / (2 * h) for a, b in ends], axis=2)
    # not at kinks: where a branch ends between the two
    at_kink = np.zeros(len(cycles), dtype=bool)
    for a, b in ends:
        forward, back = a.gap - update.gap, update.gap - b.gap
        bend = np.abs(forward - back).max(1)
        at_kink |= bend > 1e-3 * np.abs(forward + back).max(1) + 1e-15
        at_kink |= a.mode != b.mode
    worn = (update.softening > law.return_map(*state).softening) & ~at_kink
    assert worn.sum() > 10
    error = np.abs(difference - update.tangent).max((1, 2)) * state.penalty
    assert (error[worn] <= 1e-5 * (1.0 + ratio)).all()


def held_traction(law, traction, cycles, steps):
    """Cycles (n,) after which points at constant tractions (n, 2) are gone."""
    n, lasted = len(traction), np.zeros(len(traction))
    r, normal = 3.0 * law.softening_modulus, np.tile(NORMAL, (len(traction), 1))
    modulus = np.array([P_N**2 / (2 * G_N), P_S**2 / (2 * G_S)])
    gap, softening, bears = np.zeros((n, 2)), np.zeros(n), np.ones(n, dtype=bool)
    for _ in range(int(1.2 * steps)):
        if not bears.any():
            break
        d, change = softening / P_N, np.ones(n)
        for _ in range(40):
            # T + r zeta with zeta = T d/((1 - d) H)
            load = traction * (1.0 + r * (d / (1.0 - d))[:, None] / modulus)
            update = law.return_map(load - r * gap, normal, gap, softening, r, 1.0, cycles / steps)
            grown = np.minimum(update.softening / P_N, 1.0 - 1e-6)
            d, change = grown, np.abs(grown - d)
            if (change < 1e-9)[bears].all():
                break
        bears &= (change < 1e-9) & (d < 1.0 - 1e-6)
        lasted += np.where(bears, cycles / steps, 0.0)
        softening = np.where(bears, update.softening, softening)
        gap = np.where(bears[:, None], update.gap, gap)
    return lasted


@pytest.mark.parametrize(
    ("criterion", "exponent"), [CRITERIA[0], pytest.param(*CRITERIA[1], marks=pytest.mark.long)]
)
def test_line_of_lives(criterion, exponent):
    """N = gamma (E/p)^beta (1 - p^(beta + 1)) for opening, shear and between; first order."""
    law = fatigue(criterion, exponent, ratio=0.3)
    angle, p = (a.ravel() for a in np.meshgrid([0.0, 0.6, 0.5 * math.pi], [0.55, 0.8]))
    traction = p[:, None] * np.stack([P_N * np.cos(angle), P_S * np.sin(angle)], axis=1)
    cycles = law.cycles_to_failure(p, angle)
    k = G_S / G_N
    share = k * np.sin(angle) ** 2 / (np.cos(angle) ** 2 + k * np.sin(angle) ** 2)
    e = 0.2 * (1.0 - 0.42 * share)
    E = 2.0 * e / (e + 1.0 + 0.3 * (e - 1.0))
    beta = -6.65 / np.log10(E)
    np.testing.assert_allclose(cycles, 1e7 * (E / p) ** beta * (1.0 - p ** (beta + 1.0)))
    coarse, fine = (held_traction(law, traction, cycles, n) / cycles - 1.0 for n in (40, 90))
    assert np.abs(coarse).max() < 0.12
    assert np.abs(fine).max() < 0.05


def test_endurance_is_a_limit():
    """At the limit a point lasts `life` cycles, below it for ever."""
    law = fatigue()
    E = float(law.wear(1.0, 0.0).endurance)
    assert law.cycles_to_failure(E) == pytest.approx(1e7, rel=1e-6)
    assert law.cycles_to_failure(E * (1 - 1e-9)) == math.inf
    assert law.cycles_to_failure(1.0) == 0.0
    r = 2.0 * law.softening_modulus
    for pressure in (0.0, 10.0):
        limit = E * P_N if pressure == 0.0 else float(law.wear(0.0, 1.0).endurance) * P_S
        for share, wears in ((1 - 1e-9, False), (1 + 1e-9, True)):
            trial = [[-pressure, limit * share]] if pressure else [[limit * share, 0.0]]
            update = law.return_map(trial, NORMAL, np.zeros((1, 2)), np.zeros(1), r, 1.0, 10.0)
            assert (update.softening[0] > 0.0) == wears


def test_wrong_parameters_are_refused():
    for name, value, words in (
        ("endurance", 1.0, r"must be in \(0, 1\); a fraction of the strength"),
        ("ratio", 1.0, "1 means no cycles"),
        ("life", 0.5, "number of cycles at the limit"),
        ("brittleness", 0.0, "must be in"),
        ("shear_factor", 6.0, "endurance in shear, .*must be less than the strength"),
    ):
        with pytest.raises(ValueError, match=words):
            fatigue(**{name: value})
    with pytest.raises(ValueError, match="does not depend on the rate"):
        FatigueDebonding(P_N, P_S, G_N, G_S, viscosity=1.0)
    law, one = fatigue(), np.zeros((1, 2))
    for cycles in (-1.0, math.inf, math.nan):
        with pytest.raises(ValueError, match="cycles: must be zero or positive and finite"):
            law.return_map(one, NORMAL, one, np.zeros(1), 1e5, 1.0, cycles)
