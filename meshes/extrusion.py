"""Extrusion of a plane gmsh mesh along z, which preserves matching sides."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .periodic import BACK, FRONT, TOLERANCE

#: Element types of gmsh.
TRIANGLE, QUADRILATERAL, TETRAHEDRON, HEXAHEDRON = 2, 3, 4, 5


def extrude(gmsh_model: Any, size: float, depth: float, layer: float) -> None:
    """Extrude the plane mesh of [0, size]^2 from z = 0 to ``depth``; it replaces the model.

    Triangles become prisms of three tetrahedra each, quadrilaterals hexahedra. A diagonal starts at
    the lower corner that comes first in a numbering shared by opposite sides, so that the diagonals
    of neighbours and of opposite sides match.
    """
    points, cells, facets = _plane_mesh(gmsh_model)
    layers = max(1, round(depth / layer))
    first = _first_images(points, size)
    count = len(points)
    z = np.linspace(0, depth, layers + 1)
    solid = np.column_stack([np.tile(points, (layers + 1, 1)), np.repeat(z, count)])
    simplices = next(iter(cells.values())).shape[1] == 3
    order = _sorted_by(first) if simplices else lambda nodes: nodes
    cells = {tag: order(nodes) for tag, nodes in cells.items()}
    facets = {tag: order(nodes) for tag, nodes in facets.items()}
    gmsh_model.add("extruded")
    number = gmsh_model.addDiscreteEntity(3)
    gmsh_model.mesh.addNodes(3, number, np.arange(1, len(solid) + 1), solid.ravel())
    split = (_tetrahedra, _triangles) if simplices else (_hexahedra, _quadrilaterals)
    kinds = (TETRAHEDRON, TRIANGLE) if simplices else (HEXAHEDRON, QUADRILATERAL)
    faces = {tag: _layered(nodes, split[1], layers, count) for tag, nodes in facets.items()}
    plane = np.concatenate(list(cells.values()))
    faces |= {BACK: plane, FRONT: plane + layers * count}
    _add(gmsh_model, 2, faces, kinds[1])
    solids = {tag: _layered(nodes, split[0], layers, count) for tag, nodes in cells.items()}
    _add(gmsh_model, 3, solids, kinds[0])


def _plane_mesh(
    gmsh_model: Any,
) -> tuple[NDArray[np.float64], dict[int, NDArray[np.int64]], dict[int, NDArray[np.int64]]]:
    """Points (n, 2), nodes of the cells and of the facets by group."""
    names, coordinates, _ = gmsh_model.mesh.getNodes()
    place = np.zeros(int(names.max()) + 1, dtype=np.int64)
    place[names.astype(np.int64)] = np.arange(len(names))
    groups: list[dict[int, NDArray[np.int64]]] = [{}, {}]
    for dim, found in zip((2, 1), groups, strict=True):
        for _, tag in gmsh_model.getPhysicalGroups(dim):
            parts = []
            for entity in gmsh_model.getEntitiesForPhysicalGroup(dim, tag):
                kinds, _, nodes = gmsh_model.mesh.getElements(dim, entity)
                width = gmsh_model.mesh.getElementProperties(kinds[0])[3]
                parts.append(place[nodes[0].astype(np.int64)].reshape(-1, width))
            found[tag] = np.concatenate(parts)
    return coordinates.reshape(-1, 3)[:, :2], *groups


def _first_images(points: NDArray[np.float64], size: float) -> NDArray[np.int64]:
    grid = np.round(points / (TOLERANCE * size)).astype(np.int64) % round(1 / TOLERANCE)
    return np.unique(grid, axis=0, return_inverse=True)[1].ravel()


def _sorted_by(key: NDArray[np.int64]) -> Any:
    def order(nodes: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.take_along_axis(nodes, np.argsort(key[nodes], axis=1), axis=1)

    return order


def _layered(nodes: NDArray, split: Any, layers: int, count: int) -> NDArray[np.int64]:
    """Cells or faces of all layers; ``split(below, above)`` makes those of one."""
    made = [split(nodes + k * count, nodes + (k + 1) * count) for k in range(layers)]
    return np.concatenate(made)


def _tetrahedra(low: NDArray, high: NDArray) -> NDArray:
    """Three per prism, with corners in ascending order."""
    a, b, c = low.T
    d, e, f = high.T
    return np.column_stack([a, b, c, f, a, b, e, f, a, d, e, f]).reshape(-1, 4)


def _triangles(low: NDArray, high: NDArray) -> NDArray:
    a, b = low.T
    d, e = high.T
    return np.column_stack([a, b, e, a, d, e]).reshape(-1, 3)


def _hexahedra(low: NDArray, high: NDArray) -> NDArray:
    return np.column_stack([low, high])


def _quadrilaterals(low: NDArray, high: NDArray) -> NDArray:
    return np.column_stack([low, high[:, ::-1]])


def _add(gmsh_model: Any, dim: int, groups: dict[int, NDArray], kind: int) -> None:
    for tag, nodes in groups.items():
        entity = gmsh_model.addDiscreteEntity(dim)
        gmsh_model.mesh.addElementsByType(entity, kind, [], nodes.ravel() + 1)
        gmsh_model.addPhysicalGroup(dim, [entity], tag)
