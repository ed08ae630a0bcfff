"""Polycrystals: grains that fill a square or a cube, periodic or not."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np

from .fibres import generate_cells
from .gmsh_model import (
    TaggedMesh,
    distribute,
    generate_tetrahedra,
    model,
    name_groups,
    one_size,
)
from .packing import pack
from .periodic import PAIRS, SIDES
from .tessellation import Tessellation, tessellate

#: Cells, the default first, by dimension.
CELLS = {2: ("triangle", "quadrilateral"), 3: ("tetrahedron",)}

#: Facet tag of the grain boundaries; the sides have those of :mod:`vmdg.meshes.periodic`.
BOUNDARY = 3

#: Packing fraction of the balls whose centres are the seeds, by dimension: gives grains as uniform
#: as in annealed metals, and few short edges.
FILLED = {2: 0.6, 3: 0.45}

#: Edges shorter than this fraction of the element size become points.
SHORTEST = 0.4


def polycrystal(
    count: int,
    seed: int = 0,
    periodic: bool = True,
    dim: int = 2,
    size: float = 1.0,
    spread: float = 0.0,
    element_size: float | None = None,
    cell: str | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> TaggedMesh:
    """Grains in the cell [0, size]^dim: Voronoi cells of random seeds, or Laguerre cells with
    ``spread``.

    Seeds are the centres of packed balls. With ``spread`` their radii differ, and the cells of the
    power diagram with these radii differ accordingly. Edges much shorter than ``element_size``
    become points; in 3D, grain faces that this bends are triangulated.

    Args:
        count: Number of grains.
        seed: Random seed: the same seed gives the same grains, on any number of ranks.
        periodic: Whether grains cut by a side continue at the opposite side, which has the same
            mesh; otherwise the grains end there.
        dim: 2 or 3.
        size: Side of the cell [mm].
        spread: Spread of grain sizes: standard deviation of the logarithm of the radii of the
            balls; 0.35 for grown grains.
        element_size: [mm]; default a sixth of the mean size of a grain.
        cell: "triangle" or "quadrilateral" in 2D, "tetrahedron" in 3D; default the first.
        comm: Communicator.

    Returns:
        Mesh; cell tags 1 to ``count``, called "grain 1" and so on; facet tags 1 left, 2 right, 4
        bottom (y = 0), 5 top, in 3D 6 back (z = 0) and 7 front, and 3 boundary: all facets between
        two grains.

    Raises:
        ValueError: an argument is out of range, or the grains do not fit.
    """
    if dim not in CELLS:
        raise ValueError(f"polycrystal: dim = {dim} must be 2 or 3")
    cell = cell or CELLS[dim][0]
    if cell not in CELLS[dim]:
        raise ValueError(f"polycrystal: cell = {cell!r} in {dim}D must be one of {CELLS[dim]}")
    seeds, radii = pack(count, FILLED[dim], seed, periodic, 1.0, dim, 0.0, spread)
    fine = element_size / size if element_size else count ** (-1 / dim) / 6
    with model("polycrystal") as gmsh_model:
        if comm.rank == 0:
            grains = tessellate(seeds, radii**2, 1.0, periodic, SHORTEST * fine)
            _geometry(gmsh_model, grains, 1.0, periodic)
            one_size(fine)
            if dim == 3:
                generate_tetrahedra(gmsh_model)
            else:
                generate_cells(gmsh_model, cell)
            name_groups(gmsh_model, dim, {f"grain {n}": n for n in range(1, count + 1)})
            name_groups(gmsh_model, dim - 1, SIDES | {"boundary": BOUNDARY})
        return distribute(gmsh_model, comm, dim, unit=size)


def _geometry(gmsh_model: Any, grains: Tessellation, size: float, periodic: bool) -> None:
    geo, dim = gmsh_model.geo, grains.points.shape[1]
    faces = _faces(geo, grains)
    bodies: dict[int, list[int]] = {}
    grains_beside: dict[int, set[int]] = {}
    for grain, around in grains.pieces:
        own = [faces[frozenset(face)] for face in around]
        for face in own:
            grains_beside.setdefault(face, set()).add(grain)
        if dim == 2:
            body = geo.addPlaneSurface([geo.addCurveLoop(own, reorient=True)])
        else:
            body = geo.addVolume([geo.addSurfaceLoop(own)])
        bodies.setdefault(grain + 1, []).append(body)
    geo.synchronize()
    for tag, entities in bodies.items():
        gmsh_model.addPhysicalGroup(dim, entities, tag)
    for axis, pair in enumerate(PAIRS[:dim]):
        sides = [
            {key: e for key, e in faces.items() if (grains.points[list(key), axis] == x).all()}
            for x in (0.0, size)
        ]
        for tag, side in zip(pair, sides, strict=True):
            gmsh_model.addPhysicalGroup(dim - 1, sorted(side.values()), tag)
        if periodic:
            low, high = sides
            shift = np.eye(4)
            shift[axis, 3] = size
            images = [low[frozenset(grains.image[list(key), axis].tolist())] for key in high]
            gmsh_model.mesh.setPeriodic(dim - 1, list(high.values()), images, shift.ravel())
    inner = [face for face, beside in grains_beside.items() if len(beside) == 2]
    if inner:
        gmsh_model.addPhysicalGroup(dim - 1, inner, BOUNDARY)


def _faces(geo: Any, grains: Tessellation) -> dict[frozenset[int], int]:
    """Surfaces, in 2D lines, by the numbers of their corners."""
    dim = grains.points.shape[1]
    corners = [geo.addPoint(*x, *[0.0] * (3 - dim)) for x in grains.points]
    lines: dict[tuple[int, int], int] = {}

    def line(a: int, b: int) -> int:
        if (a, b) not in lines:
            lines[a, b] = geo.addLine(corners[a], corners[b])
            lines[b, a] = -lines[a, b]
        return lines[a, b]

    faces: dict[frozenset[int], int] = {}
    for face in (face for _, around in grains.pieces for face in around):
        key = frozenset(face)
        if key in faces:
            continue
        if dim == 2:
            faces[key] = abs(line(*face))
        else:
            edges = [line(a, b) for a, b in zip(face, (*face[1:], face[0]), strict=True)]
            faces[key] = geo.addPlaneSurface([geo.addCurveLoop(edges)])
    return faces
