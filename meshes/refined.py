"""A mesh of simplices whose cells are halved where they are to be small."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import dolfinx
import numpy as np
from dolfinx.mesh import Mesh, MeshTags, RefinementOption, entities_to_geometry, transfer_meshtag
from numpy.typing import NDArray

from .. import compat
from ..base.agreement import together
from ..base.parallel import gathered
from .apart import cells_in_order, distributed, names_of
from .gmsh_model import TaggedMesh

#: Lengths of cells at points (3, n): (n,) [mm].
Size = Callable[[NDArray[np.float64]], NDArray[np.float64]]

#: Relative difference of lengths that is rounding, and most cells, for which rank 0 has memory.
_LONGER, _MOST = 1e-6, 10**7


def refined(root: TaggedMesh | tuple[Mesh, MeshTags, MeshTags], size: Size) -> TaggedMesh:
    """A mesh of the same bodies whose edges are halved until none is longer than asked for there;
    collective.

    Edges are halved from the root each time (Plaza's bisection of DOLFINx): where the size is the
    same, so are the cells, but for those next to others. Rank 0 refines, and has the whole mesh
    for the moment.

    Args:
        root: Mesh of triangles or tetrahedra, cell tags and facet tags.
        size: Longest length of an edge with its middle at points (3, n): (n,) [mm]; called on
            rank 0.

    Returns:
        Mesh, cell tags and facet tags, with the names of the root.

    Raises:
        ValueError: other cells, curved ones, sizes that are not positive numbers, one each, or more
            than 1e7 cells.
    """
    mesh, comm = root[0], root[0].comm
    name, degree = mesh.topology.cell_name(), compat.coordinate_element(mesh).degree
    if name not in ("triangle", "tetrahedron") or degree > 1:
        raise ValueError(
            f"refined: cells are {name}s of degree {degree}; edges are halved of triangles and "
            "tetrahedra with straight edges. Make such a root, or a mesh of other cells for every "
            "size by gmsh"
        )
    names = [names_of([tags]) for tags in root[1:]]
    x, rows = (gathered(comm, part) for part in cells_in_order(comm, [tuple(root)]))

    def finer() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        if comm.rank:
            return x[:0], rows[:0]
        alone = distributed(MPI.COMM_SELF, x, rows, mesh, names)
        return cells_in_order(MPI.COMM_SELF, [_halved(alone, size)])

    return distributed(comm, *together(comm, finer), mesh, names)


def _halved(tagged: TaggedMesh, size: Size) -> tuple[Mesh, MeshTags, MeshTags]:
    mesh, cells, facets = tagged
    dim = mesh.topology.dim
    while mesh.topology.index_map(dim).size_local < _MOST:
        for pair in ((1, 0), (dim, 1), (1, dim), (dim, dim - 1), (dim - 1, dim)):
            mesh.topology.create_connectivity(*pair)
        edges = np.arange(mesh.topology.index_map(1).size_local, dtype=np.int32)
        ends = mesh.geometry.x[entities_to_geometry(mesh, 1, edges)]
        most = np.asarray(size(ends.mean(axis=1).T), dtype=float)
        if most.shape != edges.shape or not (most > 0).all():
            raise ValueError(
                f"refined: size has the values {most!r} at {len(edges)} points; it must return a "
                "positive length for each of them"
            )
        long = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > (1 + _LONGER) * most
        if not long.any():
            return mesh, cells, facets
        option = RefinementOption.parent_cell_and_facet
        finer, of_cells, of_facets = dolfinx.mesh.refine(mesh, edges[long], None, option)
        for pair in ((dim, dim - 1), (dim - 1, dim)):
            finer.topology.create_connectivity(*pair)
        cells = transfer_meshtag(cells, finer, of_cells)
        facets = transfer_meshtag(facets, finer, of_cells, of_facets)
        mesh = finer
    raise ValueError(
        f"refined: edges are longer than asked for in a mesh of {_MOST} cells: the sizes are too "
        "small"
    )
