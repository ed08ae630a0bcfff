"""Random scenes in time keep what they should, however they are told, and their judge can fail."""

from __future__ import annotations

from dataclasses import replace

import motions
import numpy as np
import pytest
from motions import View, draw

# Plastic triangles, and steps that lose energy.
pytestmark = pytest.mark.filterwarnings("ignore::vmdg.ModelWarning")


@pytest.mark.long
@pytest.mark.parametrize("number", range(12))
def test_scenes(number):
    """One of every way by each of two schemes or so."""
    outcome = motions.judge(number)
    assert (outcome.verdict, outcome.detail) == ("correct", "")


def test_a_number_fixes_the_scene():
    """All ways occur."""
    assert str(draw(7)) == str(draw(7)) != str(draw(13))
    assert {draw(n).way for n in range(6)} == set(motions.WAYS)


def test_faults_are_found():
    """Energy and momentum from nothing, a warning too few, and another motion."""
    scene = draw(7)
    told = motions.told(scene, View())
    assert scene.free and not motions.own_faults(scene, told)
    v, u = told.momenta[-1]
    pushed = replace(told, momenta=[(v + 1e-6 * np.abs(v).max(), u)])
    assert "momentum" in motions.own_faults(scene, pushed)[0]
    warned = replace(told, warned=["of the energy in motion"])
    assert "warnings" in motions.own_faults(scene, warned)[0]
    told.history.rows[-1]["kinetic"] *= 1.1
    assert "exceeds" in motions.own_faults(scene, told)[0]
    other = replace(told, moved=[1.001 * u for u in told.moved])
    assert "differs" in motions.differs(told, other, motions.TURNED)
