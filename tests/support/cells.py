"""What tests ask of meshes of cells: volumes of groups, and sides that match."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import compute_midpoints
from scipy.spatial import cKDTree

from support.checks import gather
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
    fdim, worst = mesh.topology.dim - 1, 0.0
    for axis, names in enumerate(SIDES[: mesh.topology.dim]):
        low, high = (_places(mesh, fdim, facets.find(name)) for name in names)
        assert len(low) > 0
        if len(low) != len(high):
            return np.inf
        high[:, axis] -= high[:, axis].max() - low[:, axis].max()
        worst = max(worst, *(cKDTree(a).query(b)[0].max() for a, b in ((low, high), (high, low))))
    return worst


def _places(mesh, fdim, facets) -> np.ndarray:
    """Midpoints of the owned facets of all ranks."""
    owned = facets[facets < mesh.topology.index_map(fdim).size_local]
    return gather(mesh.comm, compute_midpoints(mesh, fdim, owned))
