"""The cone of Drucker and Prager: yield condition, apex, strengths in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from support.plastic import CONES, DT, ELASTIC, TENSORS, E, after, kirchhoff
from support.scenes import pairs

import vmdg

BULK = ELASTIC[0] / (3 * (1 - 2 * ELASTIC[1]))
COHESION, FRICTION = 15.0, 30.0
SINE, COSINE = math.sin(math.radians(FRICTION)), math.cos(math.radians(FRICTION))
EVERY = pytest.mark.parametrize("name", CONES)
KINEMATICS = pytest.mark.parametrize("small", [True, False])


@EVERY
@KINEMATICS
@given(first=TENSORS, second=TENSORS)
def test_yield_condition(name, small, first, second):
    """sqrt(s:s/2) + eta p = xi c where alpha grows, and no more elsewhere, also at the apex."""
    material, found = after(name, small, first, second)
    before = 0.0
    for gradient, answer in zip((first, second), found, strict=True):
        tau = kirchhoff(answer, gradient, small)
        p = np.trace(tau) / 3
        s = tau - p * np.eye(3)
        alpha = answer.state[0, 0]
        allowed = material.xi * material.cohesion(alpha)
        reached = math.sqrt((s**2).sum() / 2) + material.eta * p
        assert reached <= allowed + 1e-10 * E
        if alpha > before:
            assert reached == pytest.approx(allowed, abs=1e-10 * E)
        before = alpha


@EVERY
def test_stress_is_continuous_where_the_apex_begins(name):
    """A path over the normal cone of the apex: no step is larger than that of elastic bodies."""
    material, stresses = CONES[name], []
    shape, n = np.diag([1.0, -0.4, -0.6]), 2000
    for s in np.linspace(0.0, 1.0, n + 1):
        strain = 0.03 * s * np.eye(3) + 0.05 * (1 - s) * shape
        stresses.append(material(strain[None], material.start(1), DT, True).stress[0])
    spread = np.ptp(np.diagonal(stresses, axis1=1, axis2=2), axis=1)
    assert spread[0] > 1.0
    assert spread[-100:].max() < 1e-9
    steps = np.linalg.norm(np.diff(stresses, axis=0), axis=(1, 2))
    elastic = 3 * BULK * 0.03 * math.sqrt(3) + 2 * BULK * 0.05 * np.linalg.norm(shape)
    assert steps.max() < elastic / n


def free(material, strain, unknown, steps=40):
    """Diagonal strains grow to ``strain``; those of ``unknown`` such that their stress vanishes."""
    state, e = material.start(1), np.zeros(3)
    for s in np.arange(1, steps + 1) / steps:
        held = [i for i in range(3) if i not in unknown]
        e[held] = s * np.asarray(strain, dtype=float)[held]
        for _ in range(50):
            answer = material(np.diag(e)[None], state, DT, True)
            stress = np.diag(answer.stress[0])[unknown]
            if np.abs(stress).max() < 1e-11 * E:
                break
            moduli = np.einsum("iijj->ij", answer.moduli[0])[np.ix_(unknown, unknown)]
            e[unknown] -= np.linalg.solve(moduli, stress)
        else:
            raise AssertionError("no equilibrium")
        state = answer.state
    return np.diag(answer.stress[0]), answer.state[0]


@pairs(
    dilatancy=(None, 10.0, 0.0),
    fit=("compression", "tension", "plane strain"),
    hardening=(0.0, 40.0),
    sign=(1, -1),
)
def test_uniaxial_stress(dilatancy, hardening, fit, sign):
    """3 xi c/(sqrt(3) +- eta); at the edge of the fit that of Mohr and Coulomb."""
    material = vmdg.DruckerPrager(
        *ELASTIC, COHESION, FRICTION, dilatancy=dilatancy, hardening=hardening, fit=fit
    )
    stress, state = free(material, [0.06 * sign, 0, 0], [1, 2])
    c = COHESION + hardening * state[0]
    expected = sign * 3 * material.xi * c / (math.sqrt(3) + sign * material.eta)
    assert stress[0] == pytest.approx(expected, rel=1e-9)
    # d eps_p = dgamma (sign/sqrt(3) + etab/3) along the stress.
    gamma = state[0] / material.xi
    along = gamma * (sign / math.sqrt(3) + material.dilation / 3)
    assert state[1] == pytest.approx(along, rel=1e-9)
    assert 0.06 * sign == pytest.approx(stress[0] / ELASTIC[0] + along, rel=1e-9)
    if fit == ("tension" if sign > 0 else "compression"):
        assert stress[0] == pytest.approx(sign * 2 * c * COSINE / (1 + sign * SINE), rel=1e-9)


@pytest.mark.parametrize("sign", [1, -1])
def test_plane_strain_fit(sign):
    """Both criteria agree where a body fails in plane strain by the associated rule."""
    material = vmdg.DruckerPrager(*ELASTIC, COHESION, FRICTION, fit="plane strain")
    stress, _ = free(material, [0.3 * sign, 0, 0], [1])
    assert stress[0] == pytest.approx(sign * 2 * COHESION * COSINE / (1 + sign * SINE), rel=1e-6)


def test_refused_parameters():
    """Words at the door."""
    for arguments, words in (
        ({"cohesion": 0.0, "friction": 30.0}, "cohesion = 0.0 must be positive"),
        ({"cohesion": 1.0, "friction": 0.0}, "friction = 0.0 must be positive"),
        ({"cohesion": 1.0, "friction": 90.0}, "below 90"),
        ({"cohesion": 1.0, "friction": 30.0, "dilatancy": 31.0}, "create energy"),
        ({"cohesion": 1.0, "friction": 30.0, "dilatancy": -1.0}, "not negative"),
        ({"cohesion": 1.0, "friction": 30.0, "fit": "inner"}, "plane strain"),
    ):
        with pytest.raises(ValueError, match=words):
            vmdg.DruckerPrager(*ELASTIC, **arguments)
    with pytest.raises(TypeError, match="friction"):
        vmdg.DruckerPrager(*ELASTIC, 1.0, "30")
