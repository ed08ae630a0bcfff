"""Every difference between the supported versions of DOLFINx (0.9 to 0.11) lives here."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import dolfinx
import numpy as np
import ufl
from dolfinx import cpp, fem, geometry
from dolfinx.common import IndexMap
from dolfinx.mesh import (
    GhostMode,
    Mesh,
    MeshTags,
    create_cell_partitioner,
    create_submesh,
    meshtags,
)
from numpy.typing import NDArray

_NEW = tuple(int(part) for part in dolfinx.__version__.split(".")[:2]) >= (0, 10)
if _NEW:
    from ufl.corealg.dag_traverser import DAGTraverser
# Newer index maps take a message tag.
_TAG = [0] if "tag: int" in IndexMap.__init__.__doc__ else []

#: SNES convergence reasons by PETSc's names, as of 3.22; one was renamed later.
_RENAMED = {"DIVERGED_FUNCTION_NANORINF": "DIVERGED_FNORM_NAN"}
SNES_REASONS = {
    _RENAMED.get(name, name): value
    for name, value in vars(PETSc.SNES.ConvergedReason).items()
    if isinstance(value, int) and name.isupper()
}


def _show_warnings() -> None:
    """Return warnings to Python: FFCx 0.9 redirects them to a log, which is invisible unless
    logging is configured."""
    loggers = logging.getLogger("py.warnings"), logging.getLogger()
    handlers = [handler for logger in loggers for handler in logger.handlers]
    if all(isinstance(handler, logging.NullHandler) for handler in handlers):
        logging.captureWarnings(False)


_show_warnings()


@dataclass(frozen=True)
class FacetSubmesh:
    """The facets of an interface as a mesh of their own.

    Attributes:
        facets: Facet of the parent mesh for every cell of ``mesh``, owned ones first.
    """

    mesh: Mesh
    facets: NDArray[np.int32]
    entity_map: Any


def facet_submesh(mesh: Mesh, facets: NDArray[np.int32]) -> FacetSubmesh:
    fdim = mesh.topology.dim - 1
    submesh, entity_map, *_ = create_submesh(mesh, fdim, facets)
    cells = submesh.topology.index_map(fdim)
    count = cells.size_local + cells.num_ghosts
    if _NEW:
        parent = entity_map.sub_topology_to_topology(np.arange(count, dtype=np.int32), False)
        return FacetSubmesh(submesh, parent, entity_map)
    parent_facets = mesh.topology.index_map(fdim)
    inverse = np.full(parent_facets.size_local + parent_facets.num_ghosts, -1, dtype=np.int32)
    inverse[entity_map] = np.arange(len(entity_map), dtype=np.int32)
    return FacetSubmesh(submesh, np.asarray(entity_map), {submesh: inverse})


def cell_submesh(mesh: Mesh, cells: NDArray[np.int32]) -> tuple[Mesh, NDArray[np.int32]]:
    """Some cells as a mesh of their own, and the parent of each of its cells; collective."""
    submesh, entity_map, *_ = create_submesh(mesh, mesh.topology.dim, cells)
    if not _NEW:
        return submesh, np.asarray(entity_map, dtype=np.int32)
    count = submesh.topology.index_map(submesh.topology.dim)
    numbers = np.arange(count.size_local + count.num_ghosts, dtype=np.int32)
    return submesh, entity_map.sub_topology_to_topology(numbers, False)


def point_owners(
    mesh: Mesh, points: NDArray[np.float64], padding: float
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Where points (n, 3) of all ranks are, or the nearest cell no farther than ``padding``;
    collective.

    Returns:
        The rank that has each of them (n,); for every point that this rank has, which rank asks
        for it, in their order, and the cell.
    """
    given = np.ascontiguousarray(points), padding
    if _NEW:
        found = geometry.determine_point_ownership(mesh, *given)
        return found.src_owner, found.dest_owner, found.dest_cells
    found = cpp.geometry.determine_point_ownership(mesh._cpp_object, *given)
    return found.src_owner, found.dest_owners, found.dest_cells


def form(integrand: ufl.Form, submeshes: Sequence[FacetSubmesh], jit_options: dict) -> fem.Form:
    """Compile ``integrand``, whose coefficients may live on the given submeshes too."""
    entity_maps: Any
    if _NEW:
        entity_maps = [submesh.entity_map for submesh in submeshes]
    else:
        entity_maps = {}
        for submesh in submeshes:
            entity_maps |= submesh.entity_map
    compiled = fem.form(integrand, jit_options=jit_options, entity_maps=entity_maps)
    # fem.form leaves a reference cycle, which keeps the meshes and their communicators alive.
    entity_maps.clear()
    return compiled


def forget_traversals() -> None:
    """Release the objects that UFL's algorithms have cached for a form.

    Python 3.13.0 and 3.13.1 keep every object that a ``functools.singledispatchmethod`` was called
    on (issue 127750 of CPython), as those of newer versions of UFL, which know the mesh.
    """
    kinds = [DAGTraverser] if _NEW else []
    for kind in kinds:
        kinds += kind.__subclasses__()
        cache = getattr(vars(kind).get("process"), "_method_cache", None)
        if cache is not None:
            cache.clear()


def sparsity(
    test: fem.FunctionSpace,
    trial: fem.FunctionSpace,
    cells: NDArray[np.int32],
    facets: NDArray[np.int32],
) -> cpp.la.SparsityPattern:
    """The pattern that couples all dofs of every cell, and those of the two cells of every facet, a
    row (cell, facet in it, cell, facet in it), flattened.

    It needs a form but no kernel: nothing is compiled.
    """
    integrals = {
        integral: [(0, 0, entities, np.zeros(0, dtype=np.int8))]
        for integral, entities in (
            (fem.IntegralType.cell, cells),
            (fem.IntegralType.interior_facet, facets),
        )
    }
    spaces, mesh = [test._cpp_object, trial._cpp_object], test.mesh
    maps: Any = [] if _NEW else {}
    pattern_form = cpp.fem.Form_float64(spaces, integrals, [], [], False, maps, mesh._cpp_object)
    pattern = cpp.fem.create_sparsity_pattern(pattern_form)
    if test is trial:
        # Include rows that belong to no cell.
        pattern.insert_diagonal(np.arange(test.dofmap.index_map.size_local, dtype=np.int32))
    pattern.finalize()
    return pattern


def evaluate(
    expression: fem.Expression, mesh: Mesh, entities: NDArray[np.int32]
) -> NDArray[np.float64]:
    """Values of an expression on cells (n,), or on rows (cell, facet in it) (n, 2); (n, ...)."""
    return expression.eval(mesh, entities if _NEW else entities.ravel())


def interpolate(
    into: fem.Function, source: fem.Function | fem.Expression, cells: NDArray[np.int32]
) -> None:
    """Interpolate on local cells; ``Function.interpolate`` leaves a reference cycle to ``into``."""
    function = into._cpp_object
    if isinstance(source, fem.Expression) and hasattr(function, "interpolate_expr"):
        function.interpolate_expr(source._cpp_object, cells, cells)
    else:
        function.interpolate(source._cpp_object, cells, cells)


def index_map(
    comm: MPI.Comm, size_local: int, ghosts: NDArray[np.int64], owners: NDArray[np.int32]
) -> IndexMap:
    """IndexMap of a rank that owns ``size_local`` indices and holds these ghosts; collective."""
    return IndexMap(comm, size_local, ghosts, owners, *_TAG)


def coordinate_element(mesh: Mesh) -> Any:
    """The element of the geometry, with ``degree`` and ``variant``."""
    geometry = mesh.geometry
    return geometry.cmaps[0] if hasattr(geometry, "cmaps") else geometry.cmap


def geometry_dofmap(mesh: Mesh) -> NDArray[np.int32]:
    """Nodes of every local cell, (cells, nodes of a cell)."""
    geometry = mesh.geometry
    return geometry.dofmaps[0] if hasattr(geometry, "dofmaps") else geometry.dofmap


def input_numbers(mesh: Mesh) -> NDArray[np.int64]:
    """Numbers of the owned cells in the input of the mesh (cells,); of a submesh, which has no
    input, their global numbers."""
    cells = mesh.topology.index_map(mesh.topology.dim)
    try:
        numbers = np.asarray(mesh.topology.original_cell_index, dtype=np.int64)
    except RuntimeError:  # of DOLFINx 0.9
        numbers = np.zeros(0, dtype=np.int64)
    if len(numbers) < cells.size_local:
        return np.arange(*cells.local_range)
    return numbers[: cells.size_local]


def interpolation_points(space: fem.FunctionSpace) -> NDArray[np.float64]:
    points = space.element.interpolation_points
    return points() if callable(points) else points


def facet_ghost_partitioner(graph_partitioner: Any) -> Any:
    given = (graph_partitioner, GhostMode.shared_facet)
    return create_cell_partitioner(*given, 2) if _NEW else create_cell_partitioner(*given)


def function_space_with_dofmap(space: fem.FunctionSpace, dofmap: Any) -> fem.FunctionSpace:
    """The space of the elements of ``space`` with another numbering of its dofs."""
    shape = [] if _NEW else [space.value_shape]
    mesh = space.mesh
    cpp_space = cpp.fem.FunctionSpace_float64(
        mesh._cpp_object, space._cpp_object.element, dofmap, *shape
    )
    return fem.FunctionSpace(mesh, space.ufl_element(), cpp_space)


def _gmshio() -> Any:
    if _NEW:
        from dolfinx.io import gmsh as gmshio
    else:
        from dolfinx.io import gmshio
    return gmshio


def gmsh_midpoints(model: Any, gdim: int) -> NDArray[np.float64]:
    """Midpoints (n, 3) of the cells of a gmsh model, in the order they are sent."""
    gmshio = _gmshio()
    topologies = gmshio.extract_topology_and_markers(model)
    topologies = topologies[0] if isinstance(topologies, tuple) else topologies
    for element, values in topologies.items():
        if model.mesh.getElementProperties(element)[1] == gdim:
            return gmshio.extract_geometry(model)[values["topology"]].mean(axis=1)
    raise ValueError(f"the gmsh model has no cells of dimension {gdim} in a physical group")


def gmsh_model_to_mesh(
    model: Any, comm: MPI.Comm, rank: int, gdim: int, partitioner: Any
) -> tuple[Mesh, MeshTags, MeshTags]:
    """Distribute a gmsh model: mesh, tags of cells and facets from its groups."""
    data = _gmshio().model_to_mesh(model, comm, rank, gdim=gdim, partitioner=partitioner)
    if not _NEW:
        return data
    facet_tags = data.facet_tags
    if facet_tags is None:  # no group of facets
        nothing = np.zeros(0, dtype=np.int32)
        facet_tags = meshtags(data.mesh, data.mesh.topology.dim - 1, nothing, nothing)
    return data.mesh, data.cell_tags, facet_tags
