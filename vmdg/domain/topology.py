"""Vectorised mesh queries: cells of facets, tags of cells, and facets selected by users."""

from __future__ import annotations

from collections.abc import Callable

import basix
import numpy as np
from dolfinx import la
from dolfinx.mesh import (
    Mesh,
    MeshTags,
    compute_midpoints,
    entities_to_geometry,
    exterior_facet_indices,
)
from numpy.typing import ArrayLike, NDArray

from ..base.agreement import together
from ..base.parallel import global_box, raise_together
from ..base.tables import rounded
from ..base.words import at_points

#: Predicate on points x (3, n), n truth values.
Locator = Callable[[NDArray[np.float64]], NDArray[np.bool_]]

#: phi(x) at points x (3, n), n values.
LevelSet = Callable[[NDArray[np.float64]], NDArray[np.float64]]

UNTAGGED = np.iinfo(np.int32).min


def facet_cells(mesh: Mesh) -> NDArray[np.int32]:
    """The two local cells of every local facet, -1 where there is no second cell; (nf, 2)."""
    tdim = mesh.topology.dim
    mesh.topology.create_connectivity(tdim - 1, tdim)
    connectivity = mesh.topology.connectivity(tdim - 1, tdim)
    offsets, cells = connectivity.offsets, connectivity.array
    two = np.diff(offsets) == 2
    pairs = np.full((len(two), 2), -1, dtype=np.int32)
    pairs[:, 0] = cells[offsets[:-1]]
    pairs[two, 1] = cells[offsets[1:][two] - 1]
    return pairs


def facet_corners(mesh: Mesh, facets: NDArray[np.int32]) -> NDArray[np.float64]:
    """Corners of facets (nf, corners, 3) [mm]."""
    dim = mesh.topology.dim - 1
    count = len(basix.geometry(basix.cell.subentity_types(mesh.basix_cell())[dim][0]))
    if not len(facets):  # entities_to_geometry divides by their number
        return np.zeros((0, count, 3))
    return mesh.geometry.x[entities_to_geometry(mesh, dim, facets)[:, :count]]


def local_facets(
    mesh: Mesh, cells: NDArray[np.int32], facets: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Number of each of ``facets`` within the cell of the same position."""
    tdim = mesh.topology.dim
    mesh.topology.create_connectivity(tdim, tdim - 1)
    connectivity = mesh.topology.connectivity(tdim, tdim - 1)
    count = connectivity.offsets[1] if len(connectivity.offsets) > 1 else 1
    of_cell = connectivity.array.reshape(-1, count)[cells]
    return np.argmax(of_cell == facets[:, None], axis=1).astype(np.int32)


def boundary_rows(mesh: Mesh, facets: NDArray[np.int32]) -> NDArray[np.int32]:
    """Cell and local facet number of the owned boundary facets among these, as integration entities
    (2 n,)."""
    owned = facets[facets < mesh.topology.index_map(mesh.topology.dim - 1).size_local]
    cells = facet_cells(mesh)[owned, 0]
    return np.column_stack([cells, local_facets(mesh, cells, owned)]).ravel()


def tags_of_cells(mesh: Mesh, cell_tags: MeshTags) -> NDArray[np.int32]:
    """Tag of every local cell, ghosts included; UNTAGGED where there is none."""
    cells = mesh.topology.index_map(mesh.topology.dim)
    tags = la.vector(cells, dtype=np.int32)
    tags.array[:] = UNTAGGED
    tags.array[cell_tags.indices] = cell_tags.values
    tags.scatter_forward()
    return tags.array.copy()


def mark_everywhere(mesh: Mesh, dim: int, entities: NDArray[np.int32]) -> NDArray[np.bool_]:
    marks = la.vector(mesh.topology.index_map(dim), dtype=np.int32)
    marks.array[entities] = 1
    marks.scatter_reverse(la.InsertMode.add)
    marks.scatter_forward()
    return marks.array > 0


def outer_facets(mesh: Mesh) -> NDArray[np.bool_]:
    """Mark the local facets, ghosts included, on the boundary of the mesh; collective."""
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    return mark_everywhere(mesh, dim - 1, exterior_facet_indices(mesh.topology))


def cells_inside(mesh: Mesh, level_set: LevelSet) -> NDArray[np.bool_]:
    """Local cells, ghosts included, at whose midpoint a level set is negative; collective."""
    if not callable(level_set):
        raise TypeError(
            f"the level set {level_set!r} must be a function of points x (3, n), for example "
            "lambda x: np.hypot(x[0], x[1]) - R"
        )
    cells = mesh.topology.index_map(mesh.topology.dim)
    owned = np.arange(cells.size_local, dtype=np.int32)
    midpoints = compute_midpoints(mesh, mesh.topology.dim, owned).T
    given = together(mesh.comm, lambda: at_points(level_set, midpoints, what="level set: "))
    values, message = np.asarray(given), None
    if values.dtype == bool:
        message = (
            "the level set returns True or False; it must return a number that is negative inside, "
            "for example lambda x: np.hypot(x[0], x[1]) - R instead of np.hypot(x[0], x[1]) < R"
        )
    elif values.shape != owned.shape or not np.isfinite(values.astype(float)).all():
        message = (
            f"the level set returns values of shape {values.shape} at points (3, {len(owned)}); it "
            "must return one finite number per point, for example lambda x: np.hypot(x[0], x[1]) - "
            "R"
        )
    raise_together(mesh.comm, message)
    # Owners decide, since rounding of a midpoint on the zero contour may differ between ranks.
    inside = la.vector(cells, dtype=np.int32)
    inside.array[: cells.size_local] = values < 0
    inside.scatter_forward()
    return inside.array > 0


def located(
    mesh: Mesh, find: Callable[[Locator], NDArray[np.int32]], where: Locator, what: str
) -> NDArray[np.int32]:
    """Entities that DOLFINx finds by a user's predicate; an error on one rank is raised on all."""
    if not callable(where):
        raise TypeError(
            f"{what}: where = {where!r} must be a predicate on coordinates (3, n), for example "
            "lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0)"
        )

    def checked(x: NDArray[np.float64]) -> NDArray[np.bool_]:
        marks = np.asarray(at_points(where, x, what=f"{what}: "))
        if marks.shape != x.shape[1:] or marks.dtype != bool:
            raise ValueError(
                f"{what}: the predicate must return True or False for each of the points x (3, n), "
                f"for example lambda x: np.isclose(x[0], 0); for {x.shape[1]} points it returned "
                f"values of shape {marks.shape} and type {marks.dtype}"
            )
        return marks

    return together(mesh.comm, lambda: find(checked))


def checked_facets(mesh: Mesh, where: ArrayLike, what: str) -> NDArray[np.int32]:
    """Local facets as given by a user; collective."""
    facets = np.asarray(where)
    if facets.ndim != 1 or (facets.size and facets.dtype.kind not in "iu"):
        raise TypeError(
            f"{what}: facets = {where!r} must be an array of local facets, as "
            "facet_tags.find(group) gives them, or a predicate on coordinates"
        )
    fdim = mesh.topology.dim - 1
    mesh.topology.create_entities(fdim)
    imap = mesh.topology.index_map(fdim)
    number = imap.size_local + imap.num_ghosts
    outside = facets[(facets < 0) | (facets >= number)]
    message = None
    if len(outside):
        message = (
            f"{what}: facet {outside[0]} does not exist on this rank, which has {number}; facets "
            "are local, as facet_tags.find gives them, and belong to the mesh of the problem"
        )
    raise_together(mesh.comm, message)
    return facets.astype(np.int32)


def refuse_facets(
    mesh: Mesh, facets: NDArray[np.int32], refused: NDArray[np.bool_], what: str, reason: str
) -> None:
    """Raise on all ranks if one of the owned ``facets`` is marked; collective."""
    fdim = mesh.topology.dim - 1
    owned = facets[facets < mesh.topology.index_map(fdim).size_local]
    bad, message = owned[refused[owned]], None
    if len(bad):
        place = rounded(compute_midpoints(mesh, fdim, bad[:1])[0])
        message = f"{what}: facet {bad[0]} at {place} {reason}"
    raise_together(mesh.comm, message)


def box_sides(mesh: Mesh) -> NDArray[np.float64]:
    """Sides of the bounding box of the mesh along x, y and z (3,) [mm]; collective."""
    low, high = global_box(mesh.comm, mesh.geometry.x)
    return high - low
