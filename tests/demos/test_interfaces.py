"""Random scenes of interfaces are the same however they are told, and their judges can fail."""

from __future__ import annotations

from dataclasses import replace

import interfaces
import interfaces as judges
import pytest
from interfaces import View, draw
from parts.stability.runner import execute, stress

# Coarse meshes, and facets that others do not face.
pytestmark = pytest.mark.filterwarnings("ignore::vmdg.ModelWarning")

#: Ties of different meshes, contact over a gap, bodies that slide, no contact: quick ones.
SCENES = [6, 12]


@pytest.mark.long
@pytest.mark.parametrize("number", SCENES)
def test_scenes(number):
    """Turned, mirrored, in other units, with swapped sides, finer, and by all other checks."""
    outcome = stress(number, interfaces.PATIENCE, draw=judges.judged)
    assert (outcome.verdict, outcome.detail) == ("correct", "")


def test_a_number_fixes_the_scene():
    """All ways of meeting occur."""
    assert draw(7).what == draw(7).what != draw(12).what
    assert {draw(n).way for n in judges.numbers(1)} == set(judges.WAYS)


@pytest.fixture(scope="module")
def contact():
    """A scene and its run."""
    scene = draw(12)
    return scene, execute(scene.case())


def test_differences_are_found(contact):
    """Another force, energy, number of rows, an error."""
    scene, run = contact
    here = judges.Told.of(run, scene, View())
    assert not judges.fault("same", here, here, 1e-12)
    for wrong in (
        replace(here, forces=here.forces * (1 + 1e-6)),
        replace(here, energies=here.energies * (1 + 1e-6)),
        replace(here, rows=here.rows[1:], forces=here.forces * 1.1),
        replace(here, stopped="no equilibrium"),
    ):
        assert judges.fault("other", here, wrong, judges.SAME)
    assert "rows" in judges.fault("units", here, replace(here, rows=here.rows[1:]), 0.0)


def test_lost_work_is_found(contact):
    """Of the supports, and of nobody."""
    scene, run = contact
    assert not judges.own_faults(scene, run)
    last = run.records[-1]
    for name, what in (("external", "work"), ("bulk", "imbalance")):
        energy = replace(last.energy, **{name: 2 * getattr(last.energy, name)})
        wrong = replace(run, records=[*run.records[:-1], replace(last, energy=energy)])
        assert any(what in text for text in judges.own_faults(scene, wrong)), name
