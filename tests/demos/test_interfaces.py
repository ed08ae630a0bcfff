"""Random scenes of interfaces are the same however they are told, and their judges can fail."""

from __future__ import annotations

import interfaces
import interfaces as judges
import pytest
from parts.stability.runner import stress

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
