"""The r-z half section of the fibre push-out, section 7.4, for axisymmetric problems."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

from .gmsh_model import TaggedMesh, distribute, model, name_groups

#: Cell tags; the fibre has the lower one, so N of the interface points into the matrix.
FIBRE, MATRIX = 1, 2

#: Facet tags. The bottom of the matrix is SUPPORT beyond the hole and HOLE above it.
FIBRE_TOP, FIBRE_BOTTOM, MATRIX_TOP, SUPPORT, HOLE, INTERFACE, OUTER, AXIS = 1, 2, 3, 4, 5, 6, 7, 8

BODIES = {"fibre": FIBRE, "matrix": MATRIX}
SIDES = {
    "fibre top": FIBRE_TOP,
    "fibre bottom": FIBRE_BOTTOM,
    "matrix top": MATRIX_TOP,
    "support": SUPPORT,
    "hole": HOLE,
    "interface": INTERFACE,
    "outer": OUTER,
}


def pushout_section(
    comm: MPI.Comm = MPI.COMM_WORLD,
    layers: int = 25,
    fibre_cells: int = 8,
    hole_cells: int = 1,
    matrix_cells: int = 14,
    radial_ratio: float = 10.0,
    grading: float = 1.0,
    fibre_radius: float = 0.95,
    hole_radius: float = 1.025,
    matrix_radius: float = 4.3,
    height: float = 5.36,
) -> TaggedMesh:
    """Half section of a fibre in a matrix sleeve supported by a plate with a hole.

    x = r and y = z. Fibre [0, r_f], matrix [r_f, r_m], both x [0, H], in structured quadrilaterals.
    There are nodes at the rim of the hole r_s, from which outwards the bottom is supported.

    Args:
        comm: Communicator.
        layers: Cells along z.
        fibre_cells: Cells along r in the fibre.
        hole_cells: Cells along r in the matrix above the hole.
        matrix_cells: Cells along r in the rest of the matrix.
        radial_ratio: Cell size at the axis and at the outer surface relative to that next to the
            interface and the rim; sizes are in geometric progression in between.
        grading: Layer height at mid-height relative to that at both ends, in the limit of many
            layers.
        fibre_radius: r_f [mm].
        hole_radius: r_s [mm].
        matrix_radius: r_m [mm].
        height: H [mm].

    Returns:
        Mesh; cell tags 1 (fibre) and 2 (matrix); facet tags 1 fibre top (z = H), 2 fibre bottom,
        3 matrix top, 4 support (matrix bottom, r >= r_s), 5 hole (matrix bottom, r < r_s),
        6 fibre-matrix interface, 7 outer surface, 8 axis.

    Raises:
        ValueError: a count below one, a ratio or a height that is not positive, or radii that do
            not increase.
    """
    counts = (fibre_cells, hole_cells, matrix_cells)
    if min(layers, *counts) < 1:
        raise ValueError(
            f"pushout_section: layers = {layers} and cells {counts} must be at least 1"
        )
    if not all(1e-6 <= ratio <= 1e6 for ratio in (radial_ratio, grading)):
        raise ValueError(
            f"pushout_section: radial_ratio = {radial_ratio} and grading = {grading} must be "
            "positive, from 1e-6 to 1e6"
        )
    check_sizes("pushout_section", (fibre_radius, hole_radius, matrix_radius), height)
    with model("pushout_section") as gmsh_model:
        if comm.rank == 0:
            radii = [r / height for r in (0.0, fibre_radius, hole_radius, matrix_radius)]
            _build(gmsh_model, radii, 1.0, counts, layers, radial_ratio, grading)
        return distribute(gmsh_model, comm, 2, unit=height)


def check_sizes(scene: str, radii: tuple[float, float, float], height: float) -> None:
    """Raise a ValueError if r_f, r_s, r_m do not increase from 0 or H is not positive [mm]."""
    fibre, hole, matrix = radii
    if not (0 < fibre < hole < matrix and height > 0):
        raise ValueError(
            f"{scene}: the radii of fibre, hole and matrix must increase from 0, but are {fibre}, "
            f"{hole}, {matrix}, and height = {height} must be positive"
        )


def _build(
    gmsh_model: Any,
    radii: Sequence[float],
    height: float,
    counts: Sequence[int],
    layers: int,
    radial_ratio: float,
    grading: float,
) -> None:
    geo = gmsh_model.geo
    bottom = [geo.addPoint(r, 0, 0) for r in radii]
    top = [geo.addPoint(r, height, 0) for r in radii]
    upright = [geo.addLine(b, t) for b, t in zip(bottom, top, strict=True)]
    lower, upper = ([geo.addLine(row[i], row[i + 1]) for i in range(3)] for row in (bottom, top))
    for line in upright:
        # The coefficient of gmsh's Bump is the size at the ends relative to that in the middle.
        geo.mesh.setTransfiniteCurve(line, layers + 1, "Bump", 1 / grading)
    factors = (_factor(1 / radial_ratio, counts[0]), 1.0, _factor(radial_ratio, counts[2]))
    for i in range(3):
        for line in (lower[i], upper[i]):
            geo.mesh.setTransfiniteCurve(line, counts[i] + 1, "Progression", factors[i])
    faces = []
    for i in range(3):
        loop = geo.addCurveLoop([lower[i], upright[i + 1], -upper[i], -upright[i]])
        faces.append(geo.addPlaneSurface([loop]))
        geo.mesh.setTransfiniteSurface(faces[i])
        geo.mesh.setRecombine(2, faces[i])
    geo.synchronize()
    for tag, members in ((FIBRE, faces[:1]), (MATRIX, faces[1:])):
        gmsh_model.addPhysicalGroup(2, members, tag)
    sides = {
        FIBRE_TOP: upper[:1],
        FIBRE_BOTTOM: lower[:1],
        MATRIX_TOP: upper[1:],
        SUPPORT: lower[2:],
        HOLE: lower[1:2],
        INTERFACE: upright[1:2],
        OUTER: upright[3:],
        AXIS: upright[:1],
    }
    for tag, curves in sides.items():
        gmsh_model.addPhysicalGroup(1, curves, tag)
    name_groups(gmsh_model, 2, BODIES)
    name_groups(gmsh_model, 1, SIDES | {"axis": AXIS})
    gmsh_model.mesh.generate(2)


def _factor(ratio: float, cells: int) -> float:
    """Growth factor per cell by which the last one is ``ratio`` times the first."""
    return ratio ** (1 / (cells - 1)) if cells > 1 else 1.0
