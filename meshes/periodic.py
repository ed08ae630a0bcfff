"""Sides of a square or cube in gmsh: their entities, and matching meshes on opposite sides."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Facet tags of the sides: along x, y and z the low and the high one.
LEFT, RIGHT, BOTTOM, TOP, BACK, FRONT = 1, 2, 4, 5, 6, 7
PAIRS = ((LEFT, RIGHT), (BOTTOM, TOP), (BACK, FRONT))

SIDES = {"left": LEFT, "right": RIGHT, "bottom": BOTTOM, "top": TOP, "back": BACK, "front": FRONT}

#: Tolerance, relative to the size, for an entity on a side: gmsh rounds its boxes to 1e-7.
TOLERANCE = 1e-6

#: The same between an entity and its image.
FIT = 1e-5


def sides(gmsh_model: Any, dim: int, size: float) -> dict[int, list[int]]:
    """Entities on the sides of [0, size]^dim, by the tag of the side."""
    found: dict[int, list[int]] = {tag: [] for pair in PAIRS[:dim] for tag in pair}
    for _, entity in gmsh_model.getEntities(dim - 1):
        box = np.reshape(gmsh_model.getBoundingBox(dim - 1, entity), (2, 3)) / size
        for axis, (low, high) in enumerate(PAIRS[:dim]):
            if box[1, axis] < TOLERANCE:
                found[low].append(entity)
            elif box[0, axis] > 1 - TOLERANCE:
                found[high].append(entity)
    return found


def match_sides(gmsh_model: Any, found: dict[int, list[int]], dim: int, size: float) -> None:
    """Let gmsh copy the meshes of the low sides to the high ones."""
    for axis, pair in enumerate(PAIRS[:dim]):
        low, high = (_marks(gmsh_model, found[tag], dim, size) for tag in pair)
        high[:, [axis, 3 + axis]] -= 1
        apart = np.abs(low[:, None] - high).max(axis=2, initial=0.0)
        partner = apart.argmin(axis=1) if apart.size else np.zeros(0, dtype=int)
        if len(low) != len(high) or len(set(partner)) < len(low) or (apart.min(axis=1) > FIT).any():
            raise ValueError(
                f"the sides of the cell across axis {axis} have {len(low)} and {len(high)} pieces "
                "that do not match; a periodic cell has the same pieces on opposite sides"
            )
        shift = np.eye(4)
        shift[axis, 3] = size
        images = [found[pair[1]][p] for p in partner]
        gmsh_model.mesh.setPeriodic(dim - 1, images, found[pair[0]], shift.ravel().tolist())


def _marks(gmsh_model: Any, entities: list[int], dim: int, size: float) -> NDArray[np.float64]:
    """Bounding box of every entity and its length or square root of area, relative to the size (n,
    7)."""
    rows = [
        [
            *np.divide(gmsh_model.getBoundingBox(dim - 1, entity), size),
            (gmsh_model.occ.getMass(dim - 1, entity) ** (1 / (dim - 1))) / size,
        ]
        for entity in entities
    ]
    return np.reshape(rows, (len(rows), 7))
