"""A layer of cells along the boundary of a mesh, for a rigid wall."""

from __future__ import annotations

from numbers import Real

import numpy as np
from dolfinx.cpp.io import perm_gmsh
from dolfinx.mesh import CellType, entities_to_geometry
from numpy.typing import ArrayLike, NDArray

from vmdg import compat
from vmdg.base.parallel import raise_together
from vmdg.domain.tags import names_of
from vmdg.domain.topology import (
    checked_facets,
    facet_cells,
    mark_everywhere,
    refuse_facets,
    tags_of_cells,
)

from .arrays import Block, MeshArrays, into_gmsh, rows_of
from .files import shifted
from .gmsh_model import TaggedMesh, distribute, model

#: Types of a cell and of its facets in gmsh, and its facets in DOLFINx.
_KINDS = {
    "triangle": (2, 1, CellType.interval),
    "quadrilateral": (3, 1, CellType.interval),
    "tetrahedron": (4, 2, CellType.triangle),
    "hexahedron": (5, 3, CellType.quadrilateral),
}

Nodes = NDArray[np.int64]


def with_wall(
    tagged: TaggedMesh, facets: ArrayLike, thickness: float | None = None, name: str = "wall"
) -> TaggedMesh:
    """Add one layer of cells outside boundary facets, for a :class:`vmdg.Rigid` wall; collective.

    The new cells share the nodes of the facets; an interface separates them from the body, as in
    ``Interface(between=("wall", "matrix"), ...)``. They form a new group, and so do their outer
    facets, both called ``name``, with a tag above all others. Other groups keep their tags and
    names. The mesh is distributed again.

    Args:
        tagged: A mesh of straight cells, with tags.
        facets: Local boundary facets, ``tagged.facet_tags.find("right")`` for example.
        thickness: Of the layer [mm]; None for the mean size of the facets. It does not affect the
            result; in a notch it must be less than half of its width.
        name: Name of both new groups.

    Returns:
        Mesh, cell tags and facet tags.

    Raises:
        TypeError: names or tags in place of facets.
        ValueError: nothing or an interior facet is selected, the name is in use, the thickness is
            not positive, or cells are curved.
    """
    mesh, cell_tags, facet_tags = tagged
    comm, dim = mesh.comm, mesh.topology.dim
    if compat.coordinate_element(mesh).degree > 1:
        raise ValueError(
            "with_wall: the cells of the mesh are curved; add the wall before curving them"
        )
    if thickness is not None and not (isinstance(thickness, Real) and 0 < thickness < np.inf):
        raise ValueError(f"with_wall: thickness = {thickness!r} must be positive and finite [mm]")
    groups = {dim: names_of(cell_tags), dim - 1: names_of(facet_tags)}
    if any(name in names for names in groups.values()):
        raise ValueError(f"with_wall: there is already a group {name!r}; choose another name=")
    mesh.topology.create_connectivity(dim - 1, dim)
    mesh.topology.create_connectivity(dim - 1, 0)
    pairs = facet_cells(mesh)
    along = np.flatnonzero(
        mark_everywhere(mesh, dim - 1, checked_facets(mesh, facets, "with_wall"))
    )
    along = along[along < mesh.topology.index_map(dim - 1).size_local].astype(np.int32)
    inside = np.logical_and(*(pairs >= 0).T)
    refuse_facets(
        mesh, along, inside, "with_wall", "lies inside the mesh; a wall needs boundary facets"
    )
    raise_together(comm, None if comm.allreduce(len(along)) else "with_wall: no facet is selected")
    parts = comm.gather(_of_rank(tagged, along, pairs[along].max(axis=1)))
    with model("wall") as gmsh_model:
        shift = 0
        if comm.rank == 0:
            arrays = [np.concatenate(values) for values in zip(*parts, strict=True)]
            cell = mesh.topology.cell_name()
            whole = _with_layer(cell, arrays, groups, thickness, name)
            into_gmsh(gmsh_model, whole)
            shift = whole.shift
        return shifted(distribute(gmsh_model, comm, dim), comm.bcast(shift))


def _of_rank(
    tagged: TaggedMesh, along: NDArray[np.int32], cells: NDArray[np.int32]
) -> tuple[NDArray, ...]:
    """Points, cells and their tags, tagged facets and their tags, facets of the wall and their
    outward area vectors, on this rank; nodes by their global numbers."""
    mesh, cell_tags, facet_tags = tagged
    dim, index_map = mesh.topology.dim, mesh.geometry.index_map()
    owned = mesh.topology.index_map(dim).size_local
    x, number = mesh.geometry.x, index_map.size_local + index_map.num_ghosts
    names = index_map.local_to_global(np.arange(number, dtype=np.int32))
    dofmap = compat.geometry_dofmap(mesh)
    count = mesh.topology.index_map(dim - 1).size_local
    here = facet_tags.indices < count
    # entities_to_geometry divides by their number.
    corners = dim if mesh.basix_cell().name in ("triangle", "tetrahedron") else 2 ** (dim - 1)

    def nodes_of(facets: NDArray[np.int32]) -> NDArray[np.int32]:
        if not len(facets):
            return np.zeros((0, corners), dtype=np.int32)
        return entities_to_geometry(mesh, dim - 1, facets)

    beside = nodes_of(along)
    first = x[beside[:, 1]] - x[beside[:, 0]]
    second = np.array([0.0, 0.0, 1.0]) if dim == 2 else x[beside[:, 2]] - x[beside[:, 0]]
    normal = np.cross(first, second)
    outward = x[beside].mean(axis=1) - x[dofmap[cells]].mean(axis=1)
    normal *= np.sign(np.einsum("fi,fi->f", normal, outward))[:, None]
    if corners == 3:
        normal /= 2
    return (
        x[: index_map.size_local],
        names[dofmap[:owned]],
        tags_of_cells(mesh, cell_tags)[:owned],
        names[nodes_of(facet_tags.indices[here])],
        facet_tags.values[here],
        names[beside],
        normal,
    )


def _with_layer(
    cell: str,
    arrays: list[NDArray],
    groups: dict[int, dict[str, int]],
    thickness: float | None,
    name: str,
) -> MeshArrays:
    points, cells, tags, facets, values, along, normal = arrays
    dim = max(groups)
    kind, facet_kind, facet_type = _KINDS[cell]
    area = np.linalg.norm(normal, axis=1)
    if thickness is None:
        thickness = float((area ** (1 / (dim - 1))).mean())
    inner, place = np.unique(along, return_inverse=True)
    direction = np.zeros((len(inner), 3))
    np.add.at(direction, place.reshape(along.shape), normal[:, None])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    outer = np.arange(len(points) + len(inner))
    outer[inner] = len(points) + np.arange(len(inner))
    wall, outside = int(tags.max()) + 1, int(values.max(initial=0)) + 1
    shift = max(1 - int(tags.min()), 0)
    in_gmsh = _in_gmsh_order(CellType[cell], cells)
    sides = _in_gmsh_order(facet_type, facets)
    layer = _layer(cell, _in_gmsh_order(facet_type, along), outer)
    blocks = [Block(dim, kind, in_gmsh[rows], tag + shift, 0) for tag, rows in rows_of(tags)]
    blocks.append(Block(dim, kind, layer, wall + shift, 0))
    marked = [(tag, rows) for tag, rows in rows_of(values) if tag > 0]
    blocks += [Block(dim - 1, facet_kind, sides[rows], tag, 0) for tag, rows in marked]
    far = outer[_in_gmsh_order(facet_type, along)]
    blocks.append(Block(dim - 1, facet_kind, far, outside, 0))
    names = {
        dim: {n: tag + shift for n, tag in (groups[dim] | {name: wall}).items()},
        dim - 1: groups[dim - 1] | {name: outside},
    }
    return MeshArrays(
        np.vstack([points, points[inner] + thickness * direction]), blocks, names, shift
    )


def _in_gmsh_order(kind: CellType, nodes: Nodes) -> Nodes:
    """Nodes (n, k) of cells or facets that have DOLFINx's order."""
    result = np.empty_like(nodes)
    result[:, perm_gmsh(kind, nodes.shape[1])] = nodes
    return result


def _layer(cell: str, facets: Nodes, outer: Nodes) -> Nodes:
    """Cells between facets (n, k) and their copies ``outer[facets]``."""
    if cell == "hexahedron":
        return np.hstack([facets, outer[facets]])
    if cell == "quadrilateral":
        return np.hstack([facets, outer[facets][:, ::-1]])
    # Simplices by ascending nodes: the sides of neighbours are cut along the same diagonals.
    low = np.sort(facets, axis=1)
    high, corners = outer[low], low.shape[1]
    cuts = [np.hstack([low[:, : i + 1], high[:, i:]]) for i in range(corners)]
    return np.concatenate(cuts)
