"""`MixedModeDebonding`: pure modes, interaction of energies, reduction to `Debonding`."""

import math

import numpy as np
import pytest
from support.points import follow, total

from vmdg.laws import MixedModeDebonding

P_N, P_S, G_N, G_S = 40.0, 60.0, 0.3, 1.1
LAW = MixedModeDebonding(P_N, P_S, G_N, G_S)
NORMAL = np.array([[1.0, 0.0]])

# with an exponent of Camanho and Davila (2002)
CRITERIA = [("linear", None), ("BK", 2.284), ("BK", 1.0), ("power", 1.0), ("power", 2.0)]
EVERY_CRITERION = pytest.mark.parametrize(("criterion", "exponent"), CRITERIA)


def with_criterion(criterion, exponent, **more):
    return MixedModeDebonding(P_N, P_S, G_N, G_S, criterion=criterion, exponent=exponent, **more)


def energy_of(criterion, exponent, share):
    """G_c [N/mm] by the words of the criterion, share = G_II/G_c."""
    if criterion == "BK":
        return G_N + (G_S - G_N) * share**exponent
    x = exponent or 1.0
    return (((1.0 - share) / G_N) ** x + (share / G_S) ** x) ** (-1.0 / x)


@pytest.mark.parametrize("angle", np.linspace(0.0, 0.5 * math.pi, 7))
def test_strength_is_the_ellipse(angle):
    onset = np.array([[P_N * math.cos(angle), P_S * math.sin(angle)]])
    state = (NORMAL, np.zeros((1, 2)), np.zeros(1), 3.0 * LAW.softening_modulus)
    assert LAW.return_map(onset * (1.0 - 1e-12), *state).multiplier[0] == 0.0
    assert LAW.return_map(onset * (1.0 + 1e-9), *state).multiplier[0] > 0.0


@EVERY_CRITERION
@pytest.mark.parametrize("share", np.linspace(0.0, 1.0, 5))
@pytest.mark.parametrize(
    ("steps", "unloading"), [(1, "plastic"), (30, "plastic"), (1, "secant"), (20, "secant")]
)
def test_proportional_opening_spends_what_the_criterion_says(
    criterion, exponent, share, steps, unloading
):
    """At 5 ratios of the modes, pure ones too; G_I and G_II by the work of the components of T."""
    law = with_criterion(criterion, exponent, unloading=unloading)
    r = 3.0 * law.softening_modulus
    wanted = energy_of(criterion, exponent, share)
    # G_s sin^2/(G_n cos^2 + G_s sin^2) = share
    angle = math.atan2(math.sqrt(share / G_S), math.sqrt((1.0 - share) / G_N))
    traction = np.array([P_N * math.cos(angle), P_S * math.sin(angle)])
    # the triangle of T and zeta has the area G_c
    critical = np.array([math.cos(angle) * G_N / P_N, math.sin(angle) * G_S / P_S])
    critical *= 2.0 * wanted / (G_N * math.cos(angle) ** 2 + G_S * math.sin(angle) ** 2)
    assert 0.5 * traction @ critical == pytest.approx(wanted, rel=1e-12)
    d = np.linspace(0.0, 1.0, steps + 1)[1:, None, None]
    tractions = (1.0 - d) * traction[None, :]
    updates = follow(law, tractions + r * d * critical[None, :], NORMAL, r)
    np.testing.assert_allclose([update.traction for update in updates], tractions, atol=1e-9)
    spent = total(updates)
    assert spent == pytest.approx(wanted, rel=1e-9)
    assert float(law.energy_at(angle)) == pytest.approx(wanted, rel=1e-12)
    gaps = np.concatenate([np.zeros((1, 2)), *(update.gap for update in updates)])
    held = np.concatenate([traction[None, :], *(update.traction for update in updates)])
    modes = (0.5 * (held[1:] + held[:-1]) * np.diff(gaps, axis=0)).sum(axis=0)
    assert modes[1] / modes.sum() == pytest.approx(share, abs=1e-9)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"criterion": "bk"}, "criterion = 'bk': must be one of"),
        ({"criterion": "BK"}, "exponent is missing"),
        ({"exponent": 2.0}, "the linear criterion has none"),
        ({"criterion": "power", "exponent": 0.5}, "must be at least 1"),
        ({"criterion": "BK", "exponent": math.nan}, "must be at least 1"),
    ],
)
def test_wrong_criteria_are_refused(options, words):
    with pytest.raises(ValueError, match=words):
        MixedModeDebonding(P_N, P_S, G_N, G_S, **options)
