"""Bodies that were meshed separately, as one mesh in which they share no nodes."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import la
from dolfinx.mesh import Mesh, MeshTags, create_mesh, meshtags
from numpy.typing import NDArray

from .. import compat
from ..domain.tags import NamedTags
from ..domain.topology import UNTAGGED, tags_of_cells
from .gmsh_model import TaggedMesh
from .partition import cell_partitioner


def apart(parts: Sequence[tuple[Mesh, MeshTags, MeshTags]]) -> TaggedMesh:
    """One mesh of several bodies that share no nodes, even where these coincide; collective.

    Args:
        parts: Mesh, cell tags and facet tags of every body, with cells of one type and degree, on
            the same communicator. Cell tags of different parts differ; facet tags may be the same.

    Returns:
        Mesh, cell tags and facet tags, these unchanged, and their names.

    Raises:
        ValueError: cells of different types or degrees, one cell tag in two parts, or one name for
            two tags.
    """
    meshes = [mesh for mesh, _, _ in parts]
    comm, dim = meshes[0].comm, meshes[0].topology.dim
    kinds = {(m.topology.cell_name(), compat.coordinate_element(m).degree) for m in meshes}
    if len(kinds) > 1:
        raise ValueError(
            f"apart: the parts have cells of several types and degrees, {sorted(kinds)}; a mesh "
            "has one: mesh the parts alike"
        )
    tags = [set().union(*comm.allgather(set(cells.values.tolist()))) for _, cells, _ in parts]
    for i, mine in enumerate(tags):
        if twice := mine.intersection(*[set().union(*tags[:i])]):
            raise ValueError(
                f"apart: cell tag {min(twice)} is in two parts; give every body tags of its own"
            )
    (name, degree), variant = kinds.pop(), compat.coordinate_element(meshes[0]).variant
    element = basix.ufl.element(
        "Lagrange",
        name,
        degree,
        lagrange_variant=basix.LagrangeVariant(variant),
        shape=(meshes[0].geometry.dim,),
    )
    x, cells = _owned_parts(comm, meshes)
    mesh = create_mesh(comm, cells, x=x, e=ufl.Mesh(element), partitioner=cell_partitioner())
    # Cells are renumbered and on other ranks, but the nodes of a cell are not renumbered.
    groups = np.concatenate([_tags_by_cell(*part) for part in parts])
    groups = _of_input(comm, groups, np.asarray(mesh.topology.original_cell_index))
    mesh.topology.create_entities(dim - 1)
    mesh.topology.create_connectivity(dim, dim - 1)
    mesh.topology.create_connectivity(dim - 1, dim)
    facets = mesh.topology.connectivity(dim, dim - 1).array
    made = []
    for i, (number, entities, values) in enumerate(
        ((dim, np.arange(len(groups)), groups[:, 0]), (dim - 1, facets, groups[:, 1:].ravel())), 1
    ):
        tagged = np.flatnonzero(values != UNTAGGED)
        indices, first = np.unique(entities[tagged], return_index=True)
        found = meshtags(mesh, number, indices.astype(np.int32), values[tagged[first]])
        made.append(NamedTags(found, _names([part[i] for part in parts])))
    return TaggedMesh(mesh, *made)


def _owned_parts(comm: MPI.Comm, meshes: Sequence[Mesh]) -> tuple[NDArray, NDArray]:
    """The nodes that this rank owns (n, d), and its cells by the numbers of their nodes, those of
    rank 0 first (cells, nodes of a cell); collective."""
    maps = [mesh.geometry.index_map() for mesh in meshes]
    # By part and rank: number of nodes, first of them in the part, first of them here.
    counts = np.array(comm.allgather([nodes.size_local for nodes in maps])).T
    ends = np.cumsum(counts, axis=1)
    first = (np.cumsum(counts.T) - counts.T.ravel()).reshape(counts.T.shape).T
    cells = []
    for mesh, nodes, end, begin, count in zip(meshes, maps, ends, first, counts, strict=True):
        owned = mesh.topology.index_map(mesh.topology.dim).size_local
        here = compat.geometry_dofmap(mesh)[:owned]
        numbers = nodes.local_to_global(here.ravel().astype(np.int32)).reshape(here.shape)
        rank = np.searchsorted(end, numbers, side="right")
        cells.append(numbers + (begin - end + count)[rank])
    own = [mesh.geometry.x[: nodes.size_local] for mesh, nodes in zip(meshes, maps, strict=True)]
    x = np.concatenate(own)[:, : meshes[0].geometry.dim]
    return x, np.concatenate(cells).astype(np.int64)


def _tags_by_cell(mesh: Mesh, cells: MeshTags, facets: MeshTags) -> NDArray[np.int32]:
    """Tags of every owned cell and of its facets, UNTAGGED where there is none (cells, 1 + facets
    of a cell)."""
    dim = mesh.topology.dim
    owned = mesh.topology.index_map(dim).size_local
    mesh.topology.create_entities(dim - 1)
    mesh.topology.create_connectivity(dim, dim - 1)
    of_facet = la.vector(mesh.topology.index_map(dim - 1), dtype=np.int32)
    of_facet.array[:] = UNTAGGED
    of_facet.array[facets.indices] = facets.values
    of_facet.scatter_forward()
    count = len(basix.topology(mesh.basix_cell())[dim - 1])
    rows = mesh.topology.connectivity(dim, dim - 1).array.reshape(-1, count)[:owned]
    return np.column_stack([tags_of_cells(mesh, cells)[:owned], of_facet.array[rows]])


def _of_input(
    comm: MPI.Comm, rows: NDArray[np.int32], numbers: NDArray[np.int64]
) -> NDArray[np.int32]:
    """The rows (n, k) of all ranks with these numbers; collective."""
    ends = np.cumsum(comm.allgather(len(rows)))
    first = int(ends[comm.rank]) - len(rows)
    foreign = (numbers < first) | (numbers >= first + len(rows))
    ghosts = np.unique(numbers[foreign])
    owners = np.searchsorted(ends, ghosts, side="right").astype(np.int32)
    imap = compat.index_map(comm, len(rows), ghosts, owners)
    values = la.vector(imap, rows.shape[1], dtype=np.int32)
    values.array[: rows.size] = rows.ravel()
    values.scatter_forward()
    local = np.where(foreign, len(rows) + np.searchsorted(ghosts, numbers), numbers - first)
    return values.array.reshape(-1, rows.shape[1])[local]


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
