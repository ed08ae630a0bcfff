"""Composite cells: random discs, aligned fibres or spheres, periodic or not."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from .extrusion import extrude
from .fibres import FIBRE, INTERFACE, MATRIX, generate_cells
from .gmsh_model import (
    TaggedMesh,
    distribute,
    generate_tetrahedra,
    model,
    name_groups,
    one_size,
)
from .packing import cut_balls, images, pack
from .periodic import SIDES, match_sides, sides

#: Cells of every shape, the default first.
CELLS = {
    "disc": ("triangle", "quadrilateral"),
    "cylinder": ("tetrahedron", "hexahedron"),
    "sphere": ("tetrahedron",),
}

#: Cell tag in addition to those of :mod:`vmdg.meshes.fibres`.
COATING = 3

_BODIES = {"fibre": FIBRE, "matrix": MATRIX, "coating": COATING}


def fibre_cell(
    count: int,
    fraction: float,
    seed: int = 0,
    periodic: bool = True,
    shape: str = "disc",
    size: float = 1.0,
    depth: float | None = None,
    coating: float = 0.0,
    spacing: float = 0.1,
    element_size: float | None = None,
    cell: str | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> TaggedMesh:
    """Equal fibres or spheres at random positions in a matrix, in the cell [0, size]^d.

    In a periodic cell, fibres cut by a side continue at the opposite side, which has the same mesh.
    The cell is shifted so that no side is nearly tangent to a fibre.

    Args:
        count: Number of fibres.
        fraction: Volume fraction of the fibres, without coatings: up to 0.6 for discs and fibres,
            0.45 for spheres, at the default spacing.
        seed: Random seed: the same seed gives the same cell, on any number of ranks.
        periodic: Whether sides may cut fibres, which continue at the opposite side; otherwise none
            is cut.
        shape: "disc" in 2D; in 3D "cylinder" along z, or "sphere".
        size: Side of the cell [mm].
        depth: Depth of the cell along z [mm], for cylinders; default one layer of cells.
        coating: Thickness of the coating of every fibre, in radii; 0 for none.
        spacing: Least distance between two (coated) fibres, in radii.
        element_size: [mm]; default a quarter of the radius.
        cell: "triangle" or "quadrilateral" for discs, "tetrahedron" or "hexahedron" for cylinders,
            "tetrahedron" for spheres; default the first.
        comm: Communicator.

    Returns:
        Mesh; cell tags 1 (fibre), 2 (matrix) and, with coatings, 3 (coating); facet tags 1 left,
        2 right, 4 bottom (y = 0), 5 top, in 3D 6 back (z = 0) and 7 front, and 3 interface: all
        facets between two groups.

    Raises:
        ValueError: the fibres do not fit, or an argument is out of range.
    """
    if shape not in CELLS:
        raise ValueError(f"fibre_cell: shape = {shape!r} must be one of {tuple(CELLS)}")
    cell = cell or CELLS[shape][0]
    if cell not in CELLS[shape]:
        raise ValueError(f"fibre_cell: cell = {cell!r} of a {shape} must be one of {CELLS[shape]}")
    if not coating >= 0 or not size > 0 or (depth is not None and not depth > 0):
        raise ValueError(
            f"fibre_cell: coating = {coating} must be 0 or positive, size = {size} and "
            f"depth = {depth} positive"
        )
    dim = 3 if shape == "sphere" else 2
    filled = fraction * (1 + coating) ** dim
    # The spacing is in radii of the fibres, but pack expects it in radii of the coated fibres.
    centres, radii = pack(count, filled, seed, periodic, 1.0, dim, spacing / (1 + coating))
    outer = radii[0]
    circles = sorted({outer, outer / (1 + coating)}, reverse=True)
    if periodic:
        # The poles of a sphere are above its centre, and no side may pass near them.
        kept_clear = [*circles, 0.0] if dim == 3 else circles
        centres = cut_balls(centres, kept_clear, 1.0)
    fine = element_size / size if element_size else circles[-1] / 4
    with model("fibre_cell") as gmsh_model:
        if comm.rank == 0:
            _geometry(gmsh_model, centres, circles, 1.0, periodic)
            one_size(fine)
            if shape == "sphere":
                generate_tetrahedra(gmsh_model)
            else:
                flat = "triangle" if cell in ("triangle", "tetrahedron") else "quadrilateral"
                generate_cells(gmsh_model, flat)
            if shape == "cylinder":
                extrude(gmsh_model, 1.0, depth / size if depth else fine, fine)
            name_groups(gmsh_model, gmsh_model.getDimension(), _BODIES)
            names = SIDES | {"interface": INTERFACE}
            name_groups(gmsh_model, gmsh_model.getDimension() - 1, names)
        return distribute(gmsh_model, comm, 2 if shape == "disc" else 3, unit=size)


def _geometry(
    gmsh_model: Any,
    centres: NDArray[np.float64],
    circles: list[float],
    size: float,
    periodic: bool,
) -> None:
    """Bodies, their groups, and matching sides; ``circles`` from the largest to the smallest."""
    occ, dim = gmsh_model.occ, centres.shape[1]
    places = images(centres, circles[0], size)[0] if periodic else centres

    def ball(x: NDArray[np.float64], radius: float) -> tuple[int, int]:
        if dim == 3:
            return 3, occ.addSphere(*x, radius)
        start = _beyond_sides(x, radius, size)
        return 2, occ.addDisk(*x, 0.0, radius, radius, zAxis=[0, 0, 1], xAxis=[*start, 0])

    rectangle = occ.addRectangle if dim == 2 else occ.addBox
    box = (dim, rectangle(0, 0, 0, *[size] * dim))
    balls = [ball(x, radius) for radius in circles for x in places]
    made, pieces = occ.fragment([box], balls)
    inside = {tag for d, tag in pieces[0] if d == dim}
    occ.remove([(d, tag) for d, tag in made if d == dim and tag not in inside], recursive=True)
    occ.synchronize()
    layers: list[set[int]] = [set() for _ in circles]
    for n, piece in enumerate(pieces[1:]):
        layers[n // len(places)] |= {tag for _, tag in piece} & inside
    bodies = {MATRIX: inside - layers[0], FIBRE: layers[-1], COATING: layers[0] - layers[-1]}
    boundaries: list[set[int]] = []
    for tag, entities in bodies.items():
        if entities:
            gmsh_model.addPhysicalGroup(dim, sorted(entities), tag)
            around = gmsh_model.getBoundary([(dim, e) for e in entities], oriented=False)
            boundaries.append({entity for _, entity in around})
    found = sides(gmsh_model, dim, size)
    outline = {entity for entities in found.values() for entity in entities}
    interface = set[int]().union(*boundaries) - outline
    for tag, facets in {**found, INTERFACE: sorted(interface)}.items():
        gmsh_model.addPhysicalGroup(dim - 1, facets, tag)
    if periodic:
        match_sides(gmsh_model, found, dim, size)


def _beyond_sides(x: NDArray[np.float64], radius: float, size: float) -> list[float]:
    """Direction from the centre to the start of a circle: outside the cell, if it extends beyond
    it.

    A circle starts at a node, which would create a short edge near a side.
    """
    for axis in range(2):
        for sign, leaves in ((-1.0, x[axis] < radius), (1.0, x[axis] > size - radius)):
            if leaves:
                return [sign if axis == k else 0.0 for k in range(2)]
    return [1.0, 0.0]
