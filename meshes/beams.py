"""A beam of two arms with a crack along their interface: DCB, ENF."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from mpi4py import MPI

from .gmsh_model import TaggedMesh, distribute, model, name_groups

CELLS = ("triangle", "quadrilateral")

#: Facet tags.
LOWER_LEFT, UPPER_LEFT, RIGHT, BOTTOM, TOP, INTERFACE, SLIT, CONTACT = 1, 2, 3, 4, 5, 6, 7, 8

_BODIES = {"lower arm": 1, "upper arm": 2}
SIDES = {
    "lower left": LOWER_LEFT,
    "upper left": UPPER_LEFT,
    "right": RIGHT,
    "bottom": BOTTOM,
    "top": TOP,
    "interface": INTERFACE,
    "slit": SLIT,
    "contact": CONTACT,
}


def beams(
    comm: MPI.Comm = MPI.COMM_WORLD,
    cell: str = "quadrilateral",
    stations: Sequence[float] = (0.0, 30.0, 100.0),
    divisions: Sequence[int] = (30, 70),
    height: float = 1.5,
    rows: int = 2,
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
        height: Height of one arm [mm].
        rows: Cells over that height.
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
    length = stations[-1] - stations[0]
    cracked = stations.index(precrack)
    start = 0 if contact is None else stations.index(contact)
    with model("beams") as gmsh_model:
        if comm.rank == 0:
            places = [x / length for x in stations]
            _build(gmsh_model, cell, places, divisions, height / length, rows, cracked, start)
        return distribute(gmsh_model, comm, 2, unit=length)


def _build(
    gmsh_model: Any,
    cell: str,
    stations: Sequence[float],
    divisions: Sequence[int],
    height: float,
    rows: int,
    cracked: int,
    start: int,
) -> None:
    geo = gmsh_model.geo
    rims = [[geo.addPoint(x, y, 0) for x in stations] for y in (-height, 0, height)]
    bottom, lower, top = rims
    upper = lower.copy()
    for j in range(start + (start > 0), cracked):
        upper[j] = geo.addPoint(stations[j], 0, 0)

    def chain(points: Sequence[int]) -> list[int]:
        return [geo.addLine(a, b) for a, b in pairwise(points)]

    below = chain(lower)
    lip = chain(upper[start : cracked + 1])
    above = [*below[:start], *lip, *below[cracked:]]
    # Lower and upper edge of every arm.
    edges = [(chain(bottom), below), (above, chain(top))]
    upright = [
        [geo.addLine(a, b) for a, b in zip(*ends, strict=True)]
        for ends in ((bottom, lower), (upper, top))
    ]
    for lines in (line for pair in edges for line in pair):
        for line, count in zip(lines, divisions, strict=True):
            geo.mesh.setTransfiniteCurve(line, count + 1)
    for line in (*upright[0], *upright[1]):
        geo.mesh.setTransfiniteCurve(line, rows + 1)
    arms: list[list[int]] = [[], []]
    for i, arm in enumerate(arms):
        for j in range(len(divisions)):
            loop = [edges[i][0][j], upright[i][j + 1], -edges[i][1][j], -upright[i][j]]
            face = geo.addPlaneSurface([geo.addCurveLoop(loop)])
            geo.mesh.setTransfiniteSurface(face)
            if cell == "quadrilateral":
                geo.mesh.setRecombine(2, face)
            arm.append(face)
    geo.synchronize()
    ends = [[upright[0][0]], [upright[1][0]], [upright[0][-1], upright[1][-1]]]
    lips = [*below[start:cracked], *lip]
    sides = [*ends, edges[0][0], edges[1][1], below[cracked:], lips, below[:start]]
    for tag, arm in enumerate(arms, start=1):
        gmsh_model.addPhysicalGroup(2, arm, tag)
    for tag, side in enumerate(sides, start=LOWER_LEFT):
        if side:
            gmsh_model.addPhysicalGroup(1, side, tag)
    name_groups(gmsh_model, 2, _BODIES)
    name_groups(gmsh_model, 1, SIDES)
    gmsh_model.mesh.generate(2)
