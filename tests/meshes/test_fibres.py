"""Meshes of fibres in a matrix: areas, tags, quality, distances."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx.mesh import compute_midpoints
from support.checks import integral

from vmdg import compat
from vmdg.base.parallel import global_max
from vmdg.domain.topology import facet_cells, tags_of_cells
from vmdg.meshes import fibre_matrix, random_fibres

BOTH = pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])


def area(tagged, tag: int) -> float:
    """Area of the cells of a tag [mm2]."""
    dx = ufl.dx(domain=tagged.mesh, subdomain_data=tagged.cell_tags, subdomain_id=tag)
    return integral(tagged.mesh.comm, 1.0 * dx)


def smallest_angle(mesh) -> float:
    """Of the corners of all cells [degrees]; a concave corner counts as its distance from 180."""
    nodes = compat.geometry_dofmap(mesh)
    corners = mesh.geometry.x[nodes if nodes.shape[1] == 3 else nodes[:, [0, 1, 3, 2]], :2]
    back, ahead = np.roll(corners, 1, 1) - corners, np.roll(corners, -1, 1) - corners
    cosine = (back * ahead).sum(-1) / np.linalg.norm(back, axis=-1)
    angle = np.degrees(np.arccos(cosine / np.linalg.norm(ahead, axis=-1)))
    return -global_max(mesh.comm, -min(angle.min(), 180 - angle.max()))


@BOTH
def test_areas_tags_and_quality(comm, cell):
    """Fibre and matrix fill the square, the interface lies on the circle, no cell is bad."""
    size, h = 1.0, 0.06
    tagged = fibre_matrix(comm, cell, size, 0.25, element_size=h)
    corners = round(2 * np.pi * 0.25 / h / 2) * 2
    polygon = corners / 2 * 0.25**2 * np.sin(2 * np.pi / corners)
    assert area(tagged, 1) == pytest.approx(polygon, rel=0.02)
    assert area(tagged, 1) + area(tagged, 2) == pytest.approx(size**2, rel=1e-12)
    assert smallest_angle(tagged.mesh) > 25
    facets = tagged.facet_tags.find(3)
    pairs = facet_cells(tagged.mesh)[facets]
    tags = tags_of_cells(tagged.mesh, tagged.cell_tags)
    inside = (pairs >= 0).all(axis=1)
    assert (np.sort(tags[pairs[inside]], axis=1) == (1, 2)).all()
    middle = compute_midpoints(tagged.mesh, 1, facets)[:, :2] - size / 2
    assert np.abs(np.linalg.norm(middle, axis=1) - 0.25).max(initial=0) < h**2 / (8 * 0.25)


def test_sides_are_where_their_names_say(comm):
    """Of each the integral of x, length times middle."""
    tagged = fibre_matrix(comm, size=2.0, radius=0.3, element_size=0.3)
    ds = ufl.Measure("ds", domain=tagged.mesh, subdomain_data=tagged.facet_tags)
    x = ufl.SpatialCoordinate(tagged.mesh)
    middles = {"left": (0, 1), "right": (2, 1), "bottom": (1, 0), "top": (1, 2)}
    for name, middle in middles.items():
        for i in range(2):
            moment = integral(comm, x[i] * ds(tagged.facet_tags.names[name]))
            assert moment == pytest.approx(2 * middle[i], abs=1e-12)


@pytest.mark.parametrize("count", [5, 8])
def test_random_fibres_keep_their_distance(comm, count):
    """The wanted fraction, nobody cut or touching, the same seed the same cell."""
    centres, radius = random_fibres(count, 0.3, size=2.0, spacing=0.15, margin=0.2, seed=3)
    assert count * np.pi * radius**2 == pytest.approx(0.3 * 4.0)
    assert (np.abs(centres - 1.0) <= 1.0 - 1.2 * radius).all()
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1)[np.triu_indices(count, 1)]
    assert apart.min() >= 2.15 * radius
    again, _ = random_fibres(count, 0.3, size=2.0, spacing=0.15, margin=0.2, seed=3)
    assert np.array_equal(centres, again)
    assert comm.allgather(centres.tobytes()) == [centres.tobytes()] * comm.size
    tagged = fibre_matrix(comm, "triangle", 2.0, radius, centres, element_size=0.06)
    assert area(tagged, 1) == pytest.approx(1.2, rel=0.02)


def test_impossible_cells_are_refused(comm):
    """The message says what is wrong."""
    with pytest.raises(ValueError, match="leaves the square"):
        fibre_matrix(comm, centres=[[0.2, 0.5]])
    with pytest.raises(ValueError, match="overlap"):
        fibre_matrix(comm, radius=0.2, centres=[[0.3, 0.5], [0.6, 0.5]])
    with pytest.raises(ValueError, match="cell = 'hexahedron'"):
        fibre_matrix(comm, "hexahedron")
    with pytest.raises(ValueError, match="no place for 9 fibres"):
        random_fibres(9, 0.7)
