"""A fibre in a matrix cylinder, for push-out along its axis: section 7.4 in 3D."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

from .gmsh_model import TaggedMesh, distribute, model, name_groups
from .pushout_section import (
    BODIES,
    FIBRE,
    FIBRE_BOTTOM,
    FIBRE_TOP,
    HOLE,
    INTERFACE,
    MATRIX,
    MATRIX_TOP,
    OUTER,
    SIDES,
    SUPPORT,
    check_sizes,
)

#: Facet tags of the planes x = 0 and y = 0, in addition to those of the section.
SYMMETRY_X, SYMMETRY_Y = 9, 10


def pushout(
    comm: MPI.Comm = MPI.COMM_WORLD,
    fibre_radius: float = 0.95,
    matrix_radius: float = 4.3,
    height: float = 5.36,
    hole_radius: float = 1.025,
    layers: int = 25,
    around: int = 12,
    fibre_rings: int = 4,
    hole_rings: int = 2,
    matrix_rings: int = 31,
    grading: float = 1.0,
    refine: int = 1,
    interface_weight: int | None = None,
) -> TaggedMesh:
    """A quarter of fibre and matrix, of hexahedra in layers along z; the fibre is loaded at z = H.

    The fibre's section has a square core of (around / 2)^2 cells inside ``fibre_rings`` rings. The
    rings of the matrix beyond the hole grow outwards in proportion to their radius. The default
    counts give 2,100 cells in the fibre and 9,900 in the matrix (the report: 2,125 and 9,775).

    Args:
        comm: Communicator.
        fibre_radius: r_f [mm].
        matrix_radius: r_m [mm].
        height: H [mm].
        hole_radius: r_s of the hole in the support [mm]: the matrix is supported beyond r_s.
        layers: Cells along z.
        around: Cells along a quarter of the interface, even.
        fibre_rings: Cells along the radius in the fibre outside the core.
        hole_rings: Cells along the radius in the matrix over the hole.
        matrix_rings: Cells along the radius in the matrix over the support.
        grading: Height of the middle layers relative to that at both ends.
        refine: Multiplies all counts: 2 gives 8 times the cells.
        interface_weight: None partitions the mesh across the axis, which balances bodies and
            interface. A number is the weight of cells at the interface for a graph partitioner.

    Returns:
        Mesh; cell tags 1 (fibre) and 2 (matrix); facet tags 1 fibre top, 2 fibre bottom, 3 matrix
        top, 4 support (matrix bottom beyond r_s), 5 matrix bottom over the hole, 6 interface,
        7 outer side, 9 and 10 the symmetry planes x = 0 and y = 0.

    Raises:
        ValueError: radii that do not increase, or counts that give no mesh.
    """
    radii = (fibre_radius, hole_radius, matrix_radius)
    check_sizes("pushout", radii, height)
    counts = (around, layers, fibre_rings, hole_rings, matrix_rings, refine)
    if around % 2 or min(counts) < 1 or not grading > 0:
        raise ValueError(
            f"pushout: counts {counts} must be positive, around = {around} even, and grading = "
            f"{grading} positive"
        )
    with model("pushout") as gmsh_model:
        if comm.rank == 0:
            rings = [refine * count for count in (fibre_rings, hole_rings, matrix_rings)]
            # Cells of a ring around the axis keep their aspect ratio if they grow with the radius.
            growth = (matrix_radius / hole_radius) ** (1 / rings[2])
            places = [radius / height for radius in radii]
            faces = _section(gmsh_model.geo, places, refine * around // 2, rings, growth)
            _sweep(gmsh_model, faces, 1.0, layer_tops(refine * layers, grading))
            gmsh_model.mesh.generate(3)
        if interface_weight is None:
            return distribute(gmsh_model, comm, 3, slabs_along=2, unit=height)
        return distribute(gmsh_model, comm, 3, interface_weight, unit=height)


def layer_tops(layers: int, grading: float) -> list[float]:
    """Heights of the layer tops relative to the total height.

    The middle layer is ``grading`` times as high as the first and the last, in geometric steps.
    """
    middle = (layers - 1) / 2
    sizes = [grading ** (1 - abs(i - middle) / max(middle, 1)) for i in range(layers)]
    total = math.fsum(sizes)
    return [math.fsum(sizes[: i + 1]) / total for i in range(layers)]


def _section(
    geo: Any, radii: Sequence[float], half: int, rings: Sequence[int], growth: float
) -> dict[str, list[int]]:
    """Faces of the quarter section at z = 0: core and rings."""
    r = radii[0]
    centre = geo.addPoint(0, 0, 0)
    # The core bulges so that the rings around it have nearly equal width.
    core = [(0.5 * r, 0.0), (0.4 * r, 0.4 * r), (0.0, 0.5 * r)]
    rows = [[geo.addPoint(x, y, 0) for x, y in core]]
    for radius in radii:
        diagonal = radius / math.sqrt(2)
        corners = [(radius, 0.0), (diagonal, diagonal), (0.0, radius)]
        rows.append([geo.addPoint(x, y, 0) for x, y in corners])

    def curve(line: int, count: int, ratio: float = 1.0) -> int:
        geo.mesh.setTransfiniteCurve(line, count + 1, "Progression", ratio)
        return line

    def face(loop: list[int]) -> int:
        surface = geo.addPlaneSurface([geo.addCurveLoop(loop)])
        geo.mesh.setTransfiniteSurface(surface)
        geo.mesh.setRecombine(2, surface)
        return surface

    axes = [curve(geo.addLine(centre, rows[0][i]), half) for i in (0, 2)]
    around = [[curve(geo.addLine(*rows[0][i : i + 2]), half) for i in range(2)]]
    for row in rows[1:]:
        arcs = [geo.addCircleArc(row[i], centre, row[i + 1]) for i in range(2)]
        around.append([curve(arc, half) for arc in arcs])
    faces = [[face([axes[0], *around[0], -axes[1]])]]
    for n, count in enumerate(rings):
        ratio = growth if n == 2 else 1.0
        spokes = [
            curve(geo.addLine(a, b), count, ratio)
            for a, b in zip(rows[n], rows[n + 1], strict=True)
        ]
        faces.append(
            [face([spokes[i], around[n + 1][i], -spokes[i + 1], -around[n][i]]) for i in range(2)]
        )
    return {"fibre": faces[0] + faces[1], "hole": faces[2], "support": faces[3]}


def _sweep(
    gmsh_model: Any, faces: dict[str, list[int]], height: float, tops: Sequence[float]
) -> None:
    """Extrude the section along z; physical groups."""
    geo = gmsh_model.geo
    volumes: dict[str, list[int]] = {}
    upper: dict[str, list[int]] = {}
    for name, surfaces in faces.items():
        for surface in surfaces:
            entities = geo.extrude(
                [(2, surface)], 0, 0, height, [1] * len(tops), tops, recombine=True
            )
            upper.setdefault(name, []).append(entities[0][1])
            volumes.setdefault(name, []).append(entities[1][1])
    geo.synchronize()

    def boundary(names: list[str]) -> set[int]:
        solids = [(3, tag) for name in names for tag in volumes[name]]
        return {abs(tag) for _, tag in gmsh_model.getBoundary(solids)}

    sides: dict[int, list[int]] = {SYMMETRY_X: [], SYMMETRY_Y: [], OUTER: []}
    ends = {tag for group in (*upper.values(), *faces.values()) for tag in group}
    for tag in boundary(list(volumes)) - ends:
        low, high = (gmsh_model.getBoundingBox(2, tag)[n::3] for n in (0, 1))
        flat = [max(map(abs, extent)) < 1e-6 * height for extent in (low, high)]
        sides[SYMMETRY_X if flat[0] else SYMMETRY_Y if flat[1] else OUTER].append(tag)
    interface = boundary(["fibre"]) & boundary(["hole", "support"])
    for tag, names in ((FIBRE, ["fibre"]), (MATRIX, ["hole", "support"])):
        gmsh_model.addPhysicalGroup(3, [v for name in names for v in volumes[name]], tag)
    groups = {
        FIBRE_TOP: upper["fibre"],
        FIBRE_BOTTOM: faces["fibre"],
        MATRIX_TOP: upper["hole"] + upper["support"],
        SUPPORT: faces["support"],
        HOLE: faces["hole"],
        INTERFACE: sorted(interface),
        **sides,
    }
    for tag, surfaces in groups.items():
        gmsh_model.addPhysicalGroup(2, surfaces, tag)
    name_groups(gmsh_model, 3, BODIES)
    name_groups(gmsh_model, 2, SIDES | {"symmetry x": SYMMETRY_X, "symmetry y": SYMMETRY_Y})
