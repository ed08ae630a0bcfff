"""Sections of bodies of revolution that the axisymmetric tests share."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
from scenes import MATERIALS, distort

import vmdg
from vmdg.meshes import TaggedMesh, blocks

#: Facet tags of a section: the inner surface (or the axis), the outer one, the two ends.
INNER, OUTER, INTERFACE, BOTTOM, TOP = 1, 2, 3, 4, 5
PRECISE = vmdg.SolveOptions(relative_tolerance=1e-12)


def section(
    comm: MPI.Comm,
    cell: str = "quadrilateral",
    divisions: Sequence[int] = (2, 2),
    radii: tuple[float, float, float] = (0.0, 1.0, 2.0),
    height: float = 1.0,
    top: float | None = None,
    distortion: float = 0.0,
) -> TaggedMesh:
    """Body 1 [r_0, r_1] and body 2 [r_1, r_2] x [0, height].

    Args:
        comm: Communicator.
        cell: "triangle" or "quadrilateral".
        divisions: Cells along r of each body and along z.
        radii: r_0, r_1, r_2 [mm].
        height: [mm].
        top: Radius of the interface at the top, for a cone; default r_1 [mm].
        distortion: Of the nodes inside of the two bodies, within their common rectangle [mm].
    """
    inner, middle, outer = radii
    upper = middle if top is None else top
    scene = blocks(
        comm,
        cell,
        divisions,
        length=outer - inner,
        height=height,
        interface=(middle - inner, upper - inner),
    )
    x = scene.mesh.geometry.x
    x[:, 0] += inner
    # Rounding of the mesher would leave nodes beside the surfaces.
    x[:, :2] = np.round(x[:, :2], 12)
    if distortion:
        before = x.copy()
        distort(scene.mesh, distortion)
        for column, ends in ((0, (inner, outer)), (1, (0.0, height))):
            edge = np.isin(before[:, column], np.round(ends, 12))
            x[edge, column] = before[edge, column]
    return scene


def revolved(
    scene: TaggedMesh,
    law: vmdg.Law,
    materials: Sequence[vmdg.Material] = MATERIALS,
    interface: dict | None = None,
    **options,
) -> vmdg.Problem:
    """Axisymmetric problem of two bodies; ``interface`` are further options of what joins them."""
    return vmdg.Problem(
        scene.mesh,
        scene.cell_tags,
        dict(enumerate(materials, start=1)),
        [vmdg.Interface(between=(1, 2), law=law, **(interface or {}))],
        symmetry="axisymmetric",
        **options,
    )


def hold(problem: vmdg.Problem, scene: TaggedMesh, *tags: int, component: str) -> None:
    """Prescribe zero for a component on surfaces."""
    for tag in tags:
        problem.dirichlet(scene.facet_tags.find(tag), 0.0, component)
