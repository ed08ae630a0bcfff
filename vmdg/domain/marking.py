"""Cells marked by a level set, where a mesh has no groups of its own."""

from __future__ import annotations

import numpy as np
from dolfinx.mesh import Mesh, MeshTags, meshtags

from ..base.parallel import global_any, global_max
from .tags import Group, NamedTags, group_tag, names_of
from .topology import LevelSet, cells_inside, tags_of_cells


def split_cells(
    mesh: Mesh,
    level_set: LevelSet,
    name: str = "inside",
    cell_tags: MeshTags | None = None,
    group: Group | None = None,
) -> NamedTags:
    """Cells where a level set is negative as a group of their own; collective.

    The mesh is not cut: a cell is inside where the level set is negative at its midpoint.

    Args:
        mesh: The mesh.
        level_set: phi(x) at points x (3, n) [mm], n values.
        name: Of the new group. Its tag is one more than the largest there is.
        cell_tags: Tags so far; None for one group "outside" of tag 1.
        group: Tag or name of the cells that are split; None for all.

    Returns:
        Tags of all cells.

    Raises:
        ValueError: no cell of the group has its midpoint inside, the name is taken, or the level
            set does not give one number a point.
    """
    if cell_tags is None:
        number = mesh.topology.index_map(mesh.topology.dim)
        values = np.ones(number.size_local + number.num_ghosts, dtype=np.int32)
        names = {"outside": 1}
    else:
        values, names = tags_of_cells(mesh, cell_tags), names_of(cell_tags)
    if name in names:
        raise ValueError(f"split_cells: there is a group {name!r} already; give another name=")
    inside = cells_inside(mesh, level_set)
    if group is not None:
        inside &= values == group_tag(group, names, "split_cells")
    if not global_any(mesh.comm, bool(inside.any())):
        raise ValueError(
            "split_cells: the level set is negative at no midpoint of the cells; check its sign "
            "and units, or refine the mesh"
        )
    tag = int(global_max(mesh.comm, int(values.max(initial=0)))) + 1
    values[inside] = tag
    tags = meshtags(mesh, mesh.topology.dim, np.arange(len(values), dtype=np.int32), values)
    return NamedTags(tags, names | {name: tag})
