"""Meshes of simplices that are halved where they are to be small."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx.mesh import compute_midpoints, entities_to_geometry

from vmdg.meshes import beams, blocks, refined


def near_the_middle(x):
    return 0.1 + 0.5 * np.abs(x[0] - 1.0)


@pytest.mark.parametrize("cell", ("triangle", "tetrahedron"))
def test_sizes_and_tags(comm, cell):
    """No edge is longer than asked for, cells and facets have the tags of what they are part of,
    and bodies keep their volumes; on any number of ranks as many cells."""
    root = blocks(comm, cell, (2, 2, 2))
    found = refined(root, near_the_middle)
    mesh, cells, facets = found
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(1, 0)
    mesh.topology.create_connectivity(1, dim)
    edges = np.arange(mesh.topology.index_map(1).size_local, dtype=np.int32)
    ends = mesh.geometry.x[entities_to_geometry(mesh, 1, edges)]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert (length <= 1.001 * near_the_middle(ends.mean(axis=1).T)).all()
    assert comm.allreduce(length.min(initial=9.0), op=MPI.MIN) > 0.02
    right = compute_midpoints(mesh, dim, cells.indices)[:, 0] > 1
    assert np.array_equal(cells.values, 1 + right)
    x = compute_midpoints(mesh, dim - 1, facets.indices)
    places = {1: (0, 0.0), 2: (0, 2.0), 3: (0, 1.0), 4: (1, 0.0), 5: (1, 1.0), 6: (2, 0.0)}
    for tag, (axis, place) in places.items():
        assert np.array_equal(facets.values == tag, np.isclose(x[:, axis], place)) or (
            dim == 2 and axis == 2
        )
    assert facets.names == root.facet_tags.names
    alone = refined(blocks(MPI.COMM_SELF, cell, (2, 2, 2)), near_the_middle).mesh
    assert mesh.topology.index_map(dim).size_global == alone.topology.index_map(dim).size_global


def test_slit_stays_open(comm):
    """The faces of a crack share no nodes but at its tip."""
    root = beams(comm, cell="triangle", stations=(0.0, 2.0, 4.0), divisions=(2, 2), precrack=2.0)
    mesh, _, facets = refined(root, lambda x: np.full(x.shape[1], 0.3))
    faces = facets.indices[facets.values == 7]
    x = compute_midpoints(mesh, 1, faces)
    count = mesh.topology.index_map(1).size_local
    owned = comm.allreduce(int((faces < count).sum()))
    # Two faces of 2 mm with facets of 1/4 mm.
    assert owned == 16 and np.allclose(x[:, 1], 0.0) and (x[:, 0] < 2).all()


def test_wrong_arguments(comm):
    """Other cells, and sizes that are none."""
    with pytest.raises(ValueError, match="cells are quadrilaterals of degree 1; edges are halved"):
        refined(blocks(comm, "quadrilateral", (2, 2)), near_the_middle)
    with pytest.raises(ValueError, match="must return a positive length for each of them"):
        refined(blocks(comm, "triangle", (2, 2)), lambda x: 0 * x[0])
    with pytest.raises(ZeroDivisionError):  # on every rank, though rank 0 alone asks for sizes
        refined(blocks(comm, "triangle", (2, 2)), lambda x: 1 // 0)
