"""What tests ask of meshes of cells: volumes of groups, and sides that match."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import compute_midpoints
from scipy.spatial import cKDTree

from support.checks import gather
from vmdg.domain.topology import facet_cells, tags_of_cells
from vmdg.meshes import TaggedMesh

SIDES = (("left", "right"), ("bottom", "top"), ("back", "front"))


def volumes(tagged: TaggedMesh) -> dict[str, float]:
    """Of the groups of cells, whose cells have straight sides."""
    mesh, cells, _ = tagged
    test = ufl.TestFunction(fem.functionspace(mesh, ("DG", 0)))
    of_cell = fem.assemble_vector(fem.form(test * ufl.dx(mesh))).array
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    return {
        name: mesh.comm.allreduce(of_cell[(found := cells.find(name))[found < owned]].sum())
        for name in cells.names
    }


def mismatch(tagged: TaggedMesh) -> float:
    """Largest distance of a facet of a side from its image on the opposite side, all sides.

    Infinite where the sides have different numbers of facets, or facets of different bodies.
    """
    mesh, _, facets = tagged
    worst = 0.0
    for axis, names in enumerate(SIDES[: mesh.topology.dim]):
        (low, one), (high, two) = (_places(tagged, facets.find(name)) for name in names)
        assert len(low) > 0
        high[:, axis] -= high[:, axis].max() - low[:, axis].max()
        apart, image = cKDTree(high).query(low)
        if len(low) != len(high) or len(set(image)) != len(low) or (one != two[image]).any():
            return np.inf
        worst = max(worst, apart.max())
    return worst


def _places(tagged: TaggedMesh, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Midpoints of the owned facets of all ranks, and the tags of their cells."""
    mesh, cells, _ = tagged
    fdim = mesh.topology.dim - 1
    owned = facets[facets < mesh.topology.index_map(fdim).size_local]
    bodies = tags_of_cells(mesh, cells)[facet_cells(mesh)[owned, 0]]
    return gather(mesh.comm, compute_midpoints(mesh, fdim, owned)), gather(mesh.comm, bodies)
