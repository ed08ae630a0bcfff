"""A gmsh model on rank 0 and its distribution with the facet ghosts that interfaces require."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any, NamedTuple

from mpi4py import MPI

import gmsh
import numpy as np
from dolfinx.mesh import Mesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from vmdg import compat
from vmdg.base.parallel import raise_together
from vmdg.base.tables import rounded
from vmdg.domain.tags import NamedTags
from vmdg.meshes.partition import cell_partitioner, slabs
from vmdg.meshes.plane import Plane, turn

#: Nodes closer than this, relative to the longest side of the mesh, coincide.
COINCIDENT = 1e-7

#: Supported cells, by their names in gmsh.
CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")


class NodeSet:
    """Where the nodes of a set are, for ``problem.dirichlet_points(tagged.nodes["tip"], 0.0)``."""

    def __init__(self, points: NDArray[np.float64]):
        self.points = points

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether points x (3, n) are nodes of the set, to rounding (n,)."""
        reach = COINCIDENT * float(np.ptp(np.vstack([self.points, x.T]), axis=0).max())
        return cKDTree(self.points).query(x.T, distance_upper_bound=reach)[0] < np.inf


class _Tagged(NamedTuple):
    mesh: Mesh
    cell_tags: NamedTags
    facet_tags: NamedTags


class TaggedMesh(_Tagged):
    """A mesh with the tags of its physical groups, which may also be found by name.

    Attributes:
        mesh: The mesh, with facet ghosts.
        cell_tags: Tags of the cells: ``cell_tags.find("fibre")``.
        facet_tags: Tags of facets: ``facet_tags.find("left")``.
        nodes: Sets of nodes by name, of files that have such; not part of the tuple.
    """

    nodes: Mapping[str, NodeSet] = MappingProxyType({})


@contextmanager
def model(name: str) -> Iterator[Any]:
    """A fresh, silent gmsh model; gmsh is closed at the end.

    Args:
        name: Name of the model.
    """
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add(name)
        yield gmsh.model
    finally:
        gmsh.finalize()


def one_size(size: float) -> None:
    for bound in ("Min", "Max"):
        gmsh.option.setNumber(f"Mesh.MeshSize{bound}", size)


def generate_tetrahedra(gmsh_model: Any) -> None:
    """Mesh with HXT, which gives better shapes."""
    gmsh.option.setNumber("Mesh.Algorithm3D", 10)
    gmsh_model.mesh.generate(3)


def name_groups(gmsh_model: Any, dim: int, names: Mapping[str, int]) -> None:
    there = {tag for _, tag in gmsh_model.getPhysicalGroups(dim)}
    for name, tag in names.items():
        if tag in there:
            gmsh_model.setPhysicalName(dim, tag, name)


def distribute(
    gmsh_model: Any,
    comm: MPI.Comm,
    gdim: int,
    slabs_along: int | None = None,
    unit: float = 1.0,
    plane: Plane | None = None,
) -> TaggedMesh:
    """Distribute the model of rank 0 over ``comm``, ghosts by shared facets; collective.

    Args:
        gmsh_model: Meshed, with a physical group for every body. Group names are kept.
        comm: Communicator.
        gdim: Geometric dimension.
        slabs_along: Cut across this axis only (0, 1, 2), see :func:`vmdg.meshes.partition.slabs`.
        unit: Unit of the lengths of the model [mm]. gmsh has absolute tolerances and minimum
            lengths; the unit makes the mesh of a model in m equal to that in mm.
        plane: Where a 2D mesh lies, if not in a plane z = const: the spatial axes that become its x
            and y, "xz" or, for a tilted plane, two vectors ((1, 0, 0), (0, 0.6, 0.8)). The nodes of
            the model are rotated into z = 0.

    Raises:
        ValueError: cells without a group, cells or facets in two groups, cells of
            several types or of an unsupported one, nodes in another order than that of gmsh, facets
            without a cell, a 2D mesh that does not lie in its plane, or ``plane`` is not a plane.
    """
    message, names = None, None
    if comm.rank == 0:
        message = _wrong_groups(gmsh_model, gdim, plane)
        names = [_names(gmsh_model, dim) for dim in (gdim, gdim - 1)]
    raise_together(comm, message)
    graph_partitioner = None
    if slabs_along is not None:
        midpoints = compat.gmsh_midpoints(gmsh_model, gdim) if comm.rank == 0 else np.zeros((0, 3))
        graph_partitioner = slabs(midpoints[:, slabs_along])
    partitioner = cell_partitioner(graph_partitioner)
    mesh, *tags = compat.gmsh_model_to_mesh(gmsh_model, comm, 0, gdim, partitioner)
    mesh.geometry.x[:] *= unit
    return TaggedMesh(mesh, *map(NamedTags, tags, comm.bcast(names)))


def _names(gmsh_model: Any, dim: int) -> dict[str, int]:
    """Tag by name of the physical groups that have a name."""
    groups = [tag for _, tag in gmsh_model.getPhysicalGroups(dim)]
    named = ((gmsh_model.getPhysicalName(dim, tag), tag) for tag in groups)
    return {name: tag for name, tag in named if name}


def _wrong_groups(gmsh_model: Any, gdim: int, plane: Plane | None) -> str | None:
    """Error in the physical groups, or in their cells, or None."""
    for dim in (gdim, gdim - 1):
        for _, entity in gmsh_model.getEntities(dim):
            groups = gmsh_model.getPhysicalGroupsForEntity(dim, entity)
            place = _place(gmsh_model, dim, entity)
            if len(groups) > 1:
                return (
                    f"{place} is in the physical groups {list(map(int, groups))}; a cell or facet "
                    "has one tag: assign it to one group"
                )
            if dim == gdim and not len(groups) and len(gmsh_model.mesh.getElements(dim, entity)[0]):
                return (
                    f"{place} is meshed but in no physical group, so its cells would be lost; "
                    "create a group for every body (addPhysicalGroup)"
                )
    try:
        turn(gmsh_model, gdim, plane)
    except ValueError as error:
        return str(error)
    return (
        _wrong_cells(gmsh_model, gdim)
        or _wrong_order(gmsh_model, gdim)
        or _facets_without_cells(gmsh_model, gdim)
    )


def _place(gmsh_model: Any, dim: int, entity: int) -> str:
    name = gmsh_model.getEntityName(dim, entity)
    kind = ("point", "curve", "surface", "volume")[dim]
    return f"{kind} {entity}{f' ({name})' if name else ''} of the gmsh model"


def _wrong_cells(gmsh_model: Any, gdim: int) -> str | None:
    """Error for cells of unsupported types, or of more than one type."""
    first = None
    for _, entity in gmsh_model.getEntities(gdim):
        place = _place(gmsh_model, gdim, entity)
        for kind in gmsh_model.mesh.getElements(gdim, entity)[0]:
            name, _, degree, nodes, *_ = gmsh_model.mesh.getElementProperties(kind)
            if name.split()[0].lower() not in CELLS:
                return (
                    f"{place} has cells of type {name}; the cells must be one of "
                    f"{', '.join(CELLS)}: extrude without recombine, or leave surfaces unrecombined"
                )
            complete = _nodes(name, degree)
            if nodes != complete:
                return (
                    f"{place} has cells of type {name} (serendipity), which vmdg does not support: "
                    f"mesh with those of {complete} nodes (Mesh.SecondOrderIncomplete 0 in gmsh), "
                    "with triangles or tetrahedra, or with cells of degree 1"
                )
            first = first or (kind, name, place)
            if kind != first[0]:
                return (
                    f"{place} has cells of type {name}, {first[2]} of type {first[1]}; a mesh has "
                    "one type: recombine all bodies (mesh.setRecombine) or none"
                )
    return None


def _nodes(name: str, degree: int) -> int:
    if name.startswith("Triangle"):
        return (degree + 1) * (degree + 2) // 2
    if name.startswith("Tetrahedron"):
        return (degree + 1) * (degree + 2) * (degree + 3) // 6
    return (degree + 1) ** (2 if name.startswith("Quadrilateral") else 3)


def _wrong_order(gmsh_model: Any, gdim: int) -> str | None:
    """Error for cells of degree > 1 whose nodes on an edge or face differ from the neighbour's.

    DOLFINx numbers nodes by edges and faces and would write past the end of its arrays.
    """
    for kind in gmsh_model.mesh.getElementTypes(gdim):
        name, _, degree, *_, corners = gmsh_model.mesh.getElementProperties(kind)
        if degree == 1:
            continue
        # Number of corners, of nodes, the first node inside, and the nodes of all edges or faces.
        parts = [(2, degree + 1, 2, gmsh_model.mesh.getElementEdgeNodes(kind))]
        ends, face = (3, "Triangle") if corners == 4 else (4, "Quadrilateral")
        if gdim == 3 and ends * degree < _nodes(face, degree):
            nodes = gmsh_model.mesh.getElementFaceNodes(kind, ends)
            parts.append((ends, _nodes(face, degree), ends * degree, nodes))
        cells = gmsh_model.mesh.getElementsByType(kind)[1].reshape(-1, _nodes(name, degree))
        for ends, count, begin, nodes in parts:
            rows = np.asarray(nodes, dtype=np.int64).reshape(-1, count)
            outer, inner = np.sort(rows[:, :ends], axis=1), np.sort(rows[:, begin:], axis=1)
            _, first, which = np.unique(outer, axis=0, return_index=True, return_inverse=True)
            known, times = np.unique(inner[first], return_counts=True)
            wrong = inner != inner[first][which.ravel()]
            wrong |= np.isin(inner, known[times > 1]) | np.isin(inner, cells[:, :corners])
            if wrong.any():
                place = gmsh_model.mesh.getNode(rows[wrong.any(axis=1)][0, begin])[0]
                return (
                    f"cells of type {name} do not have their nodes in the order of gmsh: the node "
                    f"at {rounded(place)} lies between other corners in one cell than in its "
                    "neighbour; to reverse a cell reorder all of its nodes, not only its corners"
                )
    return None


def _facets_without_cells(gmsh_model: Any, gdim: int) -> str | None:
    """Error for a group of facets on no cell: their body is missing in the file."""
    cells = [gmsh_model.mesh.getElements(gdim, e)[2] for _, e in gmsh_model.getEntities(gdim)]
    known = np.concatenate([np.zeros(0, dtype=np.uint64), *(n for nodes in cells for n in nodes)])
    for _, entity in gmsh_model.getEntities(gdim - 1):
        if not len(gmsh_model.getPhysicalGroupsForEntity(gdim - 1, entity)):
            continue
        for nodes in gmsh_model.mesh.getElements(gdim - 1, entity)[2]:
            if not np.isin(nodes, known).all():
                place = _place(gmsh_model, gdim - 1, entity)
                return (
                    f"{place} is in a physical group, but the adjacent body has no cells here, "
                    "since gmsh writes grouped bodies only; create a group for every body "
                    "(addPhysicalGroup), or omit the facets"
                )
    return None
