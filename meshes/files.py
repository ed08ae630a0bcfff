"""Meshes from files, distributed with the facet ghosts that interfaces require."""

from __future__ import annotations

import json
import mmap
from collections.abc import Callable, Collection, Iterator, Mapping
from numbers import Real
from pathlib import Path
from typing import Any, TypeVar
from xml.etree import ElementTree

from mpi4py import MPI

import basix
import basix.ufl
import gmsh
import numpy as np
import ufl
from dolfinx.io import XDMFFile
from dolfinx.mesh import Mesh, create_mesh, meshtags
from numpy.typing import NDArray

from vmdg.base.parallel import warn_together
from vmdg.base.words import checked_path
from vmdg.domain.tags import NamedTags, names_of

from .abaqus import read_abaqus
from .arrays import (
    MeshArrays,
    completed,
    count_flat,
    entities_as_groups,
    from_gmsh,
    into_gmsh,
    merged,
    one_group_each,
    places,
)
from .bounded import alone, bounded, converted
from .foreign import endings, read_foreign
from .gmsh_model import NodeSet, TaggedMesh, distribute, model, name_groups
from .partition import cell_partitioner
from .plane import Plane

#: Names of the tags in XDMF files.
CELL_TAGS, FACET_TAGS = "cell_tags", "facet_tags"

#: Value of ``groups`` that makes every geometric entity without a group a group.
ENTITIES = "entities"

#: First word, and the word after the elements, of a .msh of gmsh or Neper, in formats 1, 2 and 4.
#: gmsh executes a file that begins otherwise as a script, which may run commands.
BEGIN, END = (b"$MeshFormat", b"$NOD", b"$Comments"), (b"$EndElements", b"$ENDELM")

T = TypeVar("T")


def read_mesh(
    path: str | Path,
    comm: MPI.Comm = MPI.COMM_WORLD,
    cell_tags: str | None = None,
    facet_tags: str | None = None,
    *,
    merge: bool | float | None = None,
    groups: str | Collection[str | int] | None = None,
    plane: Plane | None = None,
) -> TaggedMesh:
    """Read and distribute a mesh; collective.

    Groups keep their names. Depending on the suffix of the file, they are

    * .msh: physical groups of gmsh (formats 2.2 and 4.1, partitioned or not); from Neper every
      grain ("poly1", in 2D "face1") and every face between two ("face1", in 2D "edge1");
    * .xdmf: the tags that :func:`write_mesh` and ``dolfinx.io.XDMFFile`` write, read by all ranks,
      or an attribute of the grid, as meshio writes it;
    * .inp of Abaqus and CalculiX: sets of elements (*ELSET) and surfaces of their faces (*SURFACE);
      sets of nodes (*NSET) are in ``nodes`` of the result;
    * .unv of I-DEAS and Salome: groups of elements;
    * .med, .vtu, .vtk, .bdf and others: sets of meshio, or integer cell data.

    Cells of 20 nodes (C3D20, C3D20R), in 2D of 8, become cells of 8 and 4 nodes where their edges
    are straight, and otherwise of 27 and 9, with the same shape. A file is read only: it cannot run
    commands, and the memory it takes is bounded by its size.

    Args:
        path: A file. All but .msh, .unv, .inp and XDMF of DOLFINx need meshio (the extra "mesh").
        comm: Communicator.
        cell_tags: Name of the tags, or data, of the cells; None for "cell_tags" in an XDMF file
            with several grids, otherwise for the only integer data.
        facet_tags: Name of those of the facets; None for "facet_tags", or the name of the cells'.
        merge: True merges coincident nodes, as on both sides of cohesive elements, and drops flat
            cells, whose groups become groups of facets; a number is the distance up to which nodes
            are merged [mm], 1e-7 of the longest side by default. False keeps them; None warns about
            them.
        groups: "entities" makes every volume, surface and curve of gmsh, and every block of cells
            of other files, a group if it is in none: "surface 1" has tag 1. Names or tags select
            the groups to use where a cell is in several; the others are ignored, and facets of no
            group are dropped.
        plane: Where a 2D mesh lies, if not in a plane z = const: see :func:`distribute`.

    Raises:
        ValueError: the file is missing, of an unknown format, truncated, without cell tags, with
            cells in two groups, with flat cells, or with unsupported cells.
        TypeError: the path is not a path.
        ImportError: meshio is needed and not installed.
    """
    path = checked_path("read_mesh: path", path)
    try:
        grids, words = _on_root(comm, lambda: _door(path))
        if grids:
            if (merge, groups, plane) != (None, None, None):
                raise ValueError(
                    "merge, groups and plane are for files of other programs; this file was "
                    "written by DOLFINx, which reads its mesh as it is"
                )
            return _read_xdmf(path, comm, grids, words, cell_tags, facet_tags)
        with model("file") as gmsh_model:
            gdim, shift, nodes, warnings = _on_root(
                comm, lambda: _load(path, gmsh_model, cell_tags, facet_tags, merge, groups)
            )
            for warning in warnings:
                warn_together(comm, f"read_mesh: {path}: {warning}")
            tagged = shifted(distribute(gmsh_model, comm, gdim, plane=plane), shift)
            points = _on_root(comm, lambda: _points_of(gmsh_model, nodes))
            tagged.nodes = {name: NodeSet(x) for name, x in points.items()}
            return tagged
    except ValueError as error:
        raise ValueError(f"read_mesh: {path}: {error}") from None
    except ImportError as error:
        raise ImportError(f"read_mesh: {path}: {error}") from None


def _on_root(comm: MPI.Comm, call: Callable[[], T]) -> T:
    """Result of a function on rank 0, or its error, on all ranks."""
    result, error = None, None
    if comm.rank == 0:
        try:
            result = call()
        except (ValueError, ImportError, OSError) as raised:
            error = ValueError(str(raised)) if isinstance(raised, OSError) else raised
        except Exception as raised:  # what a file that is not what it seems makes readers raise
            error = ValueError(f"it is damaged ({type(raised).__name__}: {raised})")
    result, error = comm.bcast((result, error))
    if error is not None:
        raise error
    return result


def _door(path: Path) -> tuple[list[str], dict[str, str]]:
    """Check that a file is readable; return the grids of a DOLFINx XDMF file and its other data, by
    name."""
    name = path.name.lower()
    if not name.endswith((".msh", ".unv", ".inp", ".xdmf")):
        known = endings()
        if not name.endswith(known):
            raise ValueError(
                "its suffix must be .msh, .unv, .inp, .xdmf or another one that meshio reads: "
                f"{', '.join(known)}"
            )
    if not path.is_file():
        raise ValueError("there is no file of this name")
    if not path.stat().st_size:
        raise ValueError("the file is empty")
    if not name.endswith(".xdmf"):
        return [], {}
    try:
        with bounded(path.stat().st_size):
            root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise ValueError(f"it is not a complete XML file ({error}); is it truncated?") from None
    for item in root.iterfind(".//DataItem[@Format='HDF']"):
        other = (item.text or "").strip().partition(":")[0]
        if not (path.parent / other).is_file():
            raise ValueError(f"its data are in {other}, which is missing")
    grids = [grid.get("Name", "") for grid in root.iterfind("./Domain/Grid")]
    if len(grids) < 2:
        return [], {}
    words = root.iterfind("./Domain/Information")
    return grids, {word.get("Name", ""): word.get("Value", "") for word in words}


def _load(
    path: Path,
    gmsh_model: Any,
    cell_tags: str | None,
    facet_tags: str | None,
    merge: bool | float | None,
    groups: str | Collection[str | int] | None,
) -> tuple[int, int, dict[str, NDArray[np.int64]], list[str]]:
    """Load a file into gmsh: dimension, shift of the tags of cells, tags of the nodes of sets, and
    warnings."""
    if isinstance(groups, str) and groups != ENTITIES:
        groups = [groups]
    mesh, changed = _arrays(path, gmsh_model, cell_tags, facet_tags)
    if not np.isfinite(mesh.points).all():
        raise ValueError("it has nodes whose coordinates are not finite")
    join = merge is not None and merge is not False
    if join and not (isinstance(merge, Real) and 0 <= merge < np.inf):
        raise ValueError(f"merge={merge!r} is not a distance: give True, or a length [mm]")
    place = places(mesh, None if merge is True or not join else float(merge))
    twice = int((place != np.arange(len(place))).sum())
    flat = count_flat(mesh, place)
    if flat and not join:
        raise ValueError(
            f"{flat} cells have coincident nodes, like zero-thickness cohesive elements; vmdg "
            "needs none, since its interfaces are facets: merge=True drops them and merges the "
            "nodes"
        )
    warnings = []
    if twice and merge is None:
        warnings.append(
            f"{twice} nodes coincide with another one, so bodies that seem to touch there are not "
            "connected; merge=True merges them, merge=False keeps them without this warning"
        )
    if join and twice:
        mesh, changed = merged(mesh, place), True
    mesh, words = completed(mesh)
    if words:
        changed = True
        warnings.append(words)
    sets: dict[str, NDArray[np.int64]] = {}
    if changed or groups is not None:
        mesh = one_group_each(mesh, None if groups == ENTITIES else groups)
        if groups == ENTITIES:
            mesh = entities_as_groups(mesh)
        sets = into_gmsh(gmsh_model, mesh)
    _check_groups(mesh)
    return mesh.dim, mesh.shift, sets, warnings


def _arrays(
    path: Path, gmsh_model: Any, cell_tags: str | None, facet_tags: str | None
) -> tuple[MeshArrays, bool]:
    with bounded(_size(path)):
        if path.suffix.lower() in (".msh", ".unv"):
            with alone(path) as copy:
                if path.suffix.lower() == ".msh":
                    return _load_gmsh(copy, gmsh_model)
                mesh, _ = _load_gmsh(converted(copy), gmsh_model)
                return mesh, True
        if path.suffix.lower() == ".inp":
            return read_abaqus(path), True
        return read_foreign(path, cell_tags, facet_tags), True


def _size(path: Path) -> int:
    """Of a file and, for XDMF, of the files of its data [bytes]."""
    size = path.stat().st_size
    if path.suffix.lower() in (".xdmf", ".xmf"):
        size += sum(file.stat().st_size for file in path.parent.glob(f"{path.stem}*.h5"))
    return size


def _points_of(
    gmsh_model: Any, nodes: Mapping[str, NDArray[np.int64]]
) -> dict[str, NDArray[np.float64]]:
    """Coordinates (n, 3) of sets of nodes given by their tags, 1 to the number of nodes."""
    tags, points, _ = gmsh_model.mesh.getNodes() if nodes else ([], np.zeros(0), None)
    points = points.reshape(-1, 3)[np.argsort(tags)]
    return {name: points[one - 1] for name, one in nodes.items()}


def _check_groups(mesh: MeshArrays) -> None:
    word = {2: "surface", 3: "volume"}[mesh.dim]
    cells = mesh.of(mesh.dim)
    lost = sum(len(block.nodes) for block in cells if not block.group)
    if not lost:
        return
    if all(block.group == 0 for block in cells):
        raise ValueError(
            f"it has no group of cells (no physical group of dimension {mesh.dim}, no set, no "
            f"tags) to assign materials; groups={ENTITIES!r} makes every {word} of it one "
            f"({len({block.entity for block in cells})} here)"
        )
    raise ValueError(
        f"{lost} of {sum(len(block.nodes) for block in cells)} cells, the first in {word} "
        f"{min(block.entity for block in cells if not block.group)}, are in no group and would be "
        f"lost; make a group for every body, or groups={ENTITIES!r} makes each such {word} one"
    )


def _load_gmsh(path: Path, gmsh_model: Any) -> tuple[MeshArrays, bool]:
    """A file of gmsh or Neper, and whether its groups differ from those that gmsh has loaded."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        begin = bytes(content[:4096])
        if not begin.startswith(BEGIN) or not any(word in begin for word in BEGIN[:2]):
            raise ValueError(
                f"it is not a gmsh file: it begins with {begin[:20].decode(errors='replace')!r}; "
                "let the program that made it write .inp, .med or .vtu"
            )
        last = bytes(content[-4096:]).rstrip().rpartition(b"\n")[2]
        if not last.upper().startswith(b"$END") or all(content.find(word) < 0 for word in END):
            raise ValueError("it is truncated: its last section or its elements have no $End")
        names = list(_physical_names(content))
    _open(path)
    parts = gmsh_model.getNumberOfPartitions()
    if parts:
        with_cells = {
            int(part)
            for dim, entity in gmsh_model.getEntities(gmsh_model.getDimension())
            if len(gmsh_model.mesh.getElements(dim, entity)[0])
            for part in gmsh_model.getPartitions(dim, entity)
        }
        if len(with_cells) < max(parts, 2):
            raise ValueError(
                "it is one part of a mesh split into several files; write the whole mesh "
                "(Mesh.PartitionSplitMeshFiles 0)"
            )
        gmsh_model.mesh.unpartition()
    for dim, tag, name in names:
        if not name.startswith(
            '"'
        ):  # which gmsh ignores; Neper writes them so (its manual, Mesh File)
            name_groups(gmsh_model, dim, {name: tag})
    mesh = from_gmsh(gmsh_model)
    entities = [
        (dim, e) for dim in (mesh.dim, mesh.dim - 1) for _, e in gmsh_model.getEntities(dim)
    ]
    several = any(len(gmsh_model.getPhysicalGroupsForEntity(*entity)) > 1 for entity in entities)
    if several and begin.partition(BEGIN[0])[2].split()[0].startswith(b"2"):
        # In this format groups belong to elements, but gmsh keeps those of entities.
        by_cell = read_foreign(path, None, None, "gmsh")
        return MeshArrays(by_cell.points, by_cell.blocks, mesh.names), True
    used = np.unique(np.concatenate([block.nodes.ravel() for block in mesh.of(mesh.dim)]))
    # DOLFINx expects consecutive nodes from 1, all of them used.
    spare = len(used) < len(mesh.points) or gmsh_model.mesh.getMaxNodeTag() > len(used)
    return mesh, several or spare


def _open(path: Path) -> None:
    """Open in gmsh a copy whose first bytes have been checked."""
    try:
        gmsh.open(str(path))
    except Exception as error:  # gmsh raises no other class
        words = str(error).replace(str(path), path.name)
        raise ValueError(f"gmsh cannot read it ({words}); is it complete?") from None


def _physical_names(content: mmap.mmap) -> Iterator[tuple[int, int, str]]:
    """Dimension, tag and name of physical groups as they are written."""
    content.seek(max(content.find(b"$PhysicalNames"), 0))
    if not content.readline().startswith(b"$PhysicalNames"):
        return
    while not (line := content.readline()).startswith(b"$") and line:
        words = line.decode(errors="replace").split(maxsplit=2)
        if len(words) == 1:  # how many there are
            continue
        if len(words) < 3 or words[0] not in set("0123") or not words[1].isdecimal():
            raise ValueError(f"{' '.join(words):.60} does not name a physical group")
        yield int(words[0]), int(words[1]), words[2].strip()


def shifted(tagged: TaggedMesh, shift: int) -> TaggedMesh:
    if not shift:
        return tagged
    mesh, cells, facets = tagged
    values = cells.values - np.int32(shift)
    tags = meshtags(mesh, mesh.topology.dim, cells.indices, values)
    names = {name: tag - shift for name, tag in cells.names.items()}
    return TaggedMesh(mesh, NamedTags(tags, names), facets)


def _read_xdmf(
    path: Path,
    comm: MPI.Comm,
    grids: list[str],
    words: dict[str, str],
    cell_tags: str | None,
    facet_tags: str | None,
) -> TaggedMesh:
    """A DOLFINx file: one grid for the mesh, one for cell tags and one for facet tags."""
    wanted = [cell_tags or CELL_TAGS, facet_tags or FACET_TAGS]
    needed = wanted if facet_tags else wanted[:1]
    lacking = [name for name in needed if name not in grids[1:]]
    if lacking:
        raise ValueError(
            f"it has no tags {lacking[0]!r}; its grids are {', '.join(map(repr, grids))}, with the "
            "names that mesh and tags had when it was written (MeshTags.name): cell_tags=..."
        )
    try:
        with bounded(_size(path)), XDMFFile(comm, str(path), "r") as file:
            mesh = _mesh_of(file, comm, grids[0])
            dim = mesh.topology.dim
            mesh.topology.create_connectivity(dim - 1, dim)
            tags = []
            for name in wanted:
                nothing = np.zeros(0, dtype=np.int32)
                found = meshtags(mesh, dim - 1, nothing, nothing)
                if name in grids:
                    found = file.read_meshtags(mesh, name=name)
                tags.append(NamedTags(found, json.loads(words.get(_names(name), "{}"))))
    except RuntimeError as error:
        raise ValueError(f"DOLFINx cannot read it ({error}); is it complete?") from None
    return TaggedMesh(mesh, *tags)


def _mesh_of(file: XDMFFile, comm: MPI.Comm, name: str) -> Mesh:
    """The mesh of a grid as ``XDMFFile.read_mesh`` makes it, with the ghosts of interfaces."""
    place = name, "/Xdmf/Domain"
    shape, degree = file.read_cell_type(*place)
    cells, x = file.read_topology_data(*place), file.read_geometry_data(*place)
    variant = basix.LagrangeVariant.equispaced
    element = basix.ufl.element("Lagrange", shape.name, degree, variant, shape=(x.shape[1],))
    mesh = create_mesh(comm, cells, x=x, e=ufl.Mesh(element), partitioner=cell_partitioner())
    mesh.name = name
    return mesh


def _names(name: str) -> str:
    """Where an XDMF file keeps the names of the groups of its tags ``name``."""
    return f"names of {name}"


def write_mesh(tagged: TaggedMesh, path: str | Path) -> None:
    """Write a mesh and its tags to an XDMF file, for :func:`read_mesh` and ParaView; collective.

    Args:
        tagged: The mesh.
        path: A file .xdmf; its folder is created if missing.

    Raises:
        ValueError: another suffix.
        TypeError: the mesh has no tags, or the path is not a path.
    """
    if checked_path("write_mesh: path", path).suffix != ".xdmf":
        raise ValueError(f"write_mesh: {path} must end in .xdmf")
    if not isinstance(tagged, tuple) or len(tagged) != 3:
        raise TypeError(
            f"write_mesh: tagged = {tagged!r} must be mesh, cell_tags, facet_tags, as read_mesh "
            "and the functions of vmdg.meshes return them"
        )
    mesh, cells, facets = tagged
    mesh.topology.create_connectivity(mesh.topology.dim - 1, mesh.topology.dim)
    with XDMFFile(mesh.comm, str(path), "w") as file:
        file.write_mesh(mesh)
        for tags, name in ((cells, CELL_TAGS), (facets, FACET_TAGS)):
            tags.name = name
            file.write_meshtags(tags, mesh.geometry)
            file.write_information(_names(name), json.dumps(names_of(tags)))
