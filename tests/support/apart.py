"""Bodies whose meshes share no nodes: blocks on top of each other, and bodies taken apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import (
    CellType,
    MeshTags,
    compute_midpoints,
    create_box,
    create_rectangle,
    create_submesh,
    exterior_facet_indices,
    meshtags,
)
from numpy.typing import NDArray

import vmdg
from support.scenes import DIMENSION
from vmdg.meshes import TaggedMesh, apart, distribute, model

#: Facet tags of block k are 10 k + these; the height of a block is along its last coordinate.
SIDES, BOTTOM, TOP = 0, 1, 2

Move = Callable[[NDArray], NDArray]


def block(
    cell: str,
    divisions: Sequence[int],
    low: Sequence[float],
    high: Sequence[float],
    tag: int = 1,
    comm: MPI.Comm = MPI.COMM_SELF,
) -> tuple:
    """Mesh, cell tags and facet tags of a box."""
    d = len(low)
    make = create_rectangle if d == 2 else create_box
    corners = [np.array(low, dtype=float), np.array(high, dtype=float)]
    mesh = make(comm, corners, list(divisions), CellType[cell])
    mesh.topology.create_connectivity(d - 1, d)
    facets = exterior_facet_indices(mesh.topology)
    last = compute_midpoints(mesh, d - 1, facets)[:, d - 1]
    values = np.full(len(facets), 10 * tag + SIDES, dtype=np.int32)
    values[np.isclose(last, low[-1])] += BOTTOM
    values[np.isclose(last, high[-1])] += TOP
    return mesh, all_cells(mesh, tag), meshtags(mesh, d - 1, facets, values)


def all_cells(mesh, tag: int) -> MeshTags:
    """One tag for every cell."""
    count = mesh.topology.index_map(mesh.topology.dim).size_local
    cells = np.arange(count, dtype=np.int32)
    return meshtags(mesh, mesh.topology.dim, cells, np.full(count, tag, dtype=np.int32))


def moved(part: tuple, move: Move) -> tuple:
    """The part with its nodes moved, x (d, n) -> (d, n)."""
    mesh = part[0]
    d = mesh.geometry.dim
    mesh.geometry.x[:, :d] = move(mesh.geometry.x[:, :d].T.copy()).T
    return part


def stack(
    cell: str,
    lower: int,
    upper: int,
    layers: tuple[int, int] = (2, 3),
    length: float = 2.0,
    move: Move | None = None,
    comm: MPI.Comm = MPI.COMM_SELF,
) -> TaggedMesh:
    """Block 1 below and block 2 above the height 0, each 1 mm high, with other numbers of cells
    along it.

    ``lower`` and ``upper`` cells along the length [mm] of each, in 3D also along the width.
    """
    flat = DIMENSION[cell] - 1
    zero, full = [0.0] * flat, [length] * flat
    parts = [
        block(cell, [lower] * flat + [layers[0]], [*zero, -1.0], [*full, 0.0], 1, comm),
        block(cell, [upper] * flat + [layers[1]], [*zero, 0.0], [*full, 1.0], 2, comm),
    ]
    return apart([part if move is None else moved(part, move) for part in parts])


def separated(scene: TaggedMesh) -> TaggedMesh:
    """The bodies of a mesh on one rank, each with nodes of its own; no facet tags."""
    parts = []
    for tag in np.unique(scene.cell_tags.values):
        dim = scene.mesh.topology.dim
        mesh = create_submesh(scene.mesh, dim, scene.cell_tags.find(tag))[0]
        none = np.zeros(0, dtype=np.int32)
        parts.append((mesh, all_cells(mesh, tag), meshtags(mesh, dim - 1, none, none)))
    return apart(parts)


def order_of_dofs(problem: vmdg.Problem) -> NDArray[np.intp]:
    """Dofs of a problem of bodies 1, 2, ... in an order that no numbering can change."""
    space, d = problem.space, problem.mesh.geometry.dim
    tags = np.zeros(space.dofmap.index_map.size_local)
    tags[space.dofmap.list] = problem.discretization.bodies.tags[:, None]
    x = np.round(space.tabulate_dof_coordinates()[:, :d], 9) + 0.0
    nodes = np.lexsort((*x.T, tags))
    return (nodes[:, None] * d + np.arange(d)).ravel()


def rings(
    cell: str,
    cells: tuple[int, int],
    radii: tuple[float, float, float],
    order: int = 1,
    comm: MPI.Comm = MPI.COMM_SELF,
) -> TaggedMesh:
    """Quarters of two concentric rings with other numbers of cells around, in one gmsh model.

    Cell tags 1 (inner) and 2 (outer); facet tags 10 k + 0 (planes of symmetry), 1 (inner side), 2
    (outer side) of body k.
    """
    with model("rings") as gmsh_model:
        geo, groups = gmsh_model.geo, []
        for k, (around, low, high) in enumerate(zip(cells, radii[:-1], radii[1:], strict=True), 1):
            centre = geo.addPoint(0, 0, 0)
            right, up = (
                [geo.addPoint(*at, 0) for at in ((low, 0), (high, 0))],
                [geo.addPoint(*at, 0) for at in ((0, low), (0, high))],
            )
            arcs = [geo.addCircleArc(a, centre, b) for a, b in zip(right, up, strict=True)]
            ends = [geo.addLine(*right), geo.addLine(*up)]
            face = geo.addPlaneSurface([geo.addCurveLoop([ends[0], arcs[1], -ends[1], -arcs[0]])])
            through = around // 4
            for lines, count in ((arcs, around), (ends, through)):
                for line in lines:
                    geo.mesh.setTransfiniteCurve(line, count + 1)
            geo.mesh.setTransfiniteSurface(face)
            if cell == "quadrilateral":
                geo.mesh.setRecombine(2, face)
            groups.append((k, face, (ends, arcs[:1], arcs[1:])))
        geo.synchronize()
        for k, face, sides in groups:
            gmsh_model.addPhysicalGroup(2, [face], k)
            for place, lines in enumerate(sides):
                gmsh_model.addPhysicalGroup(1, lines, 10 * k + place)
        gmsh_model.mesh.generate(2)
        gmsh_model.mesh.setOrder(order)
        return distribute(gmsh_model, comm, 2)


def full_rings(
    cell: str,
    cells: tuple[int, int],
    radii: tuple[tuple[float, float], tuple[float, float]],
    order: int = 1,
) -> TaggedMesh:
    """Two concentric rings with radii of their own, which may overlap, and facet tags as those of
    :func:`rings`."""
    with model("full rings") as gmsh_model:
        geo, groups = gmsh_model.geo, []
        for k, (around, (low, high)) in enumerate(zip(cells, radii, strict=True), 1):
            centre, angles = geo.addPoint(0, 0, 0), np.pi / 2 * np.arange(4)
            circles = []
            for r in (low, high):
                corners = [geo.addPoint(r * np.cos(a), r * np.sin(a), 0) for a in angles]
                ends = zip(corners, corners[1:] + corners[:1], strict=True)
                circles.append((corners, [geo.addCircleArc(a, centre, b) for a, b in ends]))
            (inside, inner), (outside, outer) = circles
            spokes = [geo.addLine(a, b) for a, b in zip(inside, outside, strict=True)]
            faces = [
                geo.addPlaneSurface(
                    [geo.addCurveLoop([spokes[j], outer[j], -spokes[(j + 1) % 4], -inner[j]])]
                )
                for j in range(4)
            ]
            for lines, count in ((inner + outer, around // 4), (spokes, max(around // 12, 2))):
                for line in lines:
                    geo.mesh.setTransfiniteCurve(line, count + 1)
            for face in faces:
                geo.mesh.setTransfiniteSurface(face)
                if cell == "quadrilateral":
                    geo.mesh.setRecombine(2, face)
            groups.append((k, faces, inner, outer))
        geo.synchronize()
        for k, faces, inner, outer in groups:
            gmsh_model.addPhysicalGroup(2, faces, k)
            gmsh_model.addPhysicalGroup(1, inner, 10 * k + 1)
            gmsh_model.addPhysicalGroup(1, outer, 10 * k + 2)
        gmsh_model.mesh.generate(2)
        gmsh_model.mesh.setOrder(order)
        return distribute(gmsh_model, MPI.COMM_SELF, 2)
