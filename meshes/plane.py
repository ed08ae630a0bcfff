"""The plane of a 2D mesh, rotated into z = 0 without projection."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Height of a plane mesh relative to its longest side that counts as rounding. Single-precision
#: files have 1e-7; a plane tilted by this loses 1e-12 of its area.
FLAT = 1e-6

#: A plane: the two spatial axes that become x and y, as letters or as vectors.
Plane = str | Sequence[Sequence[float]]


def turn(gmsh_model: Any, gdim: int, plane: Plane | None) -> None:
    """Rotate a 2D gmsh mesh from its plane into z = 0; no action if ``plane`` is None."""
    if gdim != 2:
        if plane is not None:
            raise ValueError(f"plane={plane!r} is for 2D meshes, and this one is 3D")
        return
    axes = np.eye(3) if plane is None else _axes(plane)
    found = [gmsh_model.mesh.getElements(2, entity)[2] for _, entity in gmsh_model.getEntities(2)]
    cells = np.concatenate([np.zeros(0, np.uint64), *(nodes for kinds in found for nodes in kinds)])
    tags, x, _ = gmsh_model.mesh.getNodes()
    x = x.reshape(-1, 3)[np.isin(tags, cells)]
    if not len(x):
        return
    sides = np.ptp(x @ axes.T, axis=0)
    if sides[2] > FLAT * sides.max():
        raise ValueError(_not_flat(x, sides[2], plane))
    if plane is not None:
        affine = np.column_stack([axes, np.zeros(3)])
        gmsh_model.mesh.affineTransform(affine.ravel().tolist())


def _axes(plane: Plane) -> NDArray[np.float64]:
    """Axes of the mesh in space (3, 3), orthonormal; the first is the first one given."""
    unit = dict(zip("xyz", np.eye(3), strict=True))
    given = [unit.get(axis) for axis in plane] if isinstance(plane, str) else plane
    try:
        first, second = np.array(given, dtype=float).reshape(2, 3)
    except (TypeError, ValueError):
        first = second = np.zeros(3)
    normal = np.cross(first, second)
    lengths = np.linalg.norm([first, second, normal], axis=1)
    if not lengths[2] > FLAT * lengths[0] * lengths[1]:
        raise ValueError(
            f"plane={plane!r} is not a plane: give the spatial axes that become x and y, as 'xz', "
            "or as two vectors, ((1, 0, 0), (0, 0.6, 0.8))"
        )
    first, normal = first / lengths[0], normal / lengths[2]
    return np.array([first, np.cross(normal, first), normal])


def _not_flat(x: NDArray[np.float64], height: float, plane: Plane | None) -> str:
    """Message that nodes (n, 3) do not lie in the plane, with the plane in which they do."""
    where = "in z" if plane is None else f"across plane={plane!r}"
    said = f"the nodes of the 2D mesh differ by {height:g} {where} and are not projected; "
    axes = np.linalg.svd(x - x.mean(axis=0), full_matrices=False)[2]
    off = np.ptp(x @ axes[2])
    if off > FLAT * np.ptp(x @ axes[0]):
        return said + (
            f"they lie in no plane (the nearest is {off:g} away): this is a surface in space, but "
            "vmdg supports plane and 3D bodies only: mesh the volume"
        )
    normal = np.abs(axes[2])
    if normal.max() > 1 - FLAT**2 / 8:
        return said + f"plane={('yz', 'xz', 'xy')[int(normal.argmax())]!r} maps them to x and y"
    level = np.cross((0.0, 0.0, 1.0), axes[2])
    level /= np.linalg.norm(level)
    level *= np.sign(level[np.abs(level).argmax()])
    up = np.cross(axes[2], level)
    up *= np.sign(up[2])
    pair = ", ".join(
        f"({', '.join(f'{round(value, 12) + 0:.12g}' for value in v)})" for v in (level, up)
    )
    return said + f"plane=({pair}) maps them to x and y"
