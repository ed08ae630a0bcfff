"""Return maps at a point: tangent, energies, objectivity, the limit of small strain."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from support.plastic import DT, ELASTIC, FINITE, KINDS, TENSORS, E, after, deformed

import vmdg

EVERY = pytest.mark.parametrize(("name", "small"), KINDS)


@EVERY
@given(first=TENSORS, second=TENSORS, direction=TENSORS)
def test_tangent(name, small, first, second, direction):
    """Moduli are the derivative of the stress; those of associated rules have major symmetry."""
    material, (one, answer) = after(name, small, first, second)
    assert np.isfinite(answer.moduli).all()
    if material.symmetric:
        swapped = answer.moduli.transpose(0, 3, 4, 1, 2)
        assert np.abs(answer.moduli - swapped).max() < 1e-12 * E
    D, h = deformed(direction, small)[0] - (0 if small else np.eye(3)), 1e-6
    plus, minus = (
        material(deformed(second, small) + s * h * D, one.state, DT, small) for s in (1, -1)
    )
    # Else a kink of the stress lies in between.
    assume(np.abs(plus.moduli - minus.moduli).max() < 1e-3 * E)
    expected = np.einsum("pijkl,kl->pij", answer.moduli, D)
    scale = E * max(np.abs(D).max(), 1e-3)
    assert np.abs((plus.stress - minus.stress) / (2 * h) - expected).max() < 1e-6 * scale


@EVERY
@given(first=TENSORS, second=TENSORS)
def test_dissipation(name, small, first, second):
    """Is not negative, and neither is the energy stored; where nothing flows, nothing is lost."""
    _, found = after(name, small, first, second)
    before = 0.0
    for answer in found:
        alpha = answer.state[0, 0]
        assert alpha >= before
        assert answer.dissipated[0] >= 0
        assert answer.stored[0] >= 0
        if alpha == before:
            assert answer.dissipated[0] < 1e-14 * E
        elif alpha > before + 1e-9 and name != "isochoric":
            # At its apex a cone without dilatancy may flow against no stress.
            assert answer.dissipated[0] > 0
        before = alpha


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


@pytest.mark.parametrize("kind", ["J2", "DruckerPrager"])
def test_small_strain_is_the_limit_of_finite_strain(kind):
    """Differences fall with the square of the strain."""
    gradient, errors = np.array([[0.4, 0.3, 0.0], [-0.1, -0.2, 0.2], [0.1, 0.0, 0.1]]), []
    for size in (1e-3, 1e-4):
        if kind == "J2":
            material = vmdg.J2(*ELASTIC, 0.2 * E * size, hardening=E / 50)
        else:
            material = vmdg.DruckerPrager(*ELASTIC, 0.2 * E * size, 20.0, hardening=E / 50)
        small = material(deformed(size * gradient, True), material.start(1), DT, True)
        finite = material(deformed(size * gradient, False), material.start(1), DT, False)
        assert small.state[0, 0] > 0
        errors.append(np.abs(small.stress - finite.stress).max() / (E * size))
    assert errors[1] < 0.2 * errors[0] < 1e-2
