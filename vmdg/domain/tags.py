"""Groups of cells and facets by name, from mesh generators or from a level set."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from dolfinx.mesh import Mesh, MeshTags, meshtags
from numpy.typing import NDArray

from ..base.parallel import global_any, global_max
from ..base.words import near
from .topology import LevelSet, cells_inside, tags_of_cells

#: A group by its tag or by its name.
Group = int | str

Value = TypeVar("Value")


class NamedTags(MeshTags):
    """Tags of cells or facets whose groups have names: ``facet_tags.find("left")``.

    It is used as any ``dolfinx.mesh.MeshTags``. Where a problem has named tags of its cells, every
    cell tag may be given by its name: materials, ``Interface(between=("fibre", "matrix"))``, body
    forces and eigenstrains.

    Args:
        tags: The tags.
        names: Tag by name.

    Attributes:
        names: Tag by name.
    """

    def __init__(self, tags: MeshTags, names: Mapping[str, int]):
        super().__init__(tags._cpp_object)
        self.names = {name: int(tag) for name, tag in names.items()}

    def __repr__(self) -> str:
        return f"<NamedTags: {', '.join(f'{name} ({tag})' for name, tag in self.names.items())}>"

    def find(self, value: Group) -> NDArray[np.int32]:
        """Local entities of a group.

        Args:
            value: Its tag or its name.

        Raises:
            ValueError: there is no group of this name; the message lists those there are.
        """
        if isinstance(value, str) and not self.names:
            raise ValueError(
                f"find: this mesh has no named group of dimension {self.dim}, so none is called "
                f"{value!r}; give it one in gmsh, addPhysicalGroup({self.dim}, [...], "
                f"name={value!r}), or select by place, "
                "problem.dirichlet(lambda x: np.isclose(x[0], 0.0), ...)"
            )
        return super().find(group_tag(value, self.names, "find"))


def names_of(tags: MeshTags) -> dict[str, int]:
    return getattr(tags, "names", {})


def group_tag(group: Group, names: Mapping[str, int], what: str) -> int:
    if not isinstance(group, str):
        return group
    if group in names:
        return names[group]
    if not names:
        raise ValueError(
            f"{what}: the groups of this mesh have no names, so there is none called {group!r}; "
            "give the number of its tag, or name the physical groups in gmsh (setPhysicalName)"
        )
    known = ", ".join(f"{name!r} ({tag})" for name, tag in names.items())
    raise ValueError(
        f"{what}: no group is called {group!r}; the mesh has {known}{near(group, names)}"
    )


def by_tag(values: Mapping[Group, Value], names: Mapping[str, int], what: str) -> dict[int, Value]:
    result: dict[int, Value] = {}
    for group, value in values.items():
        tag = group_tag(group, names, what)
        if tag in result:
            raise ValueError(f"{what}: {group!r} is tag {tag}, which has a value already")
        result[tag] = value
    return result


def split_cells(
    mesh: Mesh,
    level_set: LevelSet,
    name: str = "inside",
    cell_tags: MeshTags | None = None,
    group: Group | None = None,
) -> NamedTags:
    """Make the cells in which a level set is negative a group of their own; collective.

    The mesh is not cut: a cell is inside where the level set is negative at its midpoint.

    Args:
        mesh: The mesh.
        level_set: phi(x) at points x (3, n) [mm], n values.
        name: Name of the new group. Its tag is the largest existing one plus 1.
        cell_tags: Tags so far; None for one group "outside" of tag 1.
        group: Tag or name of the cells to split; None for all.

    Returns:
        Tags of all cells.

    Raises:
        ValueError: no cell of the group has its midpoint inside, the name is taken, or the level
            set does not return one number per point.
        TypeError: the name is not a word, or the level set is not a function.
    """
    if cell_tags is None:
        number = mesh.topology.index_map(mesh.topology.dim)
        values = np.ones(number.size_local + number.num_ghosts, dtype=np.int32)
        names = {"outside": 1}
    else:
        values, names = tags_of_cells(mesh, cell_tags), names_of(cell_tags)
    if not isinstance(name, str):
        raise TypeError(
            f"split_cells: name = {name!r} must be a word; the tag is chosen automatically"
        )
    if name in names:
        raise ValueError(f"split_cells: there is a group {name!r} already; give another name=")
    inside = cells_inside(mesh, level_set)
    if group is not None:
        inside &= values == group_tag(group, names, "split_cells")
    if not global_any(mesh.comm, bool(inside.any())):
        raise ValueError(
            "split_cells: the level set is negative at no cell midpoint; check its sign and units, "
            "or refine the mesh"
        )
    tag = int(global_max(mesh.comm, int(values.max(initial=0)))) + 1
    values[inside] = tag
    tags = meshtags(mesh, mesh.topology.dim, np.arange(len(values), dtype=np.int32), values)
    return NamedTags(tags, names | {name: tag})
