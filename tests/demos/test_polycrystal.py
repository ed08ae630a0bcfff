"""A few crystals at a coarse size, with default options: one crack parts the cell."""

from __future__ import annotations

import numpy as np
import pytest

#: Grains in the plane and in space; the latter are parted to the last bond that bears something.
CELLS = {
    "plane": {"grains": 8, "cells": 3.0, "end": 0.006, "steps": 4},
    "solid": {"grains": 4, "cells": 1.0, "end": 0.008, "steps": 2, "solid": True},
}


@pytest.mark.parametrize("name", CELLS)
def test_polycrystal(comm, out, name):
    """Elastic as crystals are, parted at about the strength of the weak boundaries.

    In the plane the stiffness lies between the bounds of Voigt and Reuss in plane strain, of the
    softest and the stiffest direction of a crystal; in space between E of its edge and diagonal.
    """
    import polycrystal as demo

    history = demo.main(**CELLS[name], out=str(out))
    comm.barrier()
    strain, stress = history["strain_xx"], history["stress_xx"]
    C11, C12, C44 = (demo.NICKEL[name] for name in ("C11", "C12", "C44"))
    if name == "plane":
        # Along an edge of the crystal and its diagonal, no stress across, no strain along z.
        low = C11 - C12**2 / C11
        along, across = (C11 + C12) / 2 + C44, (C11 + C12) / 2 - C44
        high = along - across**2 / along
    else:
        # Young's modulus along an edge of the crystal and along its diagonal in space.
        bulk, shear = (C11 + 2 * C12) / 3, (C11 - C12) / 2
        low, high = (9 * bulk * m / (3 * bulk + m) for m in (shear, C44))
    assert low < stress[0] / strain[0] < high
    assert 0.7 * demo.STRENGTH < stress.max() < 2 * demo.STRENGTH
    assert np.abs(stress[-1]) < 1e-6 * stress.max()
    assert np.abs(history["stress_yy"]).max() < 1e-5 * stress.max()
    assert np.abs(history["hill_mandel"]).max() < 1e-6
    assert (out / "polycrystal.png").stat().st_size > 10_000
