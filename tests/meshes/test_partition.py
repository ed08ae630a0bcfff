"""Partitions that share the cells at interfaces, and the ghosts of surfaces."""

from __future__ import annotations

import numpy as np
from support.apart import rings

from vmdg import meshes
from vmdg.base.parallel import global_sum
from vmdg.domain.topology import outer_facets


def cylinder(comm) -> meshes.TaggedMesh:
    return meshes.pushout(comm, 8, 6, 2, 1, 8)


def cells_at_interface(tagged: meshes.TaggedMesh) -> tuple[int, int]:
    """Owned cells, and how many of them have a facet of the interface."""
    mesh, _, facet_tags = tagged
    owned = mesh.topology.index_map(3).size_local
    mesh.topology.create_connectivity(2, 3)
    links = mesh.topology.connectivity(2, 3)
    cells = [links.links(f) for f in facet_tags.find(6)]
    near = np.unique(np.concatenate([*cells, np.zeros(0, dtype=np.int32)]))
    return owned, int((near < owned).sum())


def test_slabs(comm):
    """Across the axis every rank has its share of cells, and of those at the interface.

    Ranks differ by one layer of 6 cells at the interface, of which there are 8 for all.
    """
    owned, near = cells_at_interface(cylinder(comm))
    cells, interface = global_sum(comm, owned), global_sum(comm, near)
    assert abs(owned - cells / comm.size) <= 1
    assert abs(near - interface / comm.size) <= interface / 8


def test_ghosts_of_surfaces(comm):
    """Of several pieces every rank has all cells at the surfaces, of one piece those of facets."""
    for scene in (rings("triangle", (24, 36), (1.0, 2.0, 3.0), comm=comm), cylinder(comm)):
        mesh = scene.mesh
        dim, imap = mesh.topology.dim, mesh.topology.index_map(mesh.topology.dim - 1)
        outer = outer_facets(mesh)
        count = global_sum(comm, outer[: imap.size_local].sum())
        assert (outer.sum() == count) == (dim == 2 or comm.size == 1)
        names = imap.local_to_global(np.flatnonzero(outer).astype(np.int32))
        everywhere = np.concatenate(comm.allgather(names[: outer[: imap.size_local].sum()]))
        assert set(names) <= set(everywhere)
        assert len(everywhere) == count == len(set(everywhere))
