"""Two arms with a crack along their interface: beams in the plane (DCB, ENF), plates in space."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from vmdg.base.tables import rounded

from .gmsh_model import TaggedMesh, distribute, model, name_groups

CELLS = ("triangle", "quadrilateral")

#: Facet tags.
LOWER_LEFT, UPPER_LEFT, RIGHT, BOTTOM, TOP, INTERFACE, SLIT, CONTACT = 1, 2, 3, 4, 5, 6, 7, 8

_SIDES = {
    "lower left": LOWER_LEFT,
    "upper left": UPPER_LEFT,
    "right": RIGHT,
    "bottom": BOTTOM,
    "top": TOP,
    "interface": INTERFACE,
    "slit": SLIT,
    "contact": CONTACT,
}

#: Element types of gmsh by number of corners; of four in the plane.
_KINDS = {2: 1, 3: 2, 4: 3, 8: 5}


def beams(
    comm: MPI.Comm = MPI.COMM_WORLD,
    cell: str = "quadrilateral",
    stations: Sequence[float] = (0.0, 30.0, 100.0),
    divisions: Sequence[int] = (30, 70),
    height: float | Sequence[float] = 1.5,
    rows: int | Sequence[int] = 2,
    precrack: float = 30.0,
    contact: float | None = None,
) -> TaggedMesh:
    """Arms [x_0, x_n] x [-height, 0] and [x_0, x_n] x [0, height], with matching meshes.

    The crack is a slit, whose faces share only the node at the tip. Its first part may instead be
    an interface with a separate tag, for a law with contact and friction.

    Args:
        comm: Communicator.
        cell: "triangle" or "quadrilateral".
        stations: x_0 < x_1 < ... < x_n, nodes of every mesh [mm].
        divisions: Cells between one station and the next.
        height: Height of one arm, or of the lower and of the upper one [mm].
        rows: Cells over that height, or over both.
        precrack: Where the crack that starts on the left ends, one of the stations [mm].
        contact: Where the first part ends, a station up to ``precrack`` [mm]; None for no such
            part.

    Returns:
        Mesh; cell tags 1 (lower arm) and 2 (upper arm); facet tags 1 and 2 left ends of the lower
        and upper arm, 3 right ends, 4 bottom, 5 top, 6 interface from the crack on,
        7 both faces of the slit, 8 the part of the crack before it.

    Raises:
        ValueError: unknown cell, or stations inconsistent with the divisions or the crack.
    """
    if cell not in CELLS:
        raise ValueError(f"beams: cell = {cell!r} must be one of {CELLS}")
    ascending = all(a < b for a, b in pairwise(stations))
    if len(divisions) != len(stations) - 1 or not ascending:
        raise ValueError("beams: stations must ascend, with one number of cells for each interval")
    if precrack not in stations[1:-1]:
        raise ValueError(f"beams: precrack = {precrack} must be a station inside {tuple(stations)}")
    if contact is not None and contact not in stations[1 : stations.index(precrack) + 1]:
        raise ValueError(f"beams: contact = {contact} must be a station up to {precrack}")
    ends = np.cumsum([0, *divisions])
    parts = zip(pairwise(stations), divisions, strict=True)
    x = np.concatenate([stations[:1], *(np.linspace(*pair, n + 1)[1:] for pair, n in parts)])
    start = 0 if contact is None else stations.index(contact)
    slit = int(ends[start]), int(ends[stations.index(precrack)])
    with model("beams") as gmsh_model:
        if comm.rank == 0:
            _build(gmsh_model, [x], height, rows, slit, "arm", cell == "triangle")
        return distribute(gmsh_model, comm, 2)


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
            _build(gmsh_model, [x, y], height, rows, (0, int(cracked[0])), "plate")
        return distribute(gmsh_model, comm, 3, slabs_along=1)


def _build(
    gmsh_model: Any,
    planes: Sequence[Sequence[float] | NDArray[np.float64]],
    height: float | Sequence[float],
    rows: int | Sequence[int],
    slit: tuple[int, int],
    body: str,
    halved: bool = False,
) -> None:
    """Nodes and elements of both arms, in groups.

    Args:
        slit: First and last of the planes across the first axis at the slit; its faces share the
            last one, and the first one where that is not the end of the arms.
    """
    begin, tip = slit
    (low, high), counts = np.broadcast_to(height, 2), np.broadcast_to(rows, 2)
    levels = np.linspace(-low, 0.0, counts[0] + 1), np.linspace(0.0, high, counts[1] + 1)
    points = [np.stack(np.meshgrid(*planes, z, indexing="ij"), axis=-1) for z in levels]
    sizes = [np.prod(x.shape[:-1]) for x in points]
    lower, upper = (np.arange(n).reshape(x.shape[:-1]) for n, x in zip(sizes, points, strict=True))
    upper += sizes[0]
    joined = np.ones(len(upper), dtype=bool)
    joined[begin + (begin > 0) : tip] = False
    upper[joined, ..., 0] = lower[joined, ..., -1]
    used, nodes = np.unique(np.concatenate([lower.ravel(), upper.ravel()]), return_inverse=True)
    lower, upper = (
        1 + nodes[: sizes[0]].reshape(lower.shape),
        1 + nodes[sizes[0] :].reshape(upper.shape),
    )
    x = np.zeros((sum(sizes), 3))
    x[:, : len(planes) + 1] = np.concatenate(
        [part.reshape(sizes[i], -1) for i, part in enumerate(points)]
    )
    faces = {
        LOWER_LEFT: [lower[0]],
        UPPER_LEFT: [upper[0]],
        RIGHT: [lower[-1], upper[-1]],
        BOTTOM: [lower[..., 0]],
        TOP: [upper[..., -1]],
        INTERFACE: [lower[tip:, ..., -1]],
        SLIT: [lower[begin : tip + 1, ..., -1], upper[begin : tip + 1, ..., 0]],
        CONTACT: [lower[: begin + 1, ..., -1]],
    }
    dim = len(planes) + 1
    groups = [(dim, tag, _cells(arm)) for tag, arm in enumerate((lower, upper), start=1)]
    if halved:
        groups = [
            (dim, tag, cells[:, [0, 1, 3, 1, 2, 3]].reshape(-1, 3)) for dim, tag, cells in groups
        ]
    for tag, grids in faces.items():
        cells = np.concatenate([_cells(grid) for grid in grids])
        groups += [(dim - 1, tag, cells)] * bool(len(cells))
    for d, tag, cells in groups:
        gmsh_model.addDiscreteEntity(d, tag)
        if d == dim and tag == 1:
            gmsh_model.mesh.addNodes(dim, 1, np.arange(1, len(used) + 1), x[used].ravel())
        gmsh_model.mesh.addElementsByType(tag, _KINDS[cells.shape[1]], [], cells.ravel())
        gmsh_model.addPhysicalGroup(d, [tag], tag)
    name_groups(gmsh_model, dim, {f"lower {body}": 1, f"upper {body}": 2})
    name_groups(gmsh_model, dim - 1, _SIDES)


def _cells(grid: NDArray[np.int64]) -> NDArray[np.int64]:
    """Lines, quadrilaterals or hexahedra between nodes of a grid, in gmsh's order (n, corners)."""
    cells = grid[..., None]
    for axis in range(grid.ndim):
        low, high = (np.take(cells, range(i, cells.shape[axis] - 1 + i), axis) for i in (0, 1))
        # Around a quadrilateral, then from its lower to its upper copy.
        cells = np.concatenate([low, high[..., ::-1] if axis == 1 else high], axis=-1)
    return cells.reshape(-1, cells.shape[-1])
