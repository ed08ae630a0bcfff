"""What the parts of the benchmark share: processor time, meshes of two layers, tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from time import process_time
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import (
    CellType,
    GhostMode,
    compute_midpoints,
    create_box,
    create_rectangle,
    locate_entities_boundary,
    meshtags,
)

from vmdg.meshes import TaggedMesh

DIMENSION = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}

#: Cell tags, and facet tags of the ends of the last direction.
LOWER, UPPER = 1, 2
BOTTOM, TOP = 1, 2


def layers(
    cell: str,
    divisions: Sequence[int],
    sizes: Sequence[float],
    below: int,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> TaggedMesh:
    """A rectangle or box of two layers with the interface across its last direction.

    Args:
        sizes: Lengths [mm].
        below: How many of the cells of the last direction belong to the lower layer.

    Returns:
        Mesh; cell tags 1 (lower) and 2 (upper); facet tags 1 bottom, 2 top.
    """
    d = DIMENSION[cell]
    make = create_rectangle if d == 2 else create_box
    corners = [np.zeros(d), np.asarray(sizes, dtype=float)]
    mesh = make(comm, corners, divisions, CellType[cell], ghost_mode=GhostMode.shared_facet)
    imap = mesh.topology.index_map(d)
    cells = np.arange(imap.size_local + imap.num_ghosts, dtype=np.int32)
    level = below * sizes[-1] / divisions[-1]
    upper = compute_midpoints(mesh, d, cells)[:, d - 1] > level
    tags = meshtags(mesh, d, cells, np.where(upper, UPPER, LOWER).astype(np.int32))
    ends = [
        locate_entities_boundary(mesh, d - 1, lambda x, z=z: np.isclose(x[d - 1], z))
        for z in (0.0, sizes[-1])
    ]
    facets = np.concatenate(ends)
    values = np.repeat(np.array([BOTTOM, TOP], dtype=np.int32), [len(end) for end in ends])
    order = np.argsort(facets)
    return TaggedMesh(mesh, tags, meshtags(mesh, d - 1, facets[order], values[order]))


def least_times(
    variants: Mapping[str, Mapping[str, Callable[[], Any]]], repeats: int
) -> dict[str, dict[str, float]]:
    """Processor time of the steps of several variants [s], the least of some runs; collective.

    The variants take turns, so that a change of the machine's speed hits all of them. That of the
    slowest rank.

    Args:
        variants: For every variant what it does, by name, in this order.
    """
    least = {name: dict.fromkeys(steps, np.inf) for name, steps in variants.items()}
    for _ in range(repeats):
        for name, steps in variants.items():
            for step, action in steps.items():
                start = process_time()
                action()
                spent = MPI.COMM_WORLD.allreduce(process_time() - start, MPI.MAX)
                least[name][step] = min(least[name][step], spent)
    return least
