"""What studies ask of a mesh and of all ranks."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import Mesh, MeshTags
from numpy.typing import ArrayLike, NDArray


def facet_cells(mesh: Mesh) -> NDArray[np.int32]:
    """Cells of every facet of this rank (n, 2), -1 for the second one at the boundary."""
    d = mesh.topology.dim
    mesh.topology.create_entities(d - 1)
    mesh.topology.create_connectivity(d - 1, d)
    links = mesh.topology.connectivity(d - 1, d)
    cells, first = links.array, links.offsets[:-1]
    several = np.diff(links.offsets) > 1
    second = np.where(several, cells[np.minimum(first + 1, len(cells) - 1)], -1)
    return np.column_stack([cells[first], second]).astype(np.int32)


def tags_of_cells(mesh: Mesh, tags: MeshTags) -> NDArray[np.int32]:
    """Tag of every cell of this rank, ghosts included; 0 without one."""
    imap = mesh.topology.index_map(mesh.topology.dim)
    values = np.zeros(imap.size_local + imap.num_ghosts, dtype=np.int32)
    values[tags.indices] = tags.values
    return values


def global_sum(comm: MPI.Comm, values: ArrayLike) -> NDArray:
    """Over all ranks, of a number or of every entry; collective."""
    return comm.allreduce(np.asarray(values), MPI.SUM)


def global_max(comm: MPI.Comm, value: float) -> float:
    """Over all ranks; collective."""
    return comm.allreduce(value, MPI.MAX)
