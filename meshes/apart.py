"""Bodies that were meshed separately, as one mesh in which they share no nodes."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import la
from dolfinx.mesh import Mesh, MeshTags, create_mesh, meshtags
from numpy.typing import NDArray

from .. import compat
from ..base.parallel import index_map_of
from ..domain.tags import NamedTags
from ..domain.topology import UNTAGGED, tags_of_cells
from .gmsh_model import TaggedMesh
from .partition import cell_partitioner


def apart(parts: Sequence[tuple[Mesh, MeshTags, MeshTags | None]]) -> TaggedMesh:
    """One mesh of several bodies that share no nodes, even where these coincide; collective.

    Args:
        parts: Mesh, cell tags and facet tags, or None, of every body, with cells of one type and
            degree, on the same communicator. Cell tags of different parts differ; facet tags may
            be the same.

    Returns:
        Mesh, cell tags and facet tags, these unchanged, and their names.

    Raises:
        ValueError: cells of different types or degrees, one cell tag in two parts, or one name for
            two tags.
    """
    meshes = [mesh for mesh, _, _ in parts]
    comm = meshes[0].comm
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
                f"apart: cell tag {min(twice)} is in two parts; give every body tags of its own, "
                "in gmsh by addPhysicalGroup(dim, entities, tag=2, name=...)"
            )
    names = [names_of([part[i] for part in parts]) for i in (1, 2)]
    return distributed(comm, *cells_in_order(comm, parts), meshes[0], names)


def distributed(
    comm: MPI.Comm,
    x: NDArray[np.float64],
    rows: NDArray[np.int64],
    like: Mesh,
    names: Sequence[dict[str, int]],
) -> TaggedMesh:
    """A mesh of cells that any ranks have, with their tags; collective."""
    dim, of_cell = like.topology.dim, compat.coordinate_element(like)
    element = basix.ufl.element(
        "Lagrange",
        like.topology.cell_name(),
        of_cell.degree,
        lagrange_variant=basix.LagrangeVariant(of_cell.variant),
        shape=(like.geometry.dim,),
    )
    size = compat.geometry_dofmap(like).shape[1]
    cells, groups = rows[:, :size], rows[:, size:].astype(np.int32)
    mesh = create_mesh(comm, cells, x=x, e=ufl.Mesh(element), partitioner=cell_partitioner())
    # Cells are renumbered and on other ranks, but the nodes of a cell keep their order.
    groups = _rows_of(comm, groups, np.asarray(mesh.topology.original_cell_index))
    mesh.topology.create_entities(dim - 1)
    mesh.topology.create_connectivity(dim, dim - 1)
    mesh.topology.create_connectivity(dim - 1, dim)
    facets = mesh.topology.connectivity(dim, dim - 1).array
    made = []
    for called, (number, entities, values) in zip(
        names,
        ((dim, np.arange(len(groups)), groups[:, 0]), (dim - 1, facets, groups[:, 1:].ravel())),
        strict=True,
    ):
        tagged = np.flatnonzero(values != UNTAGGED)
        indices, first = np.unique(entities[tagged], return_index=True)
        found = meshtags(mesh, number, indices.astype(np.int32), values[tagged[first]])
        made.append(NamedTags(found, called))
    return TaggedMesh(mesh, *made)


def cells_in_order(
    comm: MPI.Comm, parts: Sequence[tuple[Mesh, MeshTags, MeshTags | None]]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Nodes of all parts that this rank owns (n, d), and a share of their cells; collective.

    The cells are in the order of the input of the parts, one part after the other, which no
    partition changes. A row has the numbers of the nodes of a cell, those of rank 0 first, and its
    tags as in :func:`_tags_by_cell`.
    """
    nodes = [mesh.geometry.index_map() for mesh, _, _ in parts]
    # Numbers of nodes by part and rank, and how far those of a rank are renumbered.
    counts = np.array(comm.allgather([one.size_local for one in nodes])).T
    ends = np.cumsum(counts, axis=1)
    shifts = (np.cumsum(counts.T).reshape(counts.T.shape).T - counts) - (ends - counts)
    rows, numbers, before = [], [], 0
    for part, one, end, shift in zip(parts, nodes, ends, shifts, strict=True):
        mesh = part[0]
        cells = mesh.topology.index_map(mesh.topology.dim)
        here = compat.geometry_dofmap(mesh)[: cells.size_local]
        of_cells = one.local_to_global(here.ravel().astype(np.int32)).reshape(here.shape)
        of_cells = of_cells + shift[np.searchsorted(end, of_cells, side="right")]
        rows.append(np.column_stack([of_cells, _tags_by_cell(*part)]))
        numbers.append(before + compat.input_numbers(mesh))
        before += cells.size_global
    table = np.concatenate(rows)
    ordered = PETSc.Vec().createMPI(before * table.shape[1], bsize=table.shape[1], comm=comm)
    places = np.concatenate(numbers).astype(PETSc.IntType)
    ordered.setValuesBlocked(places, table.astype(PETSc.ScalarType))
    ordered.assemble()
    table = ordered.array.reshape(-1, table.shape[1]).astype(np.int64)
    ordered.destroy()
    own = [mesh.geometry.x[: one.size_local] for (mesh, *_), one in zip(parts, nodes, strict=True)]
    return np.concatenate(own)[:, : parts[0][0].geometry.dim], table


def _tags_by_cell(mesh: Mesh, cells: MeshTags, facets: MeshTags | None) -> NDArray[np.int32]:
    """Tags of every owned cell and of its facets, UNTAGGED where there is none (cells, 1 + facets
    of a cell)."""
    dim = mesh.topology.dim
    owned = mesh.topology.index_map(dim).size_local
    mesh.topology.create_entities(dim - 1)
    mesh.topology.create_connectivity(dim, dim - 1)
    of_facet = la.vector(mesh.topology.index_map(dim - 1), dtype=np.int32)
    of_facet.array[:] = UNTAGGED
    if facets is not None:
        of_facet.array[facets.indices] = facets.values
    of_facet.scatter_forward()
    count = len(basix.topology(mesh.basix_cell())[dim - 1])
    rows = mesh.topology.connectivity(dim, dim - 1).array.reshape(-1, count)[:owned]
    return np.column_stack([tags_of_cells(mesh, cells)[:owned], of_facet.array[rows]])


def _rows_of(
    comm: MPI.Comm, rows: NDArray[np.int32], numbers: NDArray[np.int64]
) -> NDArray[np.int32]:
    """The rows (n, k) of all ranks with these numbers; collective."""
    imap, local = index_map_of(comm, len(rows), numbers)
    values = la.vector(imap, rows.shape[1], dtype=np.int32)
    values.array[: rows.size] = rows.ravel()
    values.scatter_forward()
    return values.array.reshape(-1, rows.shape[1])[local]


def names_of(parts: Sequence[NamedTags | MeshTags | None]) -> dict[str, int]:
    names: dict[str, int] = {}
    for part in parts:
        for name, tag in getattr(part, "names", {}).items():
            if names.setdefault(name, tag) != tag:
                raise ValueError(
                    f"apart: {name!r} is tag {names[name]} in one part and {tag} in another; "
                    "rename one of the groups"
                )
    return names
