"""A fibre in a ductile matrix, at a coarse size."""

from __future__ import annotations

import ductile_matrix
import numpy as np
import pytest


def test_example(comm, out):
    """Curves agree until the matrix flows; flow limits the stress, the more the less it hardens."""
    found = ductile_matrix.main(element_size=0.4, end=0.03, steps=3, out=str(out))
    curves = {
        name: np.interp([0.01, 0.06], history["strain"], history["stress"])
        for name, history in found.items()
    }
    first = [curve[0] for curve in curves.values()]
    assert first == pytest.approx([first[0]] * 3, rel=0.05)
    elastic, hardening, perfect = (curve[1] for curve in curves.values())
    assert elastic > 2 * hardening > 2.4 * perfect
    assert found["elastic"]["plastic work"][-1] == 0.0
    # The ligaments beside the fibre flow in plane strain: 2/sqrt(3) of the yield stress.
    limit = 2 / np.sqrt(3) * ductile_matrix.YIELD * (1 - 2 * ductile_matrix.RADIUS)
    assert perfect == pytest.approx(limit, rel=0.15)
