"""A few crystals at a coarse size, with default options: one crack parts the cell."""

from __future__ import annotations

import numpy as np


def test_polycrystal(comm, out):
    """Elastic as crystals are, parted at about the strength of the weak boundaries.

    The stiffness lies between the bounds of Voigt and Reuss in plane strain, of the softest and the
    stiffest direction of a crystal.
    """
    import polycrystal as demo
    from helpers import polycrystal as helper

    history = demo.main(grains=8, cells=3.0, end=0.006, steps=4, out=str(out))
    comm.barrier()
    strain, stress = history["strain_xx"], history["stress_xx"]
    C11, C12, C44 = (helper.NICKEL[name] for name in ("C11", "C12", "C44"))
    # Along an edge of the crystal and along its diagonal, no stress across, no strain along z.
    edge = C11 - C12**2 / C11
    along, across = (C11 + C12) / 2 + C44, (C11 + C12) / 2 - C44
    diagonal = along - across**2 / along
    assert edge < stress[0] / strain[0] < diagonal
    assert 0.7 * helper.STRENGTH < stress.max() < 2 * helper.STRENGTH
    assert np.abs(stress[-1]) < 1e-6 * stress.max()
    assert np.abs(history["stress_yy"]).max() < 1e-5 * stress.max()
    assert np.abs(history["hill_mandel"]).max() < 1e-6
    assert (out / "polycrystal.png").stat().st_size > 10_000
