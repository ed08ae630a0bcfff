"""A rectangle with circular inclusions that its sides may cut."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import gmsh

from .gmsh_model import TaggedMesh, distribute, model, name_groups

#: Cell and facet tags.
MATRIX, INCLUSION = 1, 2
LEFT, RIGHT, INTERFACE, OTHERS = 1, 2, 3, 4

_BODIES = {"matrix": MATRIX, "inclusion": INCLUSION}
_SIDES = {"left": LEFT, "right": RIGHT, "interface": INTERFACE, "others": OTHERS}


def inclusions(
    comm: MPI.Comm = MPI.COMM_WORLD,
    width: float = 1.0,
    height: float = 0.5,
    radius: float = 0.25,
    centres: Sequence[tuple[float, float]] = ((0.4, 0.0), (0.6, 0.5)),
    element_size: float = 0.02,
    interface_size: float | None = None,
    order: int = 1,
) -> TaggedMesh:
    """The rectangle [0, width] x [0, height] with discs around ``centres``, triangles.

    Args:
        comm: Communicator.
        width: [mm].
        height: [mm].
        radius: Radius of the discs [mm].
        centres: [mm].
        element_size: Far from the interface [mm].
        interface_size: At the interface [mm]; sizes grow by a third of the distance from it;
            default ``element_size``.
        order: Order of the geometry: 2 approximates the circles to higher order.

    Returns:
        Mesh; cell tags 1 (matrix) and 2 (inclusions); facet tags 1 left, 2 right, 3 interface,
        4 bottom and top.

    Raises:
        ValueError: discs that touch or lie outside the rectangle.
    """
    for n, (x, y) in enumerate(centres):
        for a, b in centres[:n]:
            if (x - a) ** 2 + (y - b) ** 2 <= 4 * radius**2:
                raise ValueError(f"inclusions: the discs around {(a, b)} and {(x, y)} touch")
        gap = [max(-p, 0.0, p - size) for p, size in ((x, width), (y, height))]
        if gap[0] ** 2 + gap[1] ** 2 >= radius**2:
            raise ValueError(f"inclusions: the disc around {(x, y)} is outside the rectangle")
    with model("inclusions") as gmsh_model:
        if comm.rank == 0:
            at_interface = element_size if interface_size is None else interface_size
            lengths = (height, radius, element_size, at_interface)
            places = [(x / width, y / width) for x, y in centres]
            _build(gmsh_model, places, 1.0, *(length / width for length in lengths))
            gmsh_model.mesh.setOrder(order)
        return distribute(gmsh_model, comm, 2, unit=width)


def _build(
    gmsh_model: Any,
    centres: Sequence[tuple[float, float]],
    width: float,
    height: float,
    radius: float,
    size: float,
    at_interface: float,
) -> None:
    occ = gmsh_model.occ
    box = (2, occ.addRectangle(0, 0, 0, width, height))
    whole = [(2, occ.addDisk(x, y, 0, radius, radius)) for x, y in centres]
    inside, _ = occ.intersect(whole, [box], removeTool=False)
    faces, pieces = occ.fragment([box], inside)
    occ.synchronize()
    discs = sorted({tag for piece in pieces[1:] for _, tag in piece})
    matrix = sorted({tag for _, tag in faces} - set(discs))
    gmsh_model.addPhysicalGroup(2, matrix, MATRIX)
    gmsh_model.addPhysicalGroup(2, discs, INCLUSION)

    def lines(tags: list[int]) -> set[int]:
        return {abs(t) for _, t in gmsh_model.getBoundary([(2, tag) for tag in tags])}

    interface = lines(matrix) & lines(discs)
    sides: dict[int, list[int]] = {LEFT: [], RIGHT: [], OTHERS: []}
    for line in sorted((lines(matrix) | lines(discs)) - interface):
        low, _, _, high, *_ = gmsh_model.getBoundingBox(1, line)
        tolerance = 1e-6 * width
        at_left, at_right = high < tolerance, low > width - tolerance
        sides[LEFT if at_left else RIGHT if at_right else OTHERS].append(line)
    for tag, group in ({INTERFACE: sorted(interface)} | sides).items():
        gmsh_model.addPhysicalGroup(1, group, tag)
    name_groups(gmsh_model, 2, _BODIES)
    name_groups(gmsh_model, 1, _SIDES)
    field = gmsh_model.mesh.field
    distance, growth = field.add("Distance"), field.add("MathEval")
    field.setNumbers(distance, "CurvesList", sorted(interface))
    field.setNumber(distance, "Sampling", 200)
    field.setString(growth, "F", f"Min({size}, {at_interface} + F{distance} / 3)")
    field.setAsBackgroundMesh(growth)
    for source in ("ExtendFromBoundary", "FromPoints"):
        gmsh.option.setNumber(f"Mesh.MeshSize{source}", 0)
    gmsh_model.mesh.generate(2)
