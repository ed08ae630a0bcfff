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


def volume(tagged: TaggedMesh, group: str | int) -> float:
    """Of a group of cells."""
    mesh, cells, _ = tagged
    tag = cells.names[group] if isinstance(group, str) else group
    dx = ufl.Measure("dx", mesh, subdomain_data=cells)
    part = fem.assemble_scalar(fem.form(fem.Constant(mesh, 1.0) * dx(tag)))
    return mesh.comm.allreduce(part)


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
