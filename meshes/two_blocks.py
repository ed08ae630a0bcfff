"""Two blocks side by side, sections 7.1.1 (upright interface) and 7.1.2 (inclined)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

from .gmsh_model import TaggedMesh, distribute, model, name_groups

CELLS = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}

#: Facet tags.
LEFT, RIGHT, INTERFACE, BOTTOM, TOP, BACK, FRONT = 1, 2, 3, 4, 5, 6, 7

_BODIES = {"left": 1, "right": 2}
_SIDES = {
    "left": LEFT,
    "right": RIGHT,
    "interface": INTERFACE,
    "bottom": BOTTOM,
    "top": TOP,
    "back": BACK,
    "front": FRONT,
}


def blocks(
    comm: MPI.Comm = MPI.COMM_WORLD,
    cell: str = "hexahedron",
    divisions: Sequence[int] = (1, 1, 1),
    length: float = 2.0,
    height: float = 1.0,
    depth: float = 1.0,
    interface: tuple[float, float] = (1.0, 1.0),
    order: int = 1,
) -> TaggedMesh:
    """Blocks [0, x_i] and [x_i, length] x [0, height] (x [0, depth]) that share an interface.

    Args:
        comm: Communicator.
        cell: "triangle", "quadrilateral", "tetrahedron" or "hexahedron".
        divisions: Cells along x, y (and z) of each block.
        length: Of both blocks together [mm].
        height: [mm].
        depth: In 3D [mm].
        interface: Its x at the bottom and at the top [mm].
        order: Order of the geometry: cells of order 2 can be curved by moving their nodes.

    Returns:
        Mesh; cell tags 1 (left) and 2 (right); facet tags 1 left, 2 right, 3 interface, 4 bottom
        (y = 0), 5 top, 6 back (z = 0), 7 front.

    Raises:
        ValueError: unknown cell, too few divisions, or the interface leaves the blocks.
    """
    if cell not in CELLS:
        raise ValueError(f"blocks: cell = {cell!r} must be one of {tuple(CELLS)}")
    if not all(0 < x < length for x in interface):
        raise ValueError(f"blocks: interface = {interface} must lie within (0, {length})")
    gdim = CELLS[cell]
    if len(divisions) < gdim or min(divisions[:gdim]) < 1:
        raise ValueError(
            f"blocks: divisions = {divisions} must be {gdim} numbers of cells, of 1 or more"
        )
    with model("blocks") as gmsh_model:
        if comm.rank == 0:
            sides = (1.0, height / length, depth / length)
            places = [x / length for x in interface]
            build_blocks(gmsh_model, cell, divisions, *sides, places)
            gmsh_model.mesh.setOrder(order)
        return distribute(gmsh_model, comm, gdim, unit=length)


def build_blocks(
    gmsh_model: Any,
    cell: str,
    divisions: Sequence[int],
    length: float,
    height: float,
    depth: float,
    interface: Sequence[float],
) -> None:
    geo = gmsh_model.geo
    bottom = [geo.addPoint(x, 0, 0) for x in (0, interface[0], length)]
    top = [geo.addPoint(x, height, 0) for x in (0, interface[1], length)]
    upright = [geo.addLine(b, t) for b, t in zip(bottom, top, strict=True)]
    lower = [geo.addLine(bottom[i], bottom[i + 1]) for i in range(2)]
    upper = [geo.addLine(top[i], top[i + 1]) for i in range(2)]
    for line in upright:
        geo.mesh.setTransfiniteCurve(line, divisions[1] + 1)
    for line in (*lower, *upper):
        geo.mesh.setTransfiniteCurve(line, divisions[0] + 1)
    faces = []
    for i in range(2):
        loop = geo.addCurveLoop([lower[i], upright[i + 1], -upper[i], -upright[i]])
        faces.append(geo.addPlaneSurface([loop]))
        geo.mesh.setTransfiniteSurface(faces[i])
        if cell in ("quadrilateral", "hexahedron"):
            geo.mesh.setRecombine(2, faces[i])
    if CELLS[cell] == 2:
        geo.synchronize()
        bodies, dim = faces, 2
        sides = [[upright[0]], [upright[2]], [upright[1]], lower, upper]
    else:
        recombine = cell == "hexahedron"
        made = [
            geo.extrude([(2, face)], 0, 0, depth, [divisions[2]], recombine=recombine)
            for face in faces
        ]
        geo.synchronize()
        # extrude returns the front face, the volume, then one face for each line of the loop.
        bodies, dim = [entities[1][1] for entities in made], 3
        swept = [[tag for _, tag in entities[2:]] for entities in made]
        sides = [
            [swept[0][3]],
            [swept[1][1]],
            [swept[0][1]],
            [face[0] for face in swept],
            [face[2] for face in swept],
            faces,
            [entities[0][1] for entities in made],
        ]
    for tag, body in enumerate(bodies, start=1):
        gmsh_model.addPhysicalGroup(dim, [body], tag)
    for tag, side in enumerate(sides, start=LEFT):
        gmsh_model.addPhysicalGroup(dim - 1, side, tag)
    name_groups(gmsh_model, dim, _BODIES)
    name_groups(gmsh_model, dim - 1, _SIDES)
    gmsh_model.mesh.generate(dim)
