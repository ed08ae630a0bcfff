"""A mesh as arrays, between a file and a gmsh model: one group per cell, coincident nodes
merged."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import gmsh
import numpy as np
import scipy
from numpy.typing import NDArray

from vmdg.base.graph import components

from .gmsh_model import COINCIDENT

#: Largest plausible average number of coincident nodes.
MANY = 20

#: Opposite faces of cells that may be flat, by gmsh type, and the type of a face.
_FLAT: dict[int, tuple[list[tuple[int, ...]], int]] = {
    3: ([(0, 1), (1, 2)], 1),
    5: ([(0, 1, 2, 3), (0, 1, 5, 4), (1, 2, 6, 5)], 3),
    6: ([(0, 1, 2)], 2),
}


#: Corners of the edges of incomplete cells of degree 2 by gmsh type, and of their faces (the last
#: one the cell) in the order of the nodes that complete them.
EDGES_OF = {
    16: ((0, 1), (1, 2), (2, 3), (0, 3)),
    17: (
        ((0, 1), (0, 3), (0, 4), (1, 2), (1, 5), (2, 3))
        + ((2, 6), (3, 7), (4, 5), (4, 7), (5, 6), (6, 7))
    ),
}
_FACES_OF = {
    16: ((0, 1, 2, 3),),
    17: (
        ((0, 3, 2, 1), (0, 1, 5, 4), (0, 4, 7, 3), (1, 2, 6, 5), (2, 3, 7, 6), (4, 5, 6, 7))
        + (tuple(range(8)),)
    ),
}
_COMPLETE = {16: 10, 17: 12}
#: Their type with straight edges and its number of nodes; also of edges.
_STRAIGHT = {8: (1, 2), 16: (3, 4), 17: (5, 8)}

#: Nodes 8 to 19 of a hexahedron in gmsh, by their place in VTK and Abaqus.
HEXAHEDRON_20 = [*range(8), 8, 11, 16, 9, 17, 10, 18, 19, 12, 15, 13, 14]


class Block(NamedTuple):
    """Cells or facets of one type in one group; those of several groups are in several blocks."""

    dim: int
    kind: int
    nodes: NDArray[np.int64]  # Indices of their points, in gmsh order (n, nodes per cell)
    group: int
    entity: int  # Number of the geometric entity they belong to, or of the block


@dataclass(frozen=True)
class MeshArrays:
    """A mesh as arrays."""

    points: NDArray[np.float64]  # (n, 3)
    blocks: list[Block]
    names: Mapping[int, Mapping[str, int]]
    shift: int = 0  # Offset of cell tags relative to the file: tags of gmsh start at 1
    # Indices of the points in sets of nodes, by name
    nodes: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)

    @cached_property
    def dim(self) -> int:
        return max(block.dim for block in self.blocks)

    def of(self, dim: int) -> list[Block]:
        return [block for block in self.blocks if block.dim == dim]

    def tag(self, dim: int, group: int) -> int:
        return group - self.shift * (dim == self.dim)

    def called(self, dim: int, group: int) -> str:
        name = self.name.get((dim, group))
        return str(self.tag(dim, group)) if name is None else repr(name)

    @cached_property
    def name(self) -> dict[tuple[int, int], str]:
        return {
            (dim, tag): name for dim, names in self.names.items() for name, tag in names.items()
        }


def from_gmsh(gmsh_model: Any) -> MeshArrays:
    tags, points, _ = gmsh_model.mesh.getNodes()
    order = np.argsort(tags)
    ascending = tags[order]
    blocks = []
    for dim, entity in gmsh_model.getEntities():
        # A negative tag reverses the orientation of the entity, which does not matter here.
        groups = [abs(int(tag)) for tag in gmsh_model.getPhysicalGroupsForEntity(dim, entity)]
        kinds, _, nodes = gmsh_model.mesh.getElements(dim, entity)
        for kind, flattened in zip(kinds, nodes, strict=True):
            count = gmsh_model.mesh.getElementProperties(kind)[3]
            places_of = np.minimum(np.searchsorted(ascending, flattened), len(tags) - 1)
            if (ascending[places_of] != flattened).any():
                raise ValueError("its cells have nodes that do not exist; is it complete?")
            cells = order[places_of].reshape(-1, count)
            blocks += [Block(dim, int(kind), cells, group, entity) for group in groups or [0]]
    names: dict[int, dict[str, int]] = {}
    for dim, tag in gmsh_model.getPhysicalGroups():
        names.setdefault(dim, {})[gmsh_model.getPhysicalName(dim, tag)] = tag
    return only_cells_and_facets(MeshArrays(points.reshape(-1, 3), blocks, names))


def only_cells_and_facets(mesh: MeshArrays) -> MeshArrays:
    """The mesh without points and, in 3D, edges."""
    dim = max((block.dim for block in mesh.blocks), default=0)
    if dim < 2:
        raise ValueError(
            f"it has {'edges only' if dim else 'no cells'}; cells and tagged facets must be in one "
            "file"
        )
    blocks = [block for block in mesh.blocks if block.dim >= dim - 1]
    names = {d: {n: t for n, t in mesh.names.get(d, {}).items() if n} for d in (dim, dim - 1)}
    return replace(mesh, blocks=blocks, names=names)


def into_gmsh(gmsh_model: Any, mesh: MeshArrays) -> dict[str, NDArray[np.int64]]:
    """Replace the gmsh model by a mesh with one group per cell or facet, without unused nodes and
    facets of no group; return the tags of the nodes of sets, as far as they are used."""
    gmsh.clear()
    gmsh_model.add("mesh")
    blocks = [block for block in mesh.blocks if block.dim == mesh.dim or block.group]
    used, renumbered = np.unique(
        np.concatenate([block.nodes.ravel() for block in blocks]), return_inverse=True
    )
    begins = np.cumsum([block.nodes.size for block in blocks])[:-1]
    groups: dict[tuple[int, int], list[int]] = {}
    nodes = np.split(renumbered.ravel() + 1, begins)
    for number, (block, of_block) in enumerate(zip(blocks, nodes, strict=True), 1):
        gmsh_model.addDiscreteEntity(block.dim, number)
        if number == 1:
            tags = np.arange(1, len(used) + 1)
            gmsh_model.mesh.addNodes(block.dim, 1, tags, mesh.points[used].ravel())
        gmsh_model.mesh.addElementsByType(number, block.kind, [], of_block)
        groups.setdefault((block.dim, block.group), []).append(number)
        if block.group:
            name = f"group {mesh.called(block.dim, block.group)}"
            gmsh_model.setEntityName(block.dim, number, name)
    for (dim, group), entities in groups.items():
        if group:
            gmsh_model.addPhysicalGroup(dim, entities, group, mesh.name.get((dim, group), ""))
    tags_of = {name: np.flatnonzero(np.isin(used, one)) + 1 for name, one in mesh.nodes.items()}
    return {name: one for name, one in tags_of.items() if len(one)}


def size(points: NDArray[np.float64]) -> float:
    """Longest side of the bounding box of points (n, 3)."""
    return float(np.ptp(points, axis=0).max(initial=0.0))


def places(mesh: MeshArrays, distance: float | None = None) -> NDArray[np.int64]:
    """For every point a representative of the points that coincide with it (n,), those closer than
    ``distance`` [mm]; None for rounding only."""
    used = np.unique(np.concatenate([block.nodes.ravel() for block in mesh.blocks]))
    points = mesh.points[used]
    tree = scipy.spatial.cKDTree(points)
    reach = COINCIDENT * size(points) if distance is None else distance
    if tree.count_neighbors(tree, reach) > MANY * len(points):
        raise ValueError(
            f"its nodes have more than {MANY} others within {reach:g}; is merge= in its units?"
        )
    pairs = tree.query_pairs(reach, output_type="ndarray")
    component = components(*pairs.T, len(used))
    first = np.unique(component, return_index=True)[1]
    result = np.arange(len(mesh.points))
    result[used] = used[first[component]]
    return result


def _with_repeated_nodes(nodes: NDArray[np.int64]) -> NDArray[np.bool_]:
    in_order = np.sort(nodes, axis=1)
    return (in_order[:, 1:] == in_order[:, :-1]).any(axis=1)


def count_flat(mesh: MeshArrays, place: NDArray[np.int64]) -> int:
    """Number of cells with coincident nodes, such as zero-thickness cohesive elements."""
    return sum(int(_with_repeated_nodes(place[block.nodes]).sum()) for block in mesh.of(mesh.dim))


def merged(mesh: MeshArrays, place: NDArray[np.int64]) -> MeshArrays:
    """Merge coincident nodes; flat cells of degree 1 become facets of their group, others are
    dropped."""
    dim, blocks, names = mesh.dim, [], {d: dict(names) for d, names in mesh.names.items()}
    new = max((block.group for block in mesh.of(dim - 1)), default=0)
    for block in mesh.blocks:
        nodes = place[block.nodes]
        flat = _with_repeated_nodes(nodes)
        if block.dim == dim:
            facets, kind = _collapsed(block.kind, nodes[flat])
            if len(facets):
                group = block.group
                if group:
                    name = mesh.name.get((dim, group), str(mesh.tag(dim, group)))
                    group = names[dim - 1].setdefault(name, new := new + 1)
                # Facets of the file precede those of flat cells.
                blocks.append(Block(dim - 1, kind, facets, group, -block.entity))
        blocks.append(block._replace(nodes=nodes[~flat]))
    left = {(block.dim, block.group) for block in blocks if len(block.nodes)}
    names = {d: {n: t for n, t in of.items() if (d, t) in left} for d, of in names.items()}
    sets = {name: place[nodes] for name, nodes in mesh.nodes.items()}
    blocks = [block for block in blocks if len(block.nodes)]
    return replace(mesh, blocks=blocks, names=names, nodes=sets)


def completed(mesh: MeshArrays) -> tuple[MeshArrays, str | None]:
    """Cells of 20 nodes (in 2D 8) as cells of 8 (4) if all edges are straight, otherwise of 27 (9);
    and words that say so."""
    old = [block for block in mesh.blocks if block.kind in EDGES_OF]
    if all(block.dim < mesh.dim for block in old):
        return mesh, None
    reach = COINCIDENT * size(mesh.points)
    curved = any(_off_middles(mesh.points[block.nodes], block.kind) > reach for block in old)
    count = ((8, 4, 9), (20, 8, 27))[mesh.dim - 2]
    words = (
        f"its cells of {count[0]} nodes become cells of {count[1 + curved]} nodes with the same "
        "shape; Problem(degree=2) makes the displacement quadratic"
    )
    if curved:
        return _with_middles(mesh), words
    blocks = []
    for block in mesh.blocks:
        kind, corners = _STRAIGHT.get(block.kind, (block.kind, None))
        blocks.append(block._replace(kind=kind, nodes=block.nodes[:, :corners]))
    return replace(mesh, blocks=blocks), words


def _off_middles(x: NDArray[np.float64], kind: int) -> float:
    """Largest distance of the nodes on edges from the middles, of cells x (n, nodes, 3)."""
    edges = np.array(EDGES_OF[kind])
    return float(np.abs(x[:, -len(edges) :] - x[:, edges].mean(axis=2)).max(initial=0.0))


def _with_middles(mesh: MeshArrays) -> MeshArrays:
    """Complete cells: nodes on faces and in the middle, where the interpolation by the nodes of the
    incomplete cell has them: -1/4 of the corners and 1/2 (on a face) or 1/4 of the nodes on
    edges."""
    keys, places_of = [], []
    for block in mesh.blocks:
        edges = np.array(EDGES_OF.get(block.kind, []))
        for face in _FACES_OF.get(block.kind, ()):
            on = np.flatnonzero(np.isin(edges, face).all(axis=1)) - len(edges)
            at_corners, at_edges = (mesh.points[block.nodes[:, i]] for i in (list(face), on))
            share = 1 / 2 if len(face) == 4 else 1 / 4
            places_of.append(share * at_edges.sum(axis=1) - at_corners.sum(axis=1) / 4)
            keys.append(np.full((len(block.nodes), 8), -1))
            keys[-1][:, : len(face)] = np.sort(block.nodes[:, face], axis=1)
    ends = np.cumsum([len(key) for key in keys])[:-1]
    _, first, which = np.unique(np.vstack(keys), axis=0, return_index=True, return_inverse=True)
    new = iter(np.split(len(mesh.points) + which.ravel(), ends))
    blocks = []
    for block in mesh.blocks:
        nodes = np.column_stack([block.nodes, *(next(new) for _ in _FACES_OF.get(block.kind, ()))])
        blocks.append(block._replace(kind=_COMPLETE.get(block.kind, block.kind), nodes=nodes))
    return replace(
        mesh, points=np.vstack([mesh.points, np.vstack(places_of)[first]]), blocks=blocks
    )


def _collapsed(kind: int, cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """Flat cells as facets, and their type; none for cells of higher degree."""
    name, _, _, _, _, corners = gmsh.model.mesh.getElementProperties(kind)
    first = np.sort(cells[:, :corners], axis=1)
    different = 1 + (first[:, 1:] != first[:, :-1]).sum(axis=1)
    can_be_flat = not name.startswith(("Triangle", "Tetrahedron", "Pyramid"))
    if len(cells) and not (can_be_flat and (2 * different == corners).all()):
        raise ValueError(
            f"cells of type {name} have two coincident nodes and are not flat; collapsed cells are "
            "not supported: write them as their actual type (a collapsed quadrilateral is a "
            "triangle), or give a shorter distance for merge"
        )
    faces, facet_kind = _FLAT.get(kind, ([], 0))
    facets = np.zeros((len(cells) if faces else 0, corners // 2), dtype=np.int64)
    for face in reversed(faces):
        whole = ~_with_repeated_nodes(cells[:, face])
        facets[whole] = cells[whole][:, face]
    return facets, facet_kind


def one_group_each(mesh: MeshArrays, groups: Collection[str | int] | None) -> MeshArrays:
    """Every cell and facet once, in a single group, of all or of those with these names or tags."""
    if groups is not None:
        mesh = _only(mesh, groups)
    blocks = []
    for dim in (mesh.dim, mesh.dim - 1):
        by_kind: dict[int, list[Block]] = {}
        for block in mesh.of(dim):
            by_kind.setdefault(block.kind, []).append(block)
        for same in by_kind.values():
            blocks += _each_once(mesh, same)
    return replace(mesh, blocks=blocks)


def _only(mesh: MeshArrays, groups: Collection[str | int]) -> MeshArrays:
    there = sorted({(block.dim, block.group) for block in mesh.blocks if block.group})
    called = {key: {mesh.called(*key), str(mesh.tag(*key))} for key in there}
    wanted = {group: repr(group) for group in groups}
    for group, word in wanted.items():
        if not any(word in words for words in called.values()):
            known = ", ".join(mesh.called(*key) for key in there)
            raise ValueError(f"groups: there is no group {group!r}; it has {known or 'none'}")
    keep = {key for key, words in called.items() if words & set(wanted.values())}
    blocks = [
        block if (block.dim, block.group) in keep else block._replace(group=0)
        for block in mesh.blocks
    ]
    names = {d: {n: t for n, t in of.items() if (d, t) in keep} for d, of in mesh.names.items()}
    return replace(mesh, blocks=blocks, names=names)


def _each_once(mesh: MeshArrays, blocks: list[Block]) -> list[Block]:
    nodes = np.concatenate([block.nodes for block in blocks])
    sizes = [len(block.nodes) for block in blocks]
    group = np.repeat([block.group for block in blocks], sizes)
    entity = np.repeat([block.entity for block in blocks], sizes)
    # Entities in a group come first, then facets of the file.
    order = np.lexsort([entity < 0, group == 0])
    nodes, group, entity = nodes[order], group[order], entity[order]
    in_order = np.sort(nodes, axis=1)
    _, first, which = np.unique(in_order, axis=0, return_index=True, return_inverse=True)
    which = which.ravel()
    other = (group != group[first][which]) & (group != 0) & (entity >= 0)
    if other.any():
        one, two = group[first][which][other][0], group[other][0]
        dim = blocks[0].dim
        what = "cells" if dim == mesh.dim else "facets"
        alike = int((other & (group == two) & (group[first][which] == one)).sum())
        raise ValueError(
            f"{alike} {what} are both in {mesh.called(dim, int(one))} and in "
            f"{mesh.called(dim, int(two))}, and each has one tag; name the groups to use: "
            "groups=[...]"
        )
    keep = np.sort(first)
    nodes, group, entity = nodes[keep], group[keep], entity[keep]
    pairs, which = np.unique(np.column_stack([group, entity]), axis=0, return_inverse=True)
    return [
        blocks[0]._replace(nodes=nodes[rows], group=int(g), entity=abs(int(e)))
        for (g, e), (_, rows) in zip(pairs, rows_of(which.ravel()), strict=True)
    ]


def rows_of(values: NDArray[np.int64]) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Every value and the rows (k,) that have it, of values (n,)."""
    order = np.argsort(values, kind="stable")
    different, begins = np.unique(values[order], return_index=True)
    yield from zip(different.tolist(), np.split(order, begins[1:]), strict=True)


def entities_as_groups(mesh: MeshArrays) -> MeshArrays:
    """Make every geometric entity without a group a group; its tag is its number if unused.

    Their names are "volume 1", "surface 3", "curve 2".
    """
    blocks, names = [], {dim: dict(names) for dim, names in mesh.names.items()}
    taken = {dim: {block.group for block in mesh.of(dim)} for dim in (mesh.dim, mesh.dim - 1)}
    made: dict[tuple[int, int], int] = {}
    for block in mesh.blocks:
        key = block.dim, block.entity
        if not block.group and key not in made:
            used = taken[block.dim]
            made[key] = block.entity if block.entity not in used else max(used) + 1
            used.add(made[key])
            word = ("point", "curve", "surface", "volume")[block.dim]
            names[block.dim][f"{word} {block.entity}"] = made[key]
        blocks.append(block if block.group else block._replace(group=made[key]))
    return replace(mesh, blocks=blocks, names=names)
