"""Return map of `Debonding` and the contract that all laws keep."""

import doctest
import inspect

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import laws_scalar as oracle

import vmdg.laws
from vmdg.laws import (
    Bonded,
    Contact,
    Debonding,
    ExponentialDebonding,
    IntrinsicExponential,
    MixedModeDebonding,
    Mode,
    TrapezoidalDebonding,
)

# One example is a few hundred points, so few examples go far.
SETTINGS = settings(max_examples=8, deadline=None, derandomize=True)
POINTS = 300

P_C, ZETA_C = 100.0, 0.2
H = P_C / ZETA_C

LAWS = {
    "linear": lambda mu=0.0, nu=0.0: Debonding(P_C, ZETA_C, mu, nu),
    "exponential": lambda mu=0.0, nu=0.0: ExponentialDebonding(P_C, 10.0, mu, nu),
    "mixed": lambda mu=0.0, nu=0.0: MixedModeDebonding(P_C, 60.0, 10.0, 18.0, mu, nu),
    "BK": lambda mu=0.0, nu=0.0: MixedModeDebonding(
        P_C, 60.0, 10.0, 18.0, mu, nu, criterion="BK", exponent=2.3
    ),
    "power": lambda mu=0.0, nu=0.0: MixedModeDebonding(
        P_C, 150.0, 10.0, 30.0, mu, nu, criterion="power", exponent=1.7
    ),
    "linear gradual": lambda mu=0.0, nu=0.0: Debonding(P_C, ZETA_C, mu, nu, gradual_friction=True),
    "exponential gradual": lambda mu=0.0, nu=0.0: ExponentialDebonding(
        P_C, 10.0, mu, nu, gradual_friction=True
    ),
    "mixed gradual": lambda mu=0.0, nu=0.0: MixedModeDebonding(
        P_C, 60.0, 10.0, 18.0, mu, nu, gradual_friction=True
    ),
    "trapezoidal": lambda mu=0.0, nu=0.0: TrapezoidalDebonding(P_C, 0.05, 0.15, mu, nu),
    "trapezoidal gradual": lambda mu=0.0, nu=0.0: TrapezoidalDebonding(
        P_C, 0.05, 0.15, mu, nu, gradual_friction=True
    ),
    "intrinsic": lambda mu=0.0, nu=0.0: IntrinsicExponential(P_C, 10.0, 2.0, nu),
}
SECANT = {
    "linear secant": lambda mu=0.0, nu=0.0: Debonding(P_C, ZETA_C, mu, unloading="secant"),
    "exponential secant": lambda mu=0.0, nu=0.0: ExponentialDebonding(
        P_C, 10.0, mu, unloading="secant"
    ),
    "trapezoidal secant": lambda mu=0.0, nu=0.0: TrapezoidalDebonding(
        P_C, 0.05, 0.15, mu, unloading="secant"
    ),
    "mixed secant": lambda mu=0.0, nu=0.0: MixedModeDebonding(
        P_C, 60.0, 10.0, 18.0, mu, unloading="secant"
    ),
    "BK secant": lambda mu=0.0, nu=0.0: MixedModeDebonding(
        P_C, 60.0, 10.0, 18.0, mu, criterion="BK", exponent=2.3, unloading="secant"
    ),
}
EXTRINSIC = [name for name in LAWS if name != "intrinsic"]
LAWS |= SECANT
EVERY_EXTRINSIC = pytest.mark.parametrize("make", [LAWS[n] for n in EXTRINSIC], ids=EXTRINSIC)
EVERY_LAW = pytest.mark.parametrize("make", LAWS.values(), ids=LAWS.keys())

dims = st.sampled_from([2, 3])
seeds = st.integers(0, 2**32 - 1)
frictions = st.sampled_from([0.0, 0.3, 0.475, 2.0])
viscosities = st.sampled_from([0.0, 0.1 * H, 0.9 * H, 5.0 * H, 200.0 * H])
ratios = st.sampled_from([1.0001, 1.01, 1.5, 10.0, 1e3, 1e8])


def dot(a, b):
    return np.einsum("ij,ij->i", a, b)


def norm(a):
    return np.linalg.norm(a, axis=-1)


def tangential(a, normal):
    return a - dot(a, normal)[:, None] * normal


# --- Kuhn-Tucker, irreversibility, contact --------------------------------------------------------


@EVERY_LAW
@SETTINGS
@given(d=dims, seed=seeds, ratio=ratios, mu=frictions, eta=viscosities)
def test_irreversible_and_impenetrable(make, d, seed, ratio, mu, eta):
    law = make(mu, eta)
    eta = law.viscosity
    state = oracle.random_state(np.random.default_rng(seed), law, POINTS, d, ratio)
    with np.errstate(all="raise"):
        update = law.return_map(*state)
    assert (update.softening >= state.softening).all()
    assert (update.softening <= law.strength).all()
    # T = T_tr - r dzeta
    step = update.gap - state.gap
    scale = norm(state.trial) + state.penalty * (norm(state.gap) + norm(update.gap)) + 1e-30
    mismatch = norm(update.traction - state.trial + state.penalty[:, None] * step)
    assert (mismatch <= 1e-13 * scale * max(1.0, 1e-3 / (ratio - 1.0))).all()
    # zeta_N >= 0, T_N <= 0 in contact, and one of the two is zero
    gap_n = dot(update.gap, state.normal)
    traction_n = dot(update.traction, state.normal)
    assert (gap_n >= -1e-14 * (1.0 + norm(state.gap))).all()
    pressed = traction_n < -1e-9 * P_C
    assert (np.abs(gap_n[pressed]) <= 1e-14).all()
    for work in (update.damage_work, update.friction_work, update.viscous_work):
        assert (work >= 0.0).all()


@pytest.mark.parametrize("name", [*EXTRINSIC, *SECANT])
def test_a_gap_that_is_open_by_rounding_slides(name):
    """The normal part of a long slip is a difference of numbers like it: it is not closing."""
    law, angle = LAWS[name](), np.linspace(0.1, 1.5, 50)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    along = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    trial, gap, gone = 30.0 * along - 10.0 * normal, 3.0 * along, np.full(50, P_C)
    update = law.return_map(trial, normal, gap, gone, 1e3 * law.softening_modulus)
    assert np.einsum("ij,ij->i", gap, normal).max() > 1e-16
    assert (update.mode == Mode.FRICTION).all()


# --- continuity -----------------------------------------------------------------------------------


@EVERY_EXTRINSIC
@pytest.mark.parametrize("viscosity", [0.0, 0.5 * H, 1e6 * H])
@pytest.mark.parametrize(
    ("worn", "angle"), [(0.0, 0.0), (0.0, 0.5 * np.pi), (0.6, 0.7), (1.0, 0.7)]
)
def test_overstress_ends_with_the_bond(make, viscosity, worn, angle):
    """In the step in which the bond goes T = V = c dgamma, dgamma = |T_tr|/(r + c), C = I/(r + c),
    c of the start of the step; from the next one on T = 0 whatever the viscosity."""
    law = make(0.3, viscosity)
    r = 5.0 * law.softening_modulus
    left = np.full(1, (1.0 - worn) * law.strength)
    c = viscosity * law.in_opening.resistance(left)[0] / law.strength
    # the exponential curve ends where it underflows against the strength
    trial = 100.0 * (r + c) / H * P_C * np.array([[np.cos(angle), np.sin(angle)]])
    normal, gap = np.array([[1.0, 0.0]]), np.zeros((1, 2))
    update = law.return_map(trial, normal, gap, law.strength - left, r)
    assert update.softening[0] == law.strength
    np.testing.assert_allclose(update.gap, trial / (r + c), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(update.traction, c * update.gap, rtol=1e-9, atol=1e-12 * P_C)
    np.testing.assert_allclose((r + c) * update.tangent[0], np.eye(2), atol=1e-12)
    assert update.mode[0] == Mode.OPEN
    assert update.viscous_work[0] == pytest.approx(c * norm(update.gap)[0] ** 2, rel=1e-12)
    after = law.return_map(trial, normal, update.gap, update.softening, r)
    assert not after.traction.any()
    assert after.viscous_work[0] == 0.0
    if angle:
        # 15 MPa of friction under a pressure of 50
        pressed = np.array([[-50.0, trial[0, 1]]])
        update = law.return_map(pressed, normal, gap, law.strength - left, r)
        borne = max(trial[0, 1] * c / (r + c), 15.0)
        if law.gradual_friction:
            borne = 15.0 + (trial[0, 1] - 15.0) * c / (r + c)
        np.testing.assert_allclose(update.traction, [[-50.0, borne]], rtol=1e-9)
        after = law.return_map(pressed, normal, gap, update.softening, r)
        np.testing.assert_allclose(after.traction, [[-50.0, 15.0]], rtol=1e-12)
        assert after.viscous_work[0] == 0.0


# --- energy ---------------------------------------------------------------------------------------


@EVERY_LAW
@settings(max_examples=4, deadline=None, derandomize=True)
@given(d=dims, seed=seeds, mu=frictions, eta=viscosities)
def test_dissipation_is_never_negative(make, d, seed, mu, eta):
    """Random walks: each work >= 0, and T_{n+1} . dzeta >= 0 where nothing is stored."""
    law, n = make(mu, eta), 120
    rng = np.random.default_rng(seed)
    state = oracle.random_state(rng, law, n, d, 5.0)
    normal, r = state.normal, state.penalty[:, None]
    gap, softening = np.zeros((n, d)), np.zeros(n)
    opening, spent = np.zeros((n, d)), np.zeros(n)
    for _ in range(30):
        opening += 0.3 * P_C / law.softening_modulus * rng.normal(size=(n, d))
        update = law.return_map(r * (opening - gap), normal, gap, softening, r[:, 0])
        if not isinstance(law, IntrinsicExponential) and law.unloading == "plastic":
            assert (dot(update.traction, update.gap - gap) >= -1e-12).all()
        for work in (update.damage_work, update.friction_work, update.viscous_work):
            assert (work >= 0.0).all()
        if mu == 0.0:
            assert (update.friction_work <= 1e-12).all()
        gap, softening, spent = update.gap, update.softening, spent + update.damage_work
    most = 10.0
    if isinstance(law, MixedModeDebonding):
        most = law.energy_at(np.linspace(0.0, 0.5 * np.pi, 1001)).max()
    assert (spent <= most + 1e-5).all()


# --- tangent and twin -----------------------------------------------------------------------------


def branch(law, update, state):
    """What must not change between the ends of a difference quotient."""
    return np.column_stack(
        [
            update.mode,
            update.multiplier > 0.0,
            update.softening >= law.strength,
            dot(update.gap, state.normal) > 1e-12,
            # which of bond and friction holds, also behind CLOSING
            np.round(np.abs(norm(update.tangent - np.swapaxes(update.tangent, 1, 2)).sum(1)), 12)
            > 0,
        ]
    )


@EVERY_LAW
@SETTINGS
@given(d=dims, seed=seeds, ratio=st.sampled_from([1.5, 4.0, 100.0]), mu=frictions, eta=viscosities)
def test_tangent_is_the_derivative(make, d, seed, ratio, mu, eta):
    law = make(mu, eta)
    eta = law.viscosity
    state = oracle.random_state(np.random.default_rng(seed), law, POINTS, d, ratio)
    update = law.return_map(*state)
    h = 1e-5 * P_C
    smooth = np.ones(POINTS, dtype=bool)
    difference = np.empty((POINTS, d, d))
    here = branch(law, update, state)
    for j, axis in enumerate(np.eye(d)):
        ends = [law.return_map(state.trial + s * h * axis, *state[1:]) for s in (1.0, -1.0)]
        far = [law.return_map(state.trial + s * 50 * h * axis, *state[1:]) for s in (1.0, -1.0)]
        for end in ends + far:
            smooth &= (branch(law, end, state) == here).all(1)
        difference[:, :, j] = (ends[0].gap - ends[1].gap) / (2.0 * h)
    # directions turn fast where the load that turns them is small
    smooth &= norm(tangential(state.trial, state.normal)) > 0.05 * P_C
    smooth &= norm(state.trial + state.penalty[:, None] * state.gap) > 0.1 * P_C
    assert smooth.mean() > 0.5
    r = state.penalty[:, None, None]
    error = np.abs(r * (update.tangent - difference)).max((1, 2))
    size = np.abs(r * update.tangent).max((1, 2)) + 1.0
    assert (error[smooth] <= 1e-6 * size[smooth]).all()


@EVERY_LAW
@SETTINGS
@given(d=dims, seed=seeds, ratio=ratios, mu=st.sampled_from([0.0, 0.5]))
def test_tangent_is_symmetric_where_the_law_says_so(make, d, seed, ratio, mu):
    law = make(mu)
    state = oracle.random_state(np.random.default_rng(seed), law, POINTS, d, ratio)
    tangent = law.return_map(*state).tangent
    skew = np.abs(tangent - np.swapaxes(tangent, 1, 2)).max()
    if law.symmetric:
        assert skew <= 1e-12 * np.abs(tangent).max()
    elif ratio <= 10.0:
        assert skew > 1e-6 * np.abs(tangent).max()


def twin(law, eta, *point):
    if oracle.returns_to_origin(law):
        return oracle.secant(law, *point)
    if isinstance(law, MixedModeDebonding):
        return oracle.mixed(law, eta, *point)
    if isinstance(law, IntrinsicExponential):
        return oracle.intrinsic(law, eta, *point)
    if isinstance(law, TrapezoidalDebonding):
        curve = oracle.Trapezoid(law.strength, law.plateau_gap, law.critical_gap)
    elif isinstance(law, ExponentialDebonding):
        curve = oracle.Exponential(law.strength, law.fracture_energy)
    else:
        curve = oracle.Linear(law.strength, law.critical_gap)
    return oracle.radial(curve, law.friction, eta, *point, gradual=law.gradual_friction)


@EVERY_LAW
@settings(max_examples=10, deadline=None, derandomize=True)
@given(d=dims, seed=seeds, ratio=st.sampled_from([1.1, 3.0, 1e3]), mu=frictions, eta=viscosities)
def test_vectorised_is_scalar(make, d, seed, ratio, mu, eta):
    law = make(mu, eta)
    eta, dt = law.viscosity, 0.5
    state = oracle.random_state(np.random.default_rng(seed), law, 25, d, ratio)
    update = law.return_map(*state, dt=dt)
    for i in range(25):
        step = twin(law, eta / dt, *(a[i].tolist() for a in state))
        for name, scale in (("traction", P_C), ("gap", ZETA_C), ("softening", P_C)):
            np.testing.assert_allclose(
                getattr(update, name)[i], getattr(step, name), rtol=1e-12, atol=1e-12 * scale
            )
        assert update.multiplier[i] == pytest.approx(step.multiplier, rel=1e-12, abs=1e-12 * ZETA_C)
        assert Mode(update.mode[i]).name == step.mode
        # the twin's quadrature: a kink, or with viscosity a jump, inside one of its pieces
        piece = update.multiplier[i] / oracle.PIECES
        kink = 2.0 * law.softening_modulus * piece**2
        jump = 2.0 * (eta / dt) * piece * update.multiplier[i]
        for name in ("damage_work", "friction_work", "viscous_work"):
            assert getattr(update, name)[i] == pytest.approx(
                getattr(step, name), rel=1e-3, abs=kink + jump + 1e-9
            )


# --- extremes, errors, the rest of the contract ---------------------------------------------------


@EVERY_LAW
@pytest.mark.parametrize(("ratio", "d"), [(1.0001, 2), (1.0 + 1e-9, 3), (1e8, 2)])
@pytest.mark.parametrize("mu", [0.0, 2.0])
def test_extremes_stay_finite_and_silent(make, ratio, mu, d):
    law = make(mu)
    state = oracle.random_state(np.random.default_rng(5), law, POINTS, d, ratio)
    state.trial[:40] = 0.0
    state.trial[40:80] *= 1e-12
    state.trial[80:120] *= 1e6
    state.gap[60:100] *= 1e4
    with np.errstate(all="raise"):
        update = law.return_map(*state)
    for name in update.__slots__:
        assert np.isfinite(getattr(update, name)).all(), name


@EVERY_LAW
@pytest.mark.parametrize(("nu", "worn"), [(0.0, 0.0), (0.3 * H, 0.5), (0.3 * H, 1.0)])
def test_a_trial_that_is_no_number_stays_one_in_silence(make, nu, worn):
    # As of a material in a cell that a trial displacement turns inside out: the step is given up.
    law = make(0.3, nu)
    normal, gap = np.tile([1.0, 0.0], (2, 1)), np.zeros((2, 2))
    softening = np.full(2, worn * law.strength)
    trial = np.array([[np.nan, np.nan], [0.5 * P_C, 0.25 * P_C]])
    update = law.return_map(trial, normal, gap, softening, 10.0 * law.softening_modulus)
    assert np.isnan(update.gap[0] + update.traction[0]).all()
    assert np.isfinite(update.gap[1] + update.traction[1]).all()


@EVERY_LAW
def test_inputs_are_left_alone_and_not_shared(make):
    law = make(0.3)
    state = oracle.random_state(np.random.default_rng(1), law, POINTS, 3, 2.0)
    before = [a.copy() for a in state]
    for array in state:
        array.setflags(write=False)
    update = law.return_map(*state)
    for array, copy in zip(state, before, strict=True):
        np.testing.assert_array_equal(array, copy)
    for name in update.__slots__:
        assert not any(np.shares_memory(getattr(update, name), a) for a in state)


@pytest.mark.parametrize("load", [(1e5, 0.0), (-1.0, 1e5)])
@pytest.mark.parametrize("shear_strength", [51.7, 60.1, 99.9, 33.0])
def test_a_bond_that_fails_is_gone_exactly(load, shear_strength):
    """Round-off must not leave a last trace of bond: every worn state ends at Q = P_n."""
    law = MixedModeDebonding(37.3, shear_strength, 10.0, 18.0)
    softening = law.strength * np.random.default_rng(3).random(1000)
    trial, normal = np.tile(load, (1000, 1)), np.tile([1.0, 0.0], (1000, 1))
    update = law.return_map(trial, normal, 0.0 * normal, softening, 2.0 * law.softening_modulus)
    assert (update.softening == law.strength).all()


@EVERY_LAW
def test_penalty_below_softening_is_refused(make):
    law = make()
    n, bound = 4, law.softening_modulus
    normal = np.tile([1.0, 0.0], (n, 1))
    penalty = np.array([2.0, 1.5, 1.0, 2.0]) * bound
    np.testing.assert_array_equal(law.admissible(penalty), [True, True, False, True])
    with pytest.raises(ValueError, match=r"penalty r = .* at point 2 .* H = .*smaller elements"):
        law.return_map(0.0 * normal, normal, 0.0 * normal, np.zeros(n), penalty)
    # Viscosity ends with the bond, whose last part softens by H all the same.
    np.testing.assert_array_equal(make(nu=1e9).admissible(penalty), [True, True, False, True])
    penalty[2] = np.nan
    with pytest.raises(ValueError, match="point 2"):
        law.return_map(0.0 * normal, normal, 0.0 * normal, np.zeros(n), penalty)


@pytest.mark.parametrize("dt", [0.0, -1.0, float("nan")])
def test_time_step_must_be_positive_with_viscosity(dt):
    normal = np.array([[1.0, 0.0]])
    arguments = (normal, normal, 0.0 * normal, np.zeros(1), 5000.0)
    Debonding(P_C, ZETA_C).return_map(*arguments, dt=dt)
    with pytest.raises(ValueError, match=r"dt = .*positive time step"):
        Debonding(P_C, ZETA_C, viscosity=1.0).return_map(*arguments, dt=dt)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
@pytest.mark.parametrize(
    ("law", "parameters"),
    [
        (Debonding, {"strength": 100.0, "critical_gap": 0.2}),
        (ExponentialDebonding, {"strength": 100.0, "fracture_energy": 10.0}),
        (IntrinsicExponential, {"strength": 100.0, "fracture_energy": 10.0, "shear_weight": 2.0}),
        (
            MixedModeDebonding,
            {
                "normal_strength": 100.0,
                "shear_strength": 50.0,
                "normal_energy": 10.0,
                "shear_energy": 20.0,
            },
        ),
    ],
)
def test_parameters_must_make_sense(law, parameters, value):
    for name in parameters:
        with pytest.raises(ValueError, match=f"{name} = {value}: must be positive and finite"):
            law(**(parameters | {name: value}))
    for name in {"friction", "viscosity"} & set(inspect.signature(law).parameters):
        if value != 0.0:
            with pytest.raises(ValueError, match=f"{name} = {value}: must be zero or positive"):
                law(**parameters, **{name: value})


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("trial", (5,)),
        ("trial", (5, 4)),
        ("normal", (5, 3)),
        ("gap", (4, 2)),
        ("softening", (5, 1)),
        ("penalty", (4,)),
    ],
)
def test_shapes_are_checked(name, shape):
    arguments = {
        "trial": np.zeros((5, 2)),
        "normal": np.zeros((5, 2)),
        "gap": np.zeros((5, 2)),
        "softening": np.zeros(5),
        "penalty": np.full(5, 5000.0),
    }
    arguments[name] = np.ones(shape)
    with pytest.raises(ValueError, match=f"{name} has shape"):
        Debonding(P_C, ZETA_C).return_map(**arguments)


def test_bonded_is_a_tie():
    law = Bonded()
    assert not law.inelastic
    assert law.symmetric
    assert law.softening_modulus == 0.0
    assert law.admissible(np.array([1e-3, 1.0])).all()
    trial, normal, zeros = np.array([[1e9, -3.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 2))
    update = law.return_map(trial, normal, zeros, np.zeros(1), 1.0)
    np.testing.assert_array_equal(update.traction, trial)
    assert not update.gap.any()
    assert not update.tangent.any()


@SETTINGS
@given(dims, seeds, frictions)
def test_contact_is_what_is_left_of_a_bond(d, seed, mu):
    """Equal to `Debonding` whose bond is gone, in everything but the history that it needs not.

    Whether a closure of the size of rounding is called one depends on the strength: the mode of
    such points may differ.
    """
    bond, law = Debonding(P_C, ZETA_C, mu), Contact(mu)
    trial, normal, gap, _, penalty = oracle.random_state(
        np.random.default_rng(seed), bond, POINTS, d, 3.0
    )
    trial[:20], gap[20:40] = 0.0, 0.0
    gone, none = np.full(POINTS, P_C), np.zeros(POINTS)
    with np.errstate(all="raise"):
        update = law.return_map(trial, normal, gap, none, penalty)
    expected = bond.return_map(trial, normal, gap, gone, penalty)
    for name in set(update.__slots__) - {"softening", "mode"}:
        np.testing.assert_array_equal(getattr(update, name), getattr(expected, name), name)
    clear = np.abs(np.einsum("pi,pi->p", gap, normal)) * penalty > 1e-9 * P_C
    clear |= (gap == 0).all(axis=1)
    assert clear.sum() > POINTS / 5
    assert (update.mode[clear] == expected.mode[clear]).all()
    assert not update.softening.any()


def test_docstring_example():
    assert doctest.testmod(vmdg.laws).failed == 0
