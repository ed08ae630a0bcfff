"""Random scenes in time keep what they should, however they are told, and their judge can fail."""

from __future__ import annotations

import motions
import pytest

# Plastic triangles, and steps that lose energy.
pytestmark = pytest.mark.filterwarnings("ignore::vmdg.ModelWarning")


@pytest.mark.long
@pytest.mark.parametrize("number", range(12))
def test_scenes(number):
    """One of every way by each of two schemes or so."""
    outcome = motions.judge(number)
    assert (outcome.verdict, outcome.detail) == ("correct", "")
