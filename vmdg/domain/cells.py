"""Cells on which no element can be built: degenerate, inverted, or folded over a neighbour."""

from __future__ import annotations

import basix
import numpy as np
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from .. import compat
from ..base.parallel import raise_together
from ..base.tables import rounded
from .shapes import GeometryMap, determinants
from .topology import facet_cells, local_facets

# Relative to rounding zero: det J over the lengths of its columns, and edges at a corner over the
# longest.
_FLAT, _SHORT = 1e-14, 1e-12

# Cells and facets per batch.
_BATCH = 2**16

REMEDY = "move its nodes or remesh"


def check_cells(mesh: Mesh) -> None:
    """Refuse meshes with cells on which no element can be built; collective.

    det dX/dxi must have one sign at the corners and inside of every cell, edges must have a length,
    and the two cells of a facet must lie on different sides of it; this is the only sign of an
    inverted simplex.
    """
    # Collective, so before ranks with a bad cell leave.
    pairs = facet_cells(mesh)
    mesh.topology.create_connectivity(mesh.topology.dim, mesh.topology.dim - 1)
    raise_together(mesh.comm, _bad_cell(mesh) or _folded_cell(mesh, pairs))


def _bad_cell(mesh: Mesh) -> str | None:
    """What is wrong with the first degenerate or inverted cell of this rank."""
    cell = mesh.basix_cell()
    corners = basix.geometry(cell)
    inside, _ = basix.make_quadrature(cell, 2 * compat.coordinate_element(mesh).degree)
    geometry_map = GeometryMap(mesh, np.concatenate([corners, inside]))
    for start in range(0, len(compat.geometry_dofmap(mesh)), _BATCH):
        x = geometry_map.nodes(slice(start, start + _BATCH))
        J = geometry_map.jacobians(x - x[:, :1])
        edges = np.linalg.norm(J, axis=2)
        with np.errstate(invalid="ignore"):
            det, size = determinants(J), edges.prod(axis=2)
        det *= np.where(det.sum(axis=1) < 0, -1, 1)[:, None]
        # Two edges may be collinear at a corner, but not at interior points, where integrals are
        # taken. The comparison also catches coordinates that are not finite.
        flat = ~(det > _FLAT * size)[:, len(corners) :].all(axis=1)
        collapsed = edges.min(axis=(1, 2)) <= _SHORT * edges.max(axis=(1, 2))
        turned = (det < -_FLAT * size).any(axis=1) & ~collapsed
        bad = np.flatnonzero(flat | turned | collapsed)
        if len(bad):
            what = "inverted" if turned[bad[0]] else "degenerate"
            return (
                f"{_where(mesh, start + bad[0])} is {what}: its Jacobian determinant lies between "
                f"{det[bad[0]].min():.3g} and {det[bad[0]].max():.3g}; {REMEDY}"
            )
    return None


def _folded_cell(mesh: Mesh, pairs: NDArray[np.int32]) -> str | None:
    """What is wrong with the first two cells of this rank that lie on one side of their facet."""
    inner = np.flatnonzero((pairs >= 0).all(axis=1)).astype(np.int32)
    topology = basix.topology(basix.CellType[mesh.topology.cell_name()])
    corners = np.array(topology[mesh.topology.dim - 1])
    for start in range(0, len(inner), _BATCH):
        facets = inner[start : start + _BATCH]
        cells = pairs[facets]
        nodes = compat.geometry_dofmap(mesh)[cells]
        x = mesh.geometry.x[nodes[:, :, : len(topology[0])]]
        local = local_facets(mesh, cells[:, 0], facets)
        facet = np.take_along_axis(x[:, 0], corners[local][:, :, None], axis=1)
        apart = x.mean(axis=2) - facet.mean(axis=1)[:, None]
        sides = np.einsum("fai,fi->fa", apart, _normals(facet))
        folded = np.flatnonzero(sides.prod(axis=1) > 0)
        if len(folded):
            first, second = cells[folded[0]]
            return (
                f"{_where(mesh, first)} is inverted, or its neighbour, cell {second}, is: both lie "
                f"on one side of the facet they share; {REMEDY}"
            )
    return None


def _normals(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normals (n, 3), of any length and sign, of facets given by their corners (n, 2 to 4, 3)."""
    first = corners[:, -1] - corners[:, 0]
    if corners.shape[1] == 2:
        return np.cross(first, [0.0, 0.0, 1.0])
    # The diagonals of a quadrilateral, two sides of a triangle.
    return np.cross(first, corners[:, -2] - corners[:, 0 if corners.shape[1] == 3 else 1])


def _where(mesh: Mesh, cell: int) -> str:
    d = mesh.geometry.dim
    midpoint = mesh.geometry.x[compat.geometry_dofmap(mesh)[cell], :d].mean(axis=0)
    return f"Problem: cell {cell} at {rounded(midpoint)}"
