"""A quarter of a round core in a concentric ring."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import gmsh

from .gmsh_model import TaggedMesh, distribute, model, name_groups

#: Facet tags: the two planes of symmetry, the interface, the outer side.
X_AXIS, Y_AXIS, INTERFACE, OUTER = 1, 2, 3, 4

_BODIES = {"core": 1, "ring": 2}
_SIDES = {"x axis": X_AXIS, "y axis": Y_AXIS, "interface": INTERFACE, "outer": OUTER}


def core_and_ring(
    comm: MPI.Comm = MPI.COMM_WORLD,
    radius: float = 1.0,
    outer: float = 2.0,
    element_size: float = 0.2,
    outer_size: float | None = None,
    order: int = 1,
) -> TaggedMesh:
    """The quadrant x, y > 0 of a disc of ``radius`` in a ring up to ``outer``, triangles.

    Args:
        comm: Communicator.
        radius: Radius of the core [mm].
        outer: Outer radius of the ring [mm].
        element_size: In the core and at the interface [mm].
        outer_size: At the outer side [mm]; default ``element_size``.
        order: Order of the geometry: 2 approximates the circles to higher order, for degree=2.

    Returns:
        Mesh; cell tags 1 (core) and 2 (ring); facet tags 1 y = 0, 2 x = 0, 3 interface, 4 outer.

    Raises:
        ValueError: the radii do not ascend.
    """
    if not 0 < radius < outer:
        raise ValueError(f"core_and_ring: needs 0 < radius = {radius} < outer = {outer}")
    with model("core_and_ring") as gmsh_model:
        if comm.rank == 0:
            lengths = (radius, outer, element_size, outer_size or element_size)
            _build(gmsh_model, *(length / outer for length in lengths))
            gmsh_model.mesh.setOrder(order)
        return distribute(gmsh_model, comm, 2, unit=outer)


def _build(gmsh_model: Any, radius: float, outer: float, size: float, outer_size: float) -> None:
    geo = gmsh_model.geo
    centre = geo.addPoint(0, 0, 0, size)
    lengths = ((radius, size), (outer, outer_size))
    right = [geo.addPoint(r, 0, 0, s) for r, s in lengths]
    up = [geo.addPoint(0, r, 0, s) for r, s in lengths]
    arcs = [geo.addCircleArc(a, centre, b) for a, b in zip(right, up, strict=True)]
    bottom = [geo.addLine(centre, right[0]), geo.addLine(*right)]
    left = [geo.addLine(centre, up[0]), geo.addLine(*up)]
    core = geo.addPlaneSurface([geo.addCurveLoop([bottom[0], arcs[0], -left[0]])])
    ring = geo.addPlaneSurface([geo.addCurveLoop([bottom[1], arcs[1], -left[1], -arcs[0]])])
    geo.synchronize()
    for tag, face in enumerate((core, ring), start=1):
        gmsh_model.addPhysicalGroup(2, [face], tag)
    for tag, side in enumerate((bottom, left, arcs[:1], arcs[1:]), start=X_AXIS):
        gmsh_model.addPhysicalGroup(1, side, tag)
    name_groups(gmsh_model, 2, _BODIES)
    name_groups(gmsh_model, 1, _SIDES)
    gmsh.option.setNumber("Mesh.Algorithm", 6)
    gmsh_model.mesh.generate(2)
