"""A gmsh model on rank 0 and its distribution with the facet ghosts that interfaces need."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from mpi4py import MPI

import gmsh
import numpy as np
from dolfinx.mesh import Mesh, MeshTags

from vmdg import compat
from vmdg.partition import between_bodies, slabs, weighted


class TaggedMesh(NamedTuple):
    """A mesh with the tags of its physical groups."""

    mesh: Mesh
    cell_tags: MeshTags
    facet_tags: MeshTags


@contextmanager
def model(name: str) -> Iterator[Any]:
    """A fresh, silent gmsh model; gmsh is closed at the end."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add(name)
        yield gmsh.model
    finally:
        gmsh.finalize()


def distribute(
    gmsh_model: Any,
    comm: MPI.Comm,
    gdim: int,
    interface_weight: int = 1,
    slabs_along: int | None = None,
) -> TaggedMesh:
    """Distribute the model of rank 0 over ``comm``, ghosts by shared facets; collective.

    Args:
        gmsh_model: With a physical group for every body.
        comm: Communicator.
        gdim: Dimension.
        interface_weight: Number of cells as which those next to another body count, so that the
            ranks share the work of the interfaces too.
        slabs_along: Cut across this axis only (0, 1, 2), see :func:`vmdg.partition.slabs`.

    Raises:
        ValueError: a weight below 1.
    """
    graph_partitioner = None
    if interface_weight != 1 or slabs_along is not None:
        tags, midpoints = np.zeros(0, dtype=np.int32), np.zeros((0, 3))
        if comm.rank == 0:
            tags, midpoints = compat.gmsh_cells(gmsh_model, gdim)
        if slabs_along is None:
            graph_partitioner = weighted(between_bodies(tags, interface_weight))
        else:
            graph_partitioner = slabs(midpoints[:, slabs_along])
    return TaggedMesh(*compat.gmsh_model_to_mesh(gmsh_model, comm, 0, gdim, graph_partitioner))
