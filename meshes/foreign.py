"""Meshes that meshio reads: VTK, MED, XDMF of meshio, Nastran, Medit and others."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from dolfinx.cpp.io import perm_gmsh, perm_vtk
from dolfinx.mesh import CellType
from numpy.typing import NDArray

from .arrays import HEXAHEDRON_20, Block, MeshArrays, only_cells_and_facets, rows_of

#: Cell types by their name in meshio: gmsh type, DOLFINx cell.
_KINDS = {
    "line": (1, CellType.interval),
    "line3": (8, CellType.interval),
    "triangle": (2, CellType.triangle),
    "triangle6": (9, CellType.triangle),
    "quad": (3, CellType.quadrilateral),
    "quad8": (16, None),
    "quad9": (10, CellType.quadrilateral),
    "tetra": (4, CellType.tetrahedron),
    "tetra10": (11, CellType.tetrahedron),
    "hexahedron": (5, CellType.hexahedron),
    "hexahedron20": (17, None),
    "hexahedron27": (12, CellType.hexahedron),
    "wedge": (6, None),
    "wedge15": (18, None),
    "pyramid": (7, None),
    "pyramid13": (19, None),
}

#: meshio data in which 0 is not a tag.
_PHYSICAL = "gmsh:physical"


def meshio() -> ModuleType:
    lacking = [name for name in ("meshio", "h5py") if find_spec(name) is None]
    if lacking:
        raise ImportError(
            f"this file is read by meshio, but there is no {' and no '.join(lacking)}: pip install "
            "'vmdg[mesh]', or pip install meshio h5py"
        )
    import meshio

    return meshio


def endings() -> tuple[str, ...]:
    return tuple(sorted(meshio().extension_to_filetypes))


def read_foreign(
    path: Path, cell_tags: str | None, facet_tags: str | None, form: str | None = None
) -> MeshArrays:
    """The mesh of a file; groups are sets of cells and facets, or integer data of them."""
    mesh = _read(path, form)
    points = np.zeros((len(mesh.points), 3))
    points[:, : mesh.points.shape[1]] = mesh.points
    sets = _sets(mesh)
    blocks = []
    for number, cells in enumerate(mesh.cells):
        if cells.type == "vertex":
            continue
        kind, nodes = _in_gmsh_order(cells.type, cells.data)
        blocks.append(Block(cells.dim, kind, nodes, 0, number + 1))
    if any(((b.nodes < 0) | (b.nodes >= len(points))).any() for b in blocks):
        raise ValueError("its cells have nodes that do not exist; is it complete?")
    bare = only_cells_and_facets(MeshArrays(points, blocks, {}))
    tagged: list[Block] = []
    names: dict[int, dict[str, int]] = {}
    shift = 0
    for dim, wanted in ((bare.dim, cell_tags), (bare.dim - 1, facet_tags)):
        there = bare.of(dim)
        name = None if sets and not wanted else _data(mesh, there, wanted, cell_tags)
        if name is not None:
            data = [np.ravel(mesh.cell_data[name][block.entity - 1]) for block in there]
            if dim == bare.dim and name != _PHYSICAL:  # in which 0 is not a tag, as for facets
                shift = max(1 - min(int(values.min(initial=1)) for values in data), 0)
            for block, values in zip(there, data, strict=True):
                tagged += _by_tag(block, values, shift if dim == bare.dim else 0)
        else:
            in_sets, names[dim] = _by_set(there, sets)
            tagged += in_sets
    both = {dim: names.get(dim, {}) for dim in (bare.dim, bare.dim - 1)}
    nodes = {name: np.asarray(one, dtype=np.int64) for name, one in mesh.point_sets.items()}
    return MeshArrays(points, tagged, both, shift, nodes)


def _read(path: Path, form: str | None) -> Any:
    """Read by meshio, which on errors prints a message and exits the process."""
    library, said = meshio(), io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            mesh = library.read(path, form)
    except ModuleNotFoundError as error:
        raise ValueError(
            f"meshio reads this format by {error.name}, which is not installed: pip install "
            f"{error.name}; or write the file as .vtu, .med, .inp or .msh"
        ) from None
    except (Exception, SystemExit) as error:  # readers may raise anything
        if isinstance(error, MemoryError):
            raise
        words = " ".join(said.getvalue().split()) or f"{type(error).__name__}: {error}"
        raise ValueError(
            f"meshio cannot read it ({words}); is it complete, and is its suffix right?"
        ) from None
    if not len(mesh.points) or not mesh.cells:
        raise ValueError("it has no cells")
    return mesh


def _in_gmsh_order(name: str, nodes: NDArray[np.int64]) -> tuple[int, NDArray[np.int64]]:
    if name not in _KINDS:
        raise ValueError(
            f"it has cells of type {name}; vmdg supports triangles, quadrilaterals, tetrahedra and "
            "hexahedra of degree 1 and 2"
        )
    kind, cell = _KINDS[name]
    if cell is None:  # completed, or refused where their position is known, or flat
        order = HEXAHEDRON_20 if name == "hexahedron20" else slice(None)
        return kind, np.asarray(nodes, dtype=np.int64)[:, order]
    result = np.empty(nodes.shape, dtype=np.int64)
    count = nodes.shape[1]
    result[:, perm_gmsh(cell, count)] = nodes[:, perm_vtk(cell, count)]
    return kind, result


def _sets(mesh: Any) -> dict[str, list[NDArray[np.int64]]]:
    """Members in every block, by name; families of MED are sets too."""
    sets = {
        name: [np.asarray([] if of is None else of, dtype=np.int64) for of in members]
        for name, members in mesh.cell_sets.items()
        if ":" not in name  # sets of meshio's own
    }
    families = getattr(mesh, "cell_tags", {})
    for name in dict.fromkeys(name for names in families.values() for name in names):
        members = [family for family, names in families.items() if name in names]
        sets[name] = [
            np.flatnonzero(np.isin(values, members)) for values in mesh.cell_data["cell_tags"]
        ]
    return sets


def _data(mesh: Any, blocks: list[Block], wanted: str | None, of_cells: str | None) -> str | None:
    """Name of the data used as tags of these blocks; None where there are none."""
    data = {
        name: np.concatenate([np.asarray(values[block.entity - 1]) for block in blocks])
        for name, values in mesh.cell_data.items()
        # Families of MED are numbers of its sets.
        if blocks and not (name == "cell_tags" and hasattr(mesh, "cell_tags"))
    }
    numbers = {name: values for name, values in data.items() if values.size == len(values)}
    if wanted in numbers and np.array_equal(numbers[wanted], np.round(numbers[wanted])):
        return wanted
    whole = [name for name, of in numbers.items() if np.issubdtype(of.dtype, np.integer)]
    if wanted is not None and blocks:
        raise ValueError(
            f"it has no tags {wanted!r}; its integer cell data are "
            f"{', '.join(map(repr, whole)) or 'none'}"
        )
    for name in (of_cells, _PHYSICAL):
        if name in whole:
            return name
    if len(whole) > 1:
        raise ValueError(
            f"it has several data sets that may be tags, {', '.join(map(repr, whole))}: choose "
            f"one, cell_tags={whole[0]!r}"
        )
    return whole[0] if whole else None


def _by_tag(block: Block, values: NDArray, shift: int) -> Iterator[Block]:
    """A block for every tag; 0 and below mean no group."""
    tags = np.maximum(values.astype(np.int64) + shift, 0)
    if tags.max(initial=0) > np.iinfo(np.int32).max:
        raise ValueError(f"its tags are as large as {tags.max()}; they must be below 2^31")
    for tag, rows in rows_of(tags):
        yield block._replace(nodes=block.nodes[rows], group=tag)


def _by_set(
    blocks: list[Block], sets: dict[str, list[NDArray[np.int64]]]
) -> tuple[list[Block], dict[str, int]]:
    result, names = [], {}
    alone = {block.entity: np.full(len(block.nodes), True) for block in blocks}
    for tag, (name, members) in enumerate(sets.items(), 1):
        for block in blocks:
            there: Any = members[block.entity - 1] if block.entity <= len(members) else []
            if len(there):
                names[name] = tag
                alone[block.entity][there] = False
                result.append(block._replace(nodes=block.nodes[there], group=tag))
    result += [block._replace(nodes=block.nodes[alone[block.entity]]) for block in blocks]
    return [block for block in result if len(block.nodes)], names
