"""Meshes from files, distributed with the facet ghosts that interfaces need."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from mpi4py import MPI

import gmsh
from dolfinx.io import XDMFFile
from dolfinx.mesh import GhostMode

from vmdg.base.parallel import raise_together
from vmdg.domain.tags import NamedTags, names_of

from .gmsh_model import TaggedMesh, distribute, model, name_groups

#: Names of the tags in XDMF files.
CELL_TAGS, FACET_TAGS = "cell_tags", "facet_tags"


def read_mesh(
    path: str | Path,
    comm: MPI.Comm = MPI.COMM_WORLD,
    cell_tags: str = CELL_TAGS,
    facet_tags: str = FACET_TAGS,
) -> TaggedMesh:
    """Read and distribute a mesh; collective.

    Args:
        path: A file of gmsh (.msh, tags and names by physical groups) or of Neper (.msh, a group
            for every grain, "poly1" or, in 2D, "face1", and for every face between two), or of XDMF
            (.xdmf, with its .h5) as :func:`write_mesh` and ``dolfinx.io.XDMFFile`` write it.
        comm: Communicator.
        cell_tags: Name of the cell tags in an XDMF file.
        facet_tags: Name of the facet tags in an XDMF file.

    Raises:
        ValueError: the file is missing, of another kind, or without tags of cells.
    """
    path = Path(path)
    message = None
    if path.suffix not in (".msh", ".xdmf"):
        message = f"read_mesh: {path} must end in .msh or .xdmf"
    elif comm.rank == 0 and not path.is_file():
        message = f"read_mesh: there is no file {path}"
    raise_together(comm, message)
    if path.suffix == ".msh":
        return _read_gmsh(path, comm)
    return _read_xdmf(path, comm, cell_tags, facet_tags)


def _read_gmsh(path: Path, comm: MPI.Comm) -> TaggedMesh:
    with model("file") as gmsh_model:
        message, gdim = None, 0
        if comm.rank == 0:
            gmsh.open(str(path))
            gdim = gmsh_model.getDimension()
            for dim, tag, name in _bare_names(path):
                name_groups(gmsh_model, dim, {name: tag})
            if not gmsh_model.getPhysicalGroups(gdim):
                message = (
                    f"read_mesh: {path} has no physical group of dimension {gdim}; make one for "
                    "every body (addPhysicalGroup), or gmsh does not say which cell is whose"
                )
        raise_together(comm, message)
        return distribute(gmsh_model, comm, comm.bcast(gdim))


def _bare_names(path: Path) -> Iterator[tuple[int, int, str]]:
    """Dimension, tag and name of physical groups whose names have no quotes; gmsh leaves them out.

    Neper writes them so (its manual, Mesh File).
    """
    lines = iter(path.read_bytes().splitlines())
    for line in lines:
        if line.strip() == b"$PhysicalNames":
            break
    next(lines, None)  # how many there are
    for line in lines:
        words = line.decode().split(maxsplit=2)
        if len(words) < 3:
            return
        if not words[2].startswith('"'):
            yield int(words[0]), int(words[1]), words[2].strip()


def _read_xdmf(path: Path, comm: MPI.Comm, cell_tags: str, facet_tags: str) -> TaggedMesh:
    with XDMFFile(comm, str(path), "r") as file:
        mesh = file.read_mesh(ghost_mode=GhostMode.shared_facet)
        dim = mesh.topology.dim
        mesh.topology.create_connectivity(dim - 1, dim)
        tags = []
        for name in (cell_tags, facet_tags):
            try:
                found = file.read_meshtags(mesh, name=name)
            except RuntimeError:
                raise ValueError(
                    f"read_mesh: {path} has no tags {name!r}; their names are those of "
                    "MeshTags.name when the file was written"
                ) from None
            tags.append(NamedTags(found, json.loads(file.read_information(_names(name)) or "{}")))
    return TaggedMesh(mesh, *tags)


def _names(name: str) -> str:
    """Where an XDMF file keeps the names of the groups of its tags ``name``."""
    return f"names of {name}"


def write_mesh(tagged: TaggedMesh, path: str | Path) -> None:
    """Write a mesh and its tags to an XDMF file, for :func:`read_mesh` and ParaView; collective.

    Args:
        tagged: The mesh.
        path: Ends in .xdmf; its folder must exist.

    Raises:
        ValueError: another ending.
    """
    if Path(path).suffix != ".xdmf":
        raise ValueError(f"write_mesh: {path} must end in .xdmf")
    mesh, cells, facets = tagged
    mesh.topology.create_connectivity(mesh.topology.dim - 1, mesh.topology.dim)
    with XDMFFile(mesh.comm, str(path), "w") as file:
        file.write_mesh(mesh)
        for tags, name in ((cells, CELL_TAGS), (facets, FACET_TAGS)):
            tags.name = name
            file.write_meshtags(tags, mesh.geometry)
            file.write_information(_names(name), json.dumps(names_of(tags)))
