"""The half section of the push-out: areas, tags, sizes, errors."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import compute_midpoints
from support.checks import gather, integral

from vmdg.meshes import pushout_section
from vmdg.meshes.pushout_section import (
    AXIS,
    FIBRE,
    FIBRE_BOTTOM,
    FIBRE_TOP,
    HOLE,
    INTERFACE,
    MATRIX,
    MATRIX_TOP,
    OUTER,
    SUPPORT,
)

R_F, R_S, R_M, H = 0.95, 1.025, 4.3, 5.36

# Where every facet lies, as a predicate on its midpoint (r, z); how many there are.
PLACE = {
    FIBRE_TOP: (lambda r, z: (z == H) & (r < R_F), 5),
    FIBRE_BOTTOM: (lambda r, z: (z == 0) & (r < R_F), 5),
    MATRIX_TOP: (lambda r, z: (z == H) & (r > R_F), 2 + 6),
    SUPPORT: (lambda r, z: (z == 0) & (r > R_S), 6),
    HOLE: (lambda r, z: (z == 0) & (r > R_F) & (r < R_S), 2),
    INTERFACE: (lambda r, z: r == R_F, 9),
    OUTER: (lambda r, z: r == R_M, 9),
    AXIS: (lambda r, z: r == 0, 9),
}


@pytest.fixture(scope="module")
def scene(comm):
    """A coarse section with every number different."""
    return pushout_section(comm, layers=9, fibre_cells=5, hole_cells=2, matrix_cells=6, grading=2)


def owned(tags, tag, index_map):
    """Entities of a tag that this rank owns."""
    found = tags.find(tag)
    return found[found < index_map.size_local]


@pytest.mark.parametrize("tag", PLACE)
def test_facet_tags(comm, scene, tag):
    """Every tag holds all facets of its place and no other."""
    mesh, _, tags = scene
    mesh.topology.create_entities(1)
    facets = owned(tags, tag, mesh.topology.index_map(1))
    middle = gather(comm, np.round(compute_midpoints(mesh, 1, facets), 12))
    predicate, count = PLACE[tag]
    assert len(middle) == count
    assert predicate(middle[:, 0], middle[:, 1]).all()


@pytest.mark.parametrize(
    "tag, area, cells", [(FIBRE, R_F * H, 5 * 9), (MATRIX, (R_M - R_F) * H, 8 * 9)]
)
def test_bodies(comm, scene, tag, area, cells):
    """Their areas in the section, and the number of quadrilaterals."""
    mesh, tags, _ = scene
    assert mesh.topology.cell_name() == "quadrilateral"
    assert comm.allreduce(len(owned(tags, tag, mesh.topology.index_map(2)))) == cells
    dx = ufl.Measure("dx", domain=mesh, subdomain_data=tags)
    one = fem.Constant(mesh, 1.0)
    found = integral(comm, one * dx(tag))
    assert found == pytest.approx(area, rel=1e-12)


def test_sizes(comm, scene):
    """Radial sizes in geometric progression with the ratio asked for; layers finer at the ends."""
    x = gather(comm, scene.mesh.geometry.x)
    r, z = (np.unique(np.round(x[:, i], 9)) for i in range(2))
    assert R_S in r
    fibre, matrix = np.diff(r[r <= R_F]), np.diff(r[r >= R_S])
    assert fibre[0] / fibre[-1] == pytest.approx(10, rel=1e-6)
    assert matrix[-1] / matrix[0] == pytest.approx(10, rel=1e-6)
    layers = np.diff(z)
    assert len(layers) == 9
    assert layers == pytest.approx(layers[::-1], rel=1e-6)
    # The limit of many layers is 2; the middles of 9 lie inside of the ends.
    assert 1.6 < layers[4] / layers[0] < 2


@pytest.mark.parametrize(
    "options, message",
    [
        ({"layers": 0}, "layers = 0"),
        ({"hole_cells": 0}, "at least 1"),
        ({"radial_ratio": 0.0}, "must be positive"),
        ({"grading": -1.0}, "must be positive"),
        ({"height": 0.0}, "must be positive"),
        ({"hole_radius": 0.9}, "must increase from 0"),
        ({"matrix_radius": 1.0}, "must increase from 0"),
    ],
)
def test_errors(comm, options, message):
    """Sizes that cannot be meshed."""
    with pytest.raises(ValueError, match=message):
        pushout_section(comm, **options)
