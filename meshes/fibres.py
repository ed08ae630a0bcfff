"""Round fibres in a square cell of matrix, section 7.2."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from mpi4py import MPI

import gmsh
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .gmsh_model import TaggedMesh, distribute, model, name_groups, one_size
from .periodic import BOTTOM, LEFT, RIGHT, TOP

CELLS = ("triangle", "quadrilateral")

#: Cell tags; the fibre has the lower one, so N of the interface points into the matrix.
FIBRE, MATRIX = 1, 2

#: Facet tag in addition to those of the sides.
INTERFACE = 3

_BODIES = {"fibre": FIBRE, "matrix": MATRIX}
_SIDES = {"left": LEFT, "right": RIGHT, "interface": INTERFACE, "bottom": BOTTOM, "top": TOP}


def fibre_matrix(
    comm: MPI.Comm = MPI.COMM_WORLD,
    cell: str = "quadrilateral",
    size: float = 1.0,
    radius: float = 0.25,
    centres: ArrayLike | None = None,
    element_size: float = 0.1,
) -> TaggedMesh:
    """Fibres of one radius in the square [0, size] x [0, size]; unstructured, matching meshes.

    The midpoints of the left and right sides are nodes, for supports.

    Args:
        comm: Communicator.
        cell: "triangle" or "quadrilateral".
        size: Side of the square [mm].
        radius: Radius of every fibre [mm].
        centres: Centres of the fibres (n, 2) [mm]; default one fibre in the middle.
        element_size: Size of the cells [mm].

    Returns:
        Mesh; cell tags 1 (fibres) and 2 (matrix); facet tags 1 left, 2 right, 3 fibre-matrix
        interface, 4 bottom (y = 0), 5 top.

    Raises:
        ValueError: unknown cell, or fibres that overlap or leave the square.
    """
    if cell not in CELLS:
        raise ValueError(f"fibre_matrix: cell = {cell!r} must be one of {CELLS}")
    centres = np.full((1, 2), size / 2) if centres is None else np.asarray(centres, dtype=float)
    _check(centres, radius, size)
    with model("fibre_matrix") as gmsh_model:
        if comm.rank == 0:
            _geometry(gmsh_model, 1.0, radius / size, centres / size)
            one_size(element_size / size)
            generate_cells(gmsh_model, cell)
        return distribute(gmsh_model, comm, 2, unit=size)


def random_fibres(
    count: int,
    fraction: float,
    size: float = 1.0,
    spacing: float = 0.25,
    margin: float = 0.25,
    seed: int = 0,
    tries: int = 20000,
) -> tuple[NDArray[np.float64], float]:
    """Centres (count, 2) and radius [mm] of equal fibres at random positions, none cut by the
    sides.

    Fibres are placed one after another; if one does not fit, the cell is restarted. For low
    fractions this is more random than :func:`pack`, which leaves fibres side by side.

    Args:
        count: Number of fibres.
        fraction: Area fraction of the fibres.
        size: Side of the square [mm].
        spacing: Least distance between two fibres, in radii.
        margin: Least distance to the sides, in radii.
        seed: Random seed: the same seed gives the same positions, on every rank.
        tries: Placements before giving up.

    Raises:
        ValueError: the fibres do not fit.
    """
    radius = size * math.sqrt(fraction / (count * math.pi))
    low = (1 + margin) * radius
    generator = np.random.default_rng(seed)
    centres: list[NDArray[np.float64]] = []
    misses = 0
    for _ in range(tries if 2 * low < size else 0):
        drop = generator.uniform(low, size - low, 2)
        if all(np.linalg.norm(drop - other) >= (2 + spacing) * radius for other in centres):
            centres.append(drop)
        else:
            misses += 1
        if len(centres) == count:
            return np.array(centres), radius
        if misses > 50 * count:
            centres, misses = [], 0
    raise ValueError(
        f"random_fibres: no place for {count} fibres of radius {radius:.4g} mm in {tries} tries; "
        "lower fraction, spacing or margin"
    )


def _check(centres: NDArray[np.float64], radius: float, size: float) -> None:
    if centres.ndim != 2 or centres.shape[1] != 2 or len(centres) == 0:
        raise ValueError(f"fibre_matrix: centres have shape {centres.shape}: it must be (n, 2)")
    if not (centres > radius).all() or not (centres < size - radius).all():
        raise ValueError(
            f"fibre_matrix: a fibre of radius {radius} leaves the square of side {size}"
        )
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1) + 2 * size * np.eye(len(centres))
    if not (apart > 2 * radius).all():
        raise ValueError(f"fibre_matrix: two fibres are {apart.min():.4g} apart and overlap")


def _geometry(gmsh_model: Any, size: float, radius: float, centres: NDArray[np.float64]) -> None:
    occ = gmsh_model.occ
    square = (2, occ.addRectangle(0, 0, 0, size, size))
    discs = [(2, occ.addDisk(x, y, 0, radius, radius)) for x, y in centres]
    middles = [(0, occ.addPoint(x, size / 2, 0)) for x in (0, size)]
    _, made = occ.fragment([square], discs + middles)
    occ.synchronize()
    fibres = [tag for pieces in made[1 : 1 + len(discs)] for dim, tag in pieces if dim == 2]
    matrix = [tag for dim, tag in made[0] if dim == 2 and tag not in fibres]
    around = gmsh_model.getBoundary([(2, tag) for tag in fibres], oriented=False)
    interface = [abs(tag) for _, tag in around]
    sides: dict[int, list[int]] = {LEFT: [], RIGHT: [], BOTTOM: [], TOP: []}
    for _, curve in gmsh_model.getBoundary([(2, tag) for tag in fibres + matrix], combined=True):
        x, y, _ = occ.getCenterOfMass(1, abs(curve))
        distance = {LEFT: x, RIGHT: size - x, BOTTOM: y, TOP: size - y}
        sides[min(distance, key=distance.__getitem__)].append(abs(curve))
    for tag, surfaces in ((FIBRE, fibres), (MATRIX, matrix)):
        gmsh_model.addPhysicalGroup(2, surfaces, tag)
    for tag, curves in {**sides, INTERFACE: interface}.items():
        gmsh_model.addPhysicalGroup(1, curves, tag)
    name_groups(gmsh_model, 2, _BODIES)
    name_groups(gmsh_model, 1, _SIDES)


def generate_cells(gmsh_model: Any, cell: str) -> None:
    """Mesh a plane model with "triangle" or "quadrilateral" cells; rank 0 only."""
    options = {"MeshSizeFromPoints": 0, "MeshSizeFromCurvature": 0, "MeshSizeExtendFromBoundary": 0}
    _set(options | {"Algorithm": 6})
    if cell == "triangle":
        gmsh_model.mesh.generate(2)
        return
    # Full-quad recombination may leave a triangle or a flat cell, and less often so may subdivision
    # of a mesh of twice the size: use the best of the three.
    halves = {"MeshSizeFactor": 2, "RecombinationAlgorithm": 1, "SubdivisionAlgorithm": 1}
    attempts = [{"RecombinationAlgorithm": 2}, {"RecombinationAlgorithm": 3}, halves]
    quality = []
    for attempt in attempts:
        _recombine(gmsh_model, attempt)
        types, cells, _ = gmsh_model.mesh.getElements(2)
        worst = min(min(gmsh_model.mesh.getElementQualities(tags, "minSICN")) for tags in cells)
        quality.append(worst if len(types) == 1 else -1.0)
    if max(quality) <= 0:
        raise RuntimeError("gmsh could not make good quadrilaterals; use smaller cells")
    _recombine(gmsh_model, attempts[int(np.argmax(quality))])


def _recombine(gmsh_model: Any, options: dict[str, int]) -> None:
    _set({"RecombineAll": 1, "MeshSizeFactor": 1, "SubdivisionAlgorithm": 0} | options)
    gmsh_model.mesh.clear()
    gmsh_model.mesh.generate(2)


def _set(options: Mapping[str, float]) -> None:
    for name, value in options.items():
        gmsh.option.setNumber(f"Mesh.{name}", value)
