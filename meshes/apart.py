"""Bodies that were meshed separately, as one mesh in which they share no nodes."""

from __future__ import annotations

from collections.abc import Sequence

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx.mesh import Mesh, MeshTags, create_mesh, meshtags
from numpy.typing import NDArray

from .. import compat
from ..domain.tags import NamedTags
from ..domain.topology import facet_cells, local_facets
from .gmsh_model import TaggedMesh


def apart(parts: Sequence[tuple[Mesh, MeshTags, MeshTags]]) -> TaggedMesh:
    """One mesh of several bodies that share no nodes, even where these coincide.

    Args:
        parts: Mesh, cell tags and facet tags of every body, with cells of one type and degree, on
            one rank. Cell tags of different parts differ; facet tags may be the same.

    Returns:
        Mesh, cell tags and facet tags, these unchanged, and their names.

    Raises:
        ValueError: cells of different types or degrees, one cell tag in two parts, one name for two
            tags, or several ranks.
    """
    meshes = [mesh for mesh, _, _ in parts]
    comm = meshes[0].comm
    if comm.size > 1:
        raise ValueError(f"apart: bodies are put together on one rank, not on {comm.size}")
    kinds = {(m.topology.cell_name(), compat.coordinate_element(m).degree) for m in meshes}
    if len(kinds) > 1:
        raise ValueError(
            f"apart: the parts have cells of several types and degrees, {sorted(kinds)}; a mesh "
            "has one: mesh the parts alike"
        )
    tags = [set(np.unique(cells.values).tolist()) for _, cells, _ in parts]
    for i, mine in enumerate(tags):
        if twice := mine.intersection(*[set().union(*tags[:i])]):
            raise ValueError(
                f"apart: cell tag {min(twice)} is in two parts; give every body tags of its own"
            )
    first = np.cumsum([0, *(len(mesh.geometry.x) for mesh in meshes)])
    x = np.concatenate([mesh.geometry.x[:, : mesh.geometry.dim] for mesh in meshes])
    cells = [
        compat.geometry_dofmap(mesh) + start for mesh, start in zip(meshes, first, strict=False)
    ]
    (name, degree), variant = kinds.pop(), compat.coordinate_element(meshes[0]).variant
    element = basix.ufl.element(
        "Lagrange",
        name,
        degree,
        lagrange_variant=basix.LagrangeVariant(variant),
        shape=(x.shape[1],),
    )
    numbers = np.concatenate(cells).astype(np.int64)
    mesh = create_mesh(comm, numbers, x=x, e=ufl.Mesh(element))
    # Cells are renumbered, but not the nodes of a cell.
    number = np.argsort(mesh.topology.original_cell_index).astype(np.int32)
    begin = np.cumsum([0, *map(len, cells)])
    tdim = mesh.topology.dim
    mesh.topology.create_entities(tdim - 1)
    mesh.topology.create_connectivity(tdim, tdim - 1)
    mesh.topology.create_connectivity(tdim - 1, tdim)
    facets_of = mesh.topology.connectivity(tdim, tdim - 1).array.reshape(len(number), -1)
    found: list[list[tuple[NDArray, NDArray]]] = [[], []]
    for (part, cell_tags, facet_tags), start in zip(parts, begin, strict=False):
        here = facet_cells(part)[facet_tags.indices, 0]
        local = local_facets(part, here, facet_tags.indices)
        found[0].append((number[start + cell_tags.indices], cell_tags.values))
        found[1].append((facets_of[number[start + here], local], facet_tags.values))
    made = []
    for i, (dim, groups) in enumerate(zip((tdim, tdim - 1), found, strict=True), 1):
        indices, values = (np.concatenate(arrays) for arrays in zip(*groups, strict=True))
        order = np.argsort(indices)
        tagged = meshtags(mesh, dim, indices[order], values[order])
        made.append(NamedTags(tagged, _names([part[i] for part in parts])))
    return TaggedMesh(mesh, *made)


def _names(parts: Sequence[NamedTags | MeshTags]) -> dict[str, int]:
    """Tag by name of the groups of all parts.

    Raises:
        ValueError: two parts have one name for different tags.
    """
    names: dict[str, int] = {}
    for part in parts:
        for name, tag in getattr(part, "names", {}).items():
            if names.setdefault(name, tag) != tag:
                raise ValueError(
                    f"apart: {name!r} is tag {names[name]} in one part and {tag} in another; "
                    "rename one of the groups"
                )
    return names
