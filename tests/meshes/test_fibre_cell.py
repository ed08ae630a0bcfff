"""Fibres at random places: distances, fractions, and meshes that match across the sides."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from support.cells import mismatch, volumes

from vmdg.meshes import fibre_cell, pack
from vmdg.meshes.packing import UNIT_BALL, cut_balls

CELLS = {
    "discs": {"count": 12, "fraction": 0.6, "seed": 3},
    "quadrilaterals": {"count": 5, "fraction": 0.5, "cell": "quadrilateral", "size": 30.0},
    "coated": {"count": 5, "fraction": 0.4, "coating": 0.1, "size": 1e-3},
    "cylinders": {"count": 3, "fraction": 0.5, "shape": "cylinder", "depth": 0.3, "size": 2.0},
    "hexahedra": {"count": 3, "fraction": 0.4, "shape": "cylinder", "cell": "hexahedron"},
    "spheres": {"count": 3, "fraction": 0.3, "shape": "sphere", "element_size": 0.12},
}


@pytest.mark.parametrize(
    ("count", "fraction", "dim", "periodic", "spread"),
    [
        (1, 0.6, 2, True, 0.0),
        (50, 0.6, 2, True, 0.0),
        (50, 0.6, 2, False, 0.0),
        (40, 0.7, 2, True, 0.2),
        (30, 0.45, 3, True, 0.0),
    ],
)
def test_balls_keep_their_distance(comm, count, fraction, dim, periodic, spread):
    """From each other, from images and from sides; they fill the fraction; seeds decide."""
    size, spacing = 3.0, 0.1 if spread == 0 else 0.0
    given = count, fraction, 7, periodic, size, dim, spacing, spread
    centres, radii = pack(*given)
    assert (radii**dim).sum() * UNIT_BALL[dim] == pytest.approx(fraction * size**dim)
    assert (np.ptp(radii) > 0) == (spread > 0)
    wanted = (1 + spacing / 2) * (radii[:, None] + radii)
    shifts = np.array(list(itertools.product((-size, 0, size), repeat=dim)))
    if not periodic:
        shifts = np.zeros((1, dim))
        assert (
            np.minimum(centres, size - centres).min(axis=1) > (1 + spacing / 2 - 1e-12) * radii
        ).all()
    for shift in shifts:
        apart = np.linalg.norm(centres[:, None] - centres - shift, axis=2)
        if not shift.any():
            apart += 2 * size * np.eye(count)
        assert (apart >= wanted * (1 - 1e-12)).all()
    for other in comm.allgather(centres):
        assert np.array_equal(other, centres)
    assert not np.allclose(pack(*(8 if n == 2 else v for n, v in enumerate(given)))[0], centres)


def test_sides_cut_well():
    """No side is as near to a tangent as in the cell that is not shifted."""
    centres, radii = pack(20, 0.5, 1)
    shifted = cut_balls(centres, radii[:1], 1.0)
    moved = (shifted - centres + 0.5) % 1
    assert np.allclose(moved, moved[0])

    def clear(places):
        tangents = np.concatenate([places - radii[:, None], places + radii[:, None]]) % 1
        return np.minimum(tangents, 1 - tangents).min()

    assert clear(shifted) > max(0.25 * radii[0], 2 * clear(centres))


@pytest.mark.parametrize("name", CELLS)
def test_cells(comm, name):
    """Groups fill their fractions, and all sides match.

    Polygons with a side of a quarter of the radius fill 1% less than their circle, polyhedra 6%.
    """
    given = CELLS[name]
    tagged = fibre_cell(**given, comm=comm)
    size, dim = given.get("size", 1.0), tagged.mesh.geometry.dim
    assert mismatch(tagged) < 1e-12 * size
    bodies = volumes(tagged)
    whole = sum(bodies.values())
    assert bodies["fibre"] / whole == pytest.approx(
        given["fraction"], rel=0.06 if dim == 3 else 0.02
    )
    if "coating" in bodies:
        expected = given["fraction"] * ((1 + given["coating"]) ** 2 - 1)
        assert bodies["coating"] / whole == pytest.approx(expected, rel=0.03)
    if given.get("shape") != "cylinder":
        assert whole == pytest.approx(size**dim)


def test_wrong_cells():
    """Errors say what does not fit, and what would."""
    with pytest.raises(ValueError, match=r"jam at 0\.82; lower the fraction or the spacing"):
        fibre_cell(10, 0.8)
    with pytest.raises(ValueError, match=r"do not fit in a cell .* periodic cell"):
        pack(1, 0.8, periodic=False, spacing=0.0)
    with pytest.raises(ValueError, match="shape = 'ring' must be one of"):
        fibre_cell(10, 0.5, shape="ring")
    with pytest.raises(ValueError, match="cell = 'triangle' of a sphere must be one of"):
        fibre_cell(10, 0.5, shape="sphere", cell="triangle")
    with pytest.raises(ValueError, match=r"coating = -0\.1"):
        fibre_cell(10, 0.5, coating=-0.1)
    with pytest.raises(ValueError, match="must be positive"):
        fibre_cell(0, 0.5)
