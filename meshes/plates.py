"""Two stacked plates with a crack along their interface: arms of a 3D test specimen."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from vmdg.base.tables import rounded

from .beams import (
    BOTTOM,
    CONTACT,
    INTERFACE,
    LOWER_LEFT,
    RIGHT,
    SIDES,
    SLIT,
    TOP,
    UPPER_LEFT,
)
from .extrusion import HEXAHEDRON, QUADRILATERAL
from .gmsh_model import TaggedMesh, distribute, model, name_groups

_BODIES = {"lower plate": 1, "upper plate": 2}
_SIDES = {name: tag for name, tag in SIDES.items() if tag != CONTACT}

#: Corners of a quadrilateral in gmsh order, as steps along the axes.
_ROUND = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


def plates(
    comm: MPI.Comm = MPI.COMM_WORLD,
    x: Sequence[float] = (0.0, 30.0, 100.0),
    y: Sequence[float] = (0.0, 25.0),
    height: float = 1.5,
    rows: int = 1,
    precrack: float = 30.0,
) -> TaggedMesh:
    """Plates x [-height, 0] and x [0, height] of hexahedra, with a straight slit as the crack.

    Args:
        comm: Communicator. Ranks own strips of the plates along x.
        x, y: Planes between the cells [mm].
        height: Height of one plate, along z [mm].
        rows: Cells over that height.
        precrack: Where the crack that starts at x[0] ends, one of ``x`` [mm].

    Returns:
        Mesh; cell tags 1 (lower plate) and 2 (upper plate); facet tags 1 and 2 ends of the lower
        and upper plate at x[0], 3 ends at x[-1], 4 bottom, 5 top, 6 interface, 7 faces of the slit.

    Raises:
        ValueError: planes do not ascend, or the crack does not end at one of them.
    """
    for name, planes in (("x", x), ("y", y)):
        if len(planes) < 2 or not all(a < b for a, b in pairwise(planes)):
            raise ValueError(f"plates: {name} = {rounded(planes)} must ascend, two at least")
    cracked = np.flatnonzero(np.isclose(x, precrack, atol=1e-9 * (x[-1] - x[0])))
    if len(cracked) != 1 or not 0 < cracked[0] < len(x) - 1:
        raise ValueError(
            f"plates: precrack = {precrack} must be one of the planes inside x = "
            f"{rounded(x)}; where its faces may touch, end it earlier and give the interface there "
            "initial_damage=1"
        )
    with model("plates") as gmsh_model:
        if comm.rank == 0:
            _build(gmsh_model, np.asarray(x), np.asarray(y), height, rows, int(cracked[0]))
        return distribute(gmsh_model, comm, 3, slabs_along=1)


def _build(gmsh_model: Any, x: NDArray, y: NDArray, height: float, rows: int, cracked: int) -> None:
    """Nodes and elements of both plates, in groups."""
    z = np.linspace(0.0, height, rows + 1)
    count = len(x) * len(y) * (rows + 1)
    lower = np.arange(1, count + 1).reshape(len(x), len(y), rows + 1)
    # Beyond the tip the plates share the nodes of the interface.
    upper = lower + count
    upper[cracked:, :, 0] = lower[cracked:, :, -1]
    _, first, nodes = np.unique([lower, upper], return_index=True, return_inverse=True)
    lower, upper = 1 + nodes.reshape(2, *lower.shape)
    points = np.concatenate(
        [np.stack(np.meshgrid(x, y, z + low, indexing="ij"), axis=-1) for low in (-height, 0.0)],
    ).reshape(-1, 3)
    surfaces = {
        LOWER_LEFT: [lower[0]],
        UPPER_LEFT: [upper[0]],
        RIGHT: [lower[-1], upper[-1]],
        BOTTOM: [lower[:, :, 0]],
        TOP: [upper[:, :, -1]],
        INTERFACE: [lower[cracked:, :, -1]],
        SLIT: [lower[: cracked + 1, :, -1], upper[: cracked + 1, :, 0]],
    }
    for tag, grid in enumerate((lower, upper), start=1):
        gmsh_model.addDiscreteEntity(3, tag)
        if tag == 1:
            numbers = np.arange(1, len(first) + 1)
            gmsh_model.mesh.addNodes(3, 1, numbers, points[first].ravel())
        low, high = _cells(grid[:, :, :-1]), _cells(grid[:, :, 1:])
        cells = np.concatenate([low, high], axis=-1).reshape(-1, 8)
        gmsh_model.mesh.addElementsByType(tag, HEXAHEDRON, [], cells.ravel())
        gmsh_model.addPhysicalGroup(3, [tag], tag)
    for tag, grids in surfaces.items():
        gmsh_model.addDiscreteEntity(2, tag)
        faces = np.concatenate([_cells(grid).reshape(-1, 4) for grid in grids])
        gmsh_model.mesh.addElementsByType(tag, QUADRILATERAL, [], faces.ravel())
        gmsh_model.addPhysicalGroup(2, [tag], tag)
    name_groups(gmsh_model, 3, _BODIES)
    name_groups(gmsh_model, 2, _SIDES)


def _cells(grid: NDArray[np.int64]) -> NDArray[np.int64]:
    """Corners of the quadrilaterals of the first two axes, (..., 4)."""
    n, m = grid.shape[0] - 1, grid.shape[1] - 1
    return np.stack([grid[i : i + n, j : j + m] for i, j in _ROUND], axis=-1)
