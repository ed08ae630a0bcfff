"""Return map of J2: consistency, dissipation, objectivity, tangent, paths in one and many steps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import vmdg
from vmdg.materials.j2 import unpack

E, NU = 2000.0, 0.3
G = E / (2 * (1 + NU))
VOCE = {"hardening": 40.0, "saturation": 30.0, "exponent": 15.0}
MATERIALS = {
    "perfect": vmdg.J2(E, NU, 20.0),
    "voce": vmdg.J2(E, NU, 20.0, **VOCE),
    "table": vmdg.J2(E, NU, hardening=[(0.0, 20.0), (0.02, 25.0), (0.1, 28.0)]),
    "viscous": vmdg.J2(E, NU, 20.0, hardening=50.0, rate=30.0),
    "kinematic": vmdg.J2(E, NU, 20.0, hardening=30.0, kinematic=100.0),
}
FINITE = [name for name, material in MATERIALS.items() if "finite" in material.kinematics]
DT = 0.2
TENSORS = arrays(float, (3, 3), elements=st.floats(-0.1, 0.1))
KINDS = [(name, True) for name in MATERIALS] + [(name, False) for name in FINITE]
EVERY = pytest.mark.parametrize(("name", "small"), KINDS)


def deformed(gradient, small):
    """One point with a displacement gradient."""
    H = np.asarray(gradient)[None]
    return (H + H.transpose(0, 2, 1)) / 2 if small else np.eye(3) + H


def after(name, small, *gradients):
    """The material and its answers along a path of one point."""
    material = MATERIALS[name]
    state, found = material.start(1), []
    for gradient in gradients:
        found.append(material(deformed(gradient, small), state, DT, small))
        state = found[-1].state
    return material, found


@EVERY
@given(first=TENSORS, second=TENSORS)
def test_yield_condition(name, small, first, second):
    """q = sigma_y + rate dalpha/dt where alpha grows, and no more elsewhere; work is dissipated."""
    material, found = after(name, small, first, second)
    before = 0.0
    for gradient, answer in zip((first, second), found, strict=True):
        tau = answer.stress
        if not small:
            tau = tau @ deformed(gradient, small).transpose(0, 2, 1)
            assert np.abs(tau - tau.transpose(0, 2, 1)).max() < 1e-10 * (1 + np.abs(tau).max())
        alpha = answer.state[:, 0]
        plastic = unpack(answer.state[:, 1:])
        back = 2 / 3 * material.numbers["kinematic"] * plastic
        xi = tau - np.trace(tau[0]) / 3 * np.eye(3) - back
        q = np.sqrt(1.5 * (xi**2).sum())
        grown = float(alpha[0] - before)
        allowed = material.yield_stress(alpha)[0] + material.numbers["rate"] * grown / DT
        assert grown >= 0
        assert q <= allowed * (1 + 1e-9)
        if grown > 1e-12:
            assert q == pytest.approx(allowed[0], rel=1e-8)
        assert answer.dissipated[0] >= 0
        assert answer.stored[0] >= 0
        before = float(alpha[0])


@EVERY
@given(first=TENSORS, second=TENSORS, direction=TENSORS)
def test_tangent(name, small, first, second, direction):
    """Moduli are the derivative of the stress, and have major symmetry."""
    material, (one, answer) = after(name, small, first, second)
    D, h = deformed(direction, small)[0] - (0 if small else np.eye(3)), 1e-6
    ends = [deformed(second, small) + s * h * D for s in (1, -1)]
    alphas = [material(F, one.state, DT, small).state[0, 0] for F in ends]
    grows = [alpha > one.state[0, 0] for alpha in alphas]
    if grows[0] != grows[1] or name == "table":
        return  # a kink of the stress lies in between
    plus, minus = (material(F, one.state, DT, small).stress for F in ends)
    expected = np.einsum("pijkl,kl->pij", answer.moduli, D)
    scale = E * max(np.abs(D).max(), 1e-3)
    assert np.abs((plus - minus) / (2 * h) - expected).max() < 1e-6 * scale
    swapped = answer.moduli.transpose(0, 3, 4, 1, 2)
    assert np.abs(answer.moduli - swapped).max() < 1e-12 * E


@pytest.mark.parametrize("name", FINITE)
@given(first=TENSORS, second=TENSORS, spin=TENSORS)
def test_objectivity(name, first, second, spin):
    """A rotation Q of all of space after the first step: P -> Q.P, with the same history."""
    material, (one, answer) = after(name, False, first, second)
    Q, _ = np.linalg.qr(np.eye(3) + 5 * spin)
    Q *= np.sign(np.linalg.det(Q))
    turned = material(Q @ deformed(second, False), one.state, DT, False)
    assert turned.stress == pytest.approx(Q @ answer.stress, abs=1e-9 * E)
    assert turned.state == pytest.approx(answer.state, abs=1e-10)


@pytest.mark.parametrize("name", ["perfect", "voce", "table", "kinematic"])
@given(strain=TENSORS)
def test_proportional_paths(name, strain):
    """A radial return is exact for proportional strain: one step and many agree."""
    _, (once,) = after(name, True, strain)
    _, often = after(name, True, *(s * strain for s in np.linspace(0.05, 1.0, 20)))
    assert often[-1].stress == pytest.approx(once.stress, abs=1e-9 * E)
    assert often[-1].state == pytest.approx(once.state, abs=1e-10)
    total = sum(answer.dissipated[0] for answer in often)
    if name != "kinematic":
        assert total == pytest.approx(once.dissipated[0], rel=1e-9, abs=1e-12)


def test_small_strain_is_the_limit_of_finite_strain():
    """Differences fall with the square of the strain."""
    gradient, errors = np.array([[0.4, 0.3, 0.0], [-0.1, -0.2, 0.2], [0.1, 0.0, 0.1]]), []
    for size in (1e-3, 1e-4):
        material = vmdg.J2(E, NU, 0.2 * E * size, hardening=E / 50)
        small = material(deformed(size * gradient, True), material.start(1), DT, True)
        finite = material(deformed(size * gradient, False), material.start(1), DT, False)
        errors.append(np.abs(small.stress - finite.stress).max() / (E * size))
    assert errors[1] < 0.2 * errors[0] < 1e-2


def test_refused_parameters():
    """Words at the door."""
    for arguments, words in (
        ({"yield_stress": -1.0}, "positive"),
        ({"yield_stress": 1.0, "hardening": -1.0}, "not negative"),
        ({"yield_stress": 1.0, "saturation": 2.0}, "exponent"),
        ({"yield_stress": 2.0, "saturation": 1.0, "exponent": 1.0}, "soften"),
        ({"yield_stress": 2.0, "hardening": [(0, 1.0), (1, 2.0)]}, "begins with"),
        ({"hardening": [(0.1, 1.0), (1, 2.0)]}, "start at alpha = 0"),
        ({"hardening": [(0, 2.0), (1, 1.0)]}, "does not decrease"),
    ):
        with pytest.raises(ValueError, match=words):
            vmdg.J2(E, NU, **arguments)
    with pytest.raises(TypeError, match="yield_stress"):
        vmdg.J2(E, NU)
    with pytest.raises(TypeError, match="hyperelastic"):
        vmdg.PointMaterial(MATERIALS["voce"])
