"""Two stacked plates, bonded beyond a pre-crack: section 7.3."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

from .gmsh_model import TaggedMesh, distribute, model, name_groups

CELLS = ("triangle", "quadrilateral")

#: Facet tags.
BOTTOM, TOP, INTERFACE, LOWER_LIP, UPPER_LIP, LEFT, RIGHT = 1, 2, 3, 4, 5, 6, 7

_BODIES = {"bottom plate": 1, "top plate": 2}
_SIDES = {
    "bottom": BOTTOM,
    "top": TOP,
    "interface": INTERFACE,
    "lower lip": LOWER_LIP,
    "upper lip": UPPER_LIP,
    "left": LEFT,
    "right": RIGHT,
}


def tearing(
    comm: MPI.Comm = MPI.COMM_WORLD,
    cell: str = "quadrilateral",
    width: float = 1.62,
    bottom_height: float = 1.35,
    top_height: float = 0.675,
    divisions: Sequence[int] = (24, 20, 10),
    precrack: float = 0.405,
) -> TaggedMesh:
    """Plates [0, width] x [0, h_b] and [0, width] x [h_b, h_b + h_t], with matching meshes.

    The pre-crack [0, precrack] on y = h_b is a slit: its faces share only the node at the tip, so
    it belongs to no interface. The tip is a node of every mesh.

    Args:
        comm: Communicator.
        cell: "triangle" or "quadrilateral".
        width: [mm].
        bottom_height: h_b [mm].
        top_height: h_t [mm].
        divisions: Cells along x, along y in the bottom plate and along y in the top plate.
        precrack: Its length [mm].

    Returns:
        Mesh; cell tags 1 (bottom plate) and 2 (top plate); facet tags 1 bottom (y = 0), 2 top,
        3 interface, 4 and 5 lower and upper face of the pre-crack, 6 left, 7 right.

    Raises:
        ValueError: unknown cell, or the pre-crack has zero or full length.
    """
    if cell not in CELLS:
        raise ValueError(f"tearing: cell = {cell!r} must be one of {CELLS}")
    if not 0 < precrack < width:
        raise ValueError(f"tearing: precrack = {precrack} must lie within (0, {width})")
    columns = min(max(round(divisions[0] * precrack / width), 1), divisions[0] - 1)
    if columns < 1:
        raise ValueError(f"tearing: divisions = {tuple(divisions)} needs two cells along x")
    with model("tearing") as gmsh_model:
        if comm.rank == 0:
            counts = (columns, divisions[0] - columns), divisions[1:]
            xs = (0, precrack / width, 1)
            _build(gmsh_model, cell, xs, (bottom_height / width, top_height / width), counts)
        return distribute(gmsh_model, comm, 2, unit=width)


def _build(
    gmsh_model: Any,
    cell: str,
    xs: Sequence[float],
    heights: Sequence[float],
    counts: tuple[tuple[int, int], Sequence[int]],
) -> None:
    geo = gmsh_model.geo
    columns, rows = counts
    middle, end = heights[0], heights[0] + heights[1]
    bottom, lower, top = ([geo.addPoint(x, y, 0) for x in xs] for y in (0, middle, end))
    upper = [geo.addPoint(0, middle, 0), *lower[1:]]

    def lines(starts: Sequence[int], ends: Sequence[int], counts: Sequence[int]) -> list[int]:
        made = [geo.addLine(a, b) for a, b in zip(starts, ends, strict=True)]
        for line, count in zip(made, counts, strict=True):
            geo.mesh.setTransfiniteCurve(line, count + 1)
        return made

    across = [lines(points[:2], points[1:], columns) for points in (bottom, lower, top)]
    lips = [across[1][0], *lines(upper[:1], upper[1:2], columns[:1])]
    # Lower and upper edge of every plate, then its vertical edges.
    edges = [(across[0], across[1]), ([lips[1], across[1][1]], across[2])]
    uprights = [lines(bottom, lower, [rows[0]] * 3), lines(upper, top, [rows[1]] * 3)]
    plates = []
    for (low, high), upright in zip(edges, uprights, strict=True):
        faces = []
        for i in range(2):
            loop = geo.addCurveLoop([low[i], upright[i + 1], -high[i], -upright[i]])
            faces.append(geo.addPlaneSurface([loop]))
            geo.mesh.setTransfiniteSurface(faces[i])
            if cell == "quadrilateral":
                geo.mesh.setRecombine(2, faces[i])
        plates.append(faces)
    geo.synchronize()
    sides = [
        across[0],
        across[2],
        [across[1][1]],
        lips[:1],
        lips[1:],
        [upright[0] for upright in uprights],
        [upright[2] for upright in uprights],
    ]
    for tag, faces in enumerate(plates, start=1):
        gmsh_model.addPhysicalGroup(2, faces, tag)
    for tag, side in enumerate(sides, start=BOTTOM):
        gmsh_model.addPhysicalGroup(1, side, tag)
    name_groups(gmsh_model, 2, _BODIES)
    name_groups(gmsh_model, 1, _SIDES)
    gmsh_model.mesh.generate(2)
