"""A gmsh model on rank 0 and its distribution with the facet ghosts that interfaces need."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from mpi4py import MPI

import gmsh
from dolfinx.mesh import Mesh, MeshTags

from vmdg import compat


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


def distribute(gmsh_model: Any, comm: MPI.Comm, gdim: int) -> TaggedMesh:
    """Distribute the model of rank 0 over ``comm``, ghosts by shared facets; collective."""
    return TaggedMesh(*compat.gmsh_model_to_mesh(gmsh_model, comm, 0, gdim))
