"""Random bars against ten times as many load steps."""

import programmes
import pytest


@pytest.mark.long
@pytest.mark.parametrize("number", range(4))
def test_scene(number):
    """One of every family."""
    assert programmes.judged(number).verdict in ("correct", "chaotic")
