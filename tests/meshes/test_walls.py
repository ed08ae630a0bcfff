"""A layer of cells for a rigid wall: where it is, what it is called, and what is refused."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import (
    GhostMode,
    compute_midpoints,
    create_unit_square,
    locate_entities_boundary,
    meshtags,
)
from parts.verification.checks import core_and_ring
from support.scenes import EVERY_CELL

from vmdg.meshes import TaggedMesh, blocks, with_wall


def volume(tagged, name) -> float:
    """Of a group of cells, or its area."""
    mesh, cells, _ = tagged
    dx = ufl.Measure("dx", mesh, subdomain_data=cells)(cells.names[name])
    return mesh.comm.allreduce(fem.assemble_scalar(fem.form(fem.Constant(mesh, 1.0) * dx)))


@EVERY_CELL
@pytest.mark.parametrize("thickness", [None, 0.1])
def test_along_a_side(comm, cell, thickness):
    """The layer lies outside, groups keep their cells, and its outer facets are a group."""
    tagged = blocks(comm, cell, (2, 2, 2))
    groups = {name: volume(tagged, name) for name in tagged.cell_tags.names}
    facets = dict(tagged.facet_tags.names)
    wall = with_wall(tagged, tagged.facet_tags.find("right"), thickness, "tool")
    size = thickness or {"tetrahedron": np.sqrt(1 / 8)}.get(cell, 0.5)
    for name, before in groups.items():
        assert volume(wall, name) == pytest.approx(before)
    assert volume(wall, "tool") == pytest.approx(size)
    assert wall.cell_tags.names == {"left": 1, "right": 2, "tool": 3}
    assert wall.facet_tags.names == facets | {"tool": max(facets.values()) + 1}
    for name, x in (("tool", 2.0 + size), ("right", 2.0), ("left", 0.0)):
        found = wall.facet_tags.find(name)
        middle = compute_midpoints(wall.mesh, wall.mesh.topology.dim - 1, found)[:, 0]
        assert middle == pytest.approx(np.full(len(found), x))
        assert comm.allreduce(len(found)) >= {2: 2, 3: 4}[wall.mesh.geometry.dim]


def test_round_a_disc(comm):
    """On a curved boundary the layer is as thick everywhere, up to the chords at its ends."""
    tagged = core_and_ring(comm, 2.0, 0.1)
    wall = with_wall(tagged, tagged.facet_tags.find(4), 0.1)
    far = comm.allreduce(np.linalg.norm(wall.mesh.geometry.x, axis=1).max(), op=MPI.MAX)
    assert far == pytest.approx(2.1, abs=1e-9)
    ring = np.pi / 4 * (2.1**2 - 2.0**2)
    assert volume(wall, "wall") == pytest.approx(ring, rel=0.02)


def test_tags_from_zero(comm):
    """Tags of cells may begin at 0, and groups need no names."""
    mesh = create_unit_square(comm, 2, 2, ghost_mode=GhostMode.shared_facet)
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    tags = meshtags(mesh, 2, cells, np.zeros_like(cells))
    right = locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[0], 1.0))
    facets = meshtags(mesh, 1, np.sort(right), np.full_like(right, 5))
    wall = with_wall(TaggedMesh(mesh, tags, facets), right)
    assert wall.cell_tags.names == {"wall": 1} and wall.facet_tags.names == {"wall": 6}
    assert set(np.concatenate(comm.allgather(wall.cell_tags.values))) == {0, 1}
    assert comm.allreduce(len(wall.facet_tags.find(5))) >= 2


def refused(tagged, facets, **options):
    with pytest.raises(ValueError) as caught:
        with_wall(tagged, facets, **options)
    return str(caught.value)


def test_refused(comm):
    """Facets inside, none, names that are taken, no thickness, curved cells."""
    tagged = blocks(comm, "triangle", (2, 2))
    right, inside = (tagged.facet_tags.find(name) for name in ("right", "interface"))
    assert "lies inside the mesh; a wall needs boundary" in refused(tagged, inside)
    assert "no facet is selected" in refused(tagged, right[:0])
    assert "already a group 'left'" in refused(tagged, right, name="left")
    for thickness in (0.0, "1.0", np.nan):
        assert "must be positive and finite" in refused(tagged, right, thickness=thickness)
    curved = core_and_ring(comm, 2.0, 0.5, order=2)
    assert "are curved" in refused(curved, curved.facet_tags.find(4))
    with pytest.raises(TypeError, match="must be an array of local facets"):
        with_wall(tagged, "right")
