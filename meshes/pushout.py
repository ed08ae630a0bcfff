"""The fibre push-out of section 7.4: a quarter of fibre and matrix in 3D, or their half section."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from mpi4py import MPI

from .gmsh_model import TaggedMesh, distribute, model

#: Radii of the fibre, of the hole in the support, and of the matrix, and their height [mm].
RADII, HEIGHT = (0.95, 1.025, 4.3), 5.36

#: Facet tags 1, 2, ...; the bottom of the matrix is the support, and the hole.
SIDES = ("fibre top", "fibre bottom", "matrix top", "support", "hole", "interface", "outer")
SIDES += ("symmetry x", "symmetry y")


def pushout_section(
    comm: MPI.Comm = MPI.COMM_WORLD,
    layers: int = 25,
    fibre_cells: int = 8,
    hole_cells: int = 1,
    matrix_cells: int = 14,
    height: float = HEIGHT,
) -> TaggedMesh:
    """Half section x = r, y = z of a fibre in a matrix, supported by a plate with a hole.

    Structured quadrilaterals; those at the axis and at the outer surface are 10 times as wide as
    those next to the interface and to the rim of the hole.

    Args:
        comm: Communicator.
        layers: Cells along z.
        fibre_cells: Cells along r in the fibre.
        hole_cells: Cells along r in the matrix above the hole.
        matrix_cells: Cells along r in the rest of the matrix.
        height: H [mm].

    Returns:
        Mesh; cell tags 1 (fibre) and 2 (matrix); facet tags 1 fibre top (z = H), 2 fibre bottom,
        3 matrix top, 4 support (matrix bottom beyond the hole), 5 hole (matrix bottom above it),
        6 interface, 7 outer surface.

    Raises:
        ValueError: a count below one.
    """
    radii, counts = (0.0, *RADII), (fibre_cells, hole_cells, matrix_cells)
    _check("pushout_section", layers, *counts)
    ratios = [ratio ** (1 / max(n - 1, 1)) for ratio, n in zip((0.1, 1, 10), counts, strict=True)]
    with model("section") as scene:
        if comm.rank == 0:
            geo, rows = scene.geo, []
            for z in (0.0, height):
                rows.append([geo.addPoint(r, z, 0) for r in radii])
            upright = [geo.addLine(*ends) for ends in zip(*rows, strict=True)]
            low, high = ([geo.addLine(*ends) for ends in pairwise(row)] for row in rows)
            for line in upright:
                geo.mesh.setTransfiniteCurve(line, layers + 1)
            faces = []
            for i, (count, ratio) in enumerate(zip(counts, ratios, strict=True)):
                for line in (low[i], high[i]):
                    geo.mesh.setTransfiniteCurve(line, count + 1, "Progression", ratio)
                faces.append(_filled(geo, [low[i], upright[i + 1], -high[i], -upright[i]]))
            geo.synchronize()
            sides = (high[:1], low[:1], high[1:], low[2:], low[1:2], upright[1:2], upright[3:])
            _name(scene, 2, (faces[:1], faces[1:]), sides)
            scene.mesh.generate(2)
        return distribute(scene, comm, 2)


def pushout(
    comm: MPI.Comm = MPI.COMM_WORLD,
    layers: int = 25,
    around: int = 12,
    fibre_rings: int = 4,
    hole_rings: int = 2,
    matrix_rings: int = 31,
) -> TaggedMesh:
    """A quarter of fibre and matrix, of hexahedra in layers along z; the fibre is loaded at z = H.

    The fibre's section has a square core of (around / 2)^2 cells inside ``fibre_rings`` rings. The
    rings of the matrix beyond the hole grow outwards in proportion to their radius. The default
    counts give 2,100 cells in the fibre and 9,900 in the matrix (the report: 2,125 and 9,775).

    Args:
        comm: Communicator; ranks own slabs across the axis, with bodies and interface in balance.
        layers: Cells along z.
        around: Cells along a quarter of the interface, even.
        fibre_rings: Cells along the radius in the fibre outside the core.
        hole_rings: Cells along the radius in the matrix over the hole.
        matrix_rings: Cells along the radius in the matrix over the support.

    Returns:
        Mesh; tags as of :func:`pushout_section`, and facet tags 8 and 9 of the symmetry planes
        x = 0 and y = 0.

    Raises:
        ValueError: a count below one, or ``around`` is not even.
    """
    _check("pushout", layers, around // 2, fibre_rings, hole_rings, matrix_rings)
    if around % 2:
        raise ValueError(f"pushout: around = {around} must be even")
    rings = (
        (fibre_rings, 1.0),
        (hole_rings, 1.0),
        (matrix_rings, (RADII[2] / RADII[1]) ** (1 / matrix_rings)),
    )
    with model("quarter") as scene:
        if comm.rank == 0:
            geo, r = scene.geo, RADII[0]

            def curve(line: int, count: int, ratio: float = 1.0) -> int:
                geo.mesh.setTransfiniteCurve(line, count + 1, "Progression", ratio)
                return line

            centre = geo.addPoint(0, 0, 0)
            # The core bulges so that the rings around it have nearly equal width.
            corners = [[(0.5 * r, 0.0), (0.4 * r, 0.4 * r), (0.0, 0.5 * r)]]
            corners += [[(R, 0), (R / 2**0.5, R / 2**0.5), (0, R)] for R in RADII]
            rows = [[geo.addPoint(*place, 0) for place in row] for row in corners]
            arcs = [[geo.addLine(*ends) for ends in pairwise(rows[0])]]
            arcs += [[geo.addCircleArc(a, centre, b) for a, b in pairwise(row)] for row in rows[1:]]
            for arc in (arc for row in arcs for arc in row):
                curve(arc, around // 2)
            axes = [curve(geo.addLine(centre, rows[0][i]), around // 2) for i in (0, 2)]
            faces = [[_filled(geo, [axes[0], *arcs[0], -axes[1]])]]
            for n, ring in enumerate(rings):
                ends = zip(rows[n], rows[n + 1], strict=True)
                spokes = [curve(geo.addLine(*pair), *ring) for pair in ends]
                loops = [[spokes[i], arcs[n + 1][i], -spokes[i + 1], -arcs[n][i]] for i in (0, 1)]
                faces.append([_filled(geo, loop) for loop in loops])
            parts = [
                [geo.extrude([(2, f)], 0, 0, HEIGHT, [layers], recombine=True) for f in ring]
                for ring in ([*faces[0], *faces[1]], faces[2], faces[3])
            ]
            geo.synchronize()
            # The end and the body of every part.
            tops, solids = ([[made[i][1] for made in ring] for ring in parts] for i in (0, 1))
            tops[1:], solids[1:] = [tops[1] + tops[2]], [solids[1] + solids[2]]
            around_bodies = [
                {abs(tag) for _, tag in scene.getBoundary([(3, tag) for tag in body])}
                for body in solids
            ]
            bottom = [faces[0] + faces[1], faces[3], faces[2]]
            ends = {tag for group in (*tops, *bottom) for tag in group}
            outer: list[list[int]] = [[], [], []]
            for tag in (around_bodies[0] ^ around_bodies[1]) - ends:
                x, y = (scene.getBoundingBox(2, tag)[i::3] for i in (0, 1))
                flat = [max(map(abs, extent)) < 1e-6 * HEIGHT for extent in (x, y)]
                outer[flat.index(True) + 1 if any(flat) else 0].append(tag)
            interface = sorted(around_bodies[0] & around_bodies[1])
            sides = (tops[0], bottom[0], tops[1], *bottom[1:], interface, *outer)
            _name(scene, 3, solids, sides)
            scene.mesh.generate(3)
        # Cut across the axis every rank has its share of the bodies and of the interface.
        return distribute(scene, comm, 3, slabs_along=2)


def _check(scene: str, *counts: int) -> None:
    if min(counts) < 1:
        raise ValueError(f"{scene}: numbers of cells {counts} must be at least 1")


def _filled(geo: Any, loop: list[int]) -> int:
    face = geo.addPlaneSurface([geo.addCurveLoop(loop)])
    geo.mesh.setTransfiniteSurface(face)
    geo.mesh.setRecombine(2, face)
    return face


def _name(scene: Any, dim: int, bodies: Sequence, sides: Sequence) -> None:
    for d, groups, names in ((dim, bodies, ("fibre", "matrix")), (dim - 1, sides, SIDES)):
        for tag, (group, name) in enumerate(zip(groups, names, strict=False), start=1):
            scene.addPhysicalGroup(d, group, tag, name)
