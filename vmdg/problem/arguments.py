"""What a problem is given: errors at the door that name the thing and the remedy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from petsc4py import PETSc

import numpy as np
from dolfinx.mesh import Mesh, MeshTags

from ..base.parallel import raise_together
from ..domain.tags import Group
from ..domain.topology import facet_cells
from ..forms.materials import Material
from ..interface.facets import InterfaceFacets
from ..interface.interface import Interface, interface_names

KINEMATICS = ("finite", "small")
CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")


def checked_interfaces(interfaces: Sequence[Interface]) -> tuple[Interface, ...]:
    """Interfaces as a tuple.

    Raises:
        TypeError: they are not a sequence of :class:`vmdg.Interface`.
        ValueError: two of them have the same name.
    """
    if isinstance(interfaces, Interface):
        raise TypeError(
            "Problem: interfaces must be a list, [Interface(...)], also for one of them"
        )
    for interface in interfaces:
        if not isinstance(interface, Interface):
            raise TypeError(
                f"Problem: interfaces has {interface!r}, which is no vmdg.Interface; write "
                "Interface(between=(1, 2), law=...)"
            )
    names = interface_names(interfaces)
    for i, name in enumerate(names):
        first = names.index(name)
        if first < i:
            raise ValueError(
                f"Problem: interface {first}, {interfaces[first]}, and interface {i}, "
                f"{interfaces[i]}, are both called {name!r}; give each a name of its own"
            )
    return tuple(interfaces)


def checked_materials(materials: Mapping[Group, Material]) -> Mapping[Group, Material]:
    """Materials by tag, as they are.

    Raises:
        TypeError: they are not a mapping of tags to instances of :class:`vmdg.Material`.
    """
    if not isinstance(materials, Mapping):
        raise TypeError(
            f"Problem: materials = {materials!r} must be a dict of materials by cell tag, for "
            "example {1: vmdg.NeoHookean(E=5000.0, nu=0.25)}"
        )
    for tag, material in materials.items():
        if isinstance(material, type):
            raise TypeError(
                f"Problem: the material of {tag!r} is the class {material.__name__}; give an "
                f"instance with its parameters, {material.__name__}(...)"
            )
        if not isinstance(material, Material):
            raise TypeError(
                f"Problem: the material of {tag!r} is {material!r}; it must be a vmdg.Material, "
                "for example vmdg.NeoHookean(E=5000.0, nu=0.25)"
            )
    return materials


def check_mesh(mesh: Mesh, cell_tags: MeshTags) -> None:
    """A mesh of real numbers in double precision, and tags of its cells.

    Raises:
        TypeError: one of them is something else.
        ValueError: the tags are of facets or of another mesh, coordinates are in single precision
            or too many, or the cells are of another type.
        RuntimeError: PETSc computes with complex numbers.
    """
    if not isinstance(mesh, Mesh):
        raise TypeError(
            f"Problem: mesh is a {type(mesh).__name__}, not a dolfinx.mesh.Mesh; unpack what "
            "vmdg.meshes returns: mesh, cell_tags, facet_tags = ..."
        )
    if not isinstance(cell_tags, MeshTags):
        raise TypeError(
            f"Problem: cell_tags is a {type(cell_tags).__name__}, not dolfinx.mesh.MeshTags; make "
            "them by dolfinx.mesh.meshtags or vmdg.split_cells"
        )
    if cell_tags.dim != mesh.topology.dim:
        raise ValueError(
            f"Problem: cell_tags has tags of entities of dimension {cell_tags.dim}, the cells have "
            f"{mesh.topology.dim}; were the tags of facets given?"
        )
    if cell_tags.topology is not mesh.topology._cpp_object:
        raise ValueError(
            "Problem: cell_tags belong to another mesh; give mesh and tags that were made together"
        )
    if np.issubdtype(PETSc.ScalarType, np.complexfloating):
        raise RuntimeError(
            "Problem: this PETSc computes with complex numbers, vmdg with real ones; choose the "
            "real build (in DOLFINx containers: source dolfinx-real-mode)"
        )
    if mesh.geometry.x.dtype != np.float64:
        raise ValueError(
            f"Problem: the coordinates of the mesh are {mesh.geometry.x.dtype}; create it with "
            "dtype=numpy.float64"
        )
    cell = mesh.topology.cell_name()
    if cell not in CELLS:
        raise ValueError(f"Problem: cells of type {cell} are not supported; use one of {CELLS}")
    if mesh.geometry.dim != mesh.topology.dim:
        raise ValueError(
            f"Problem: the mesh has {mesh.geometry.dim} coordinates for cells of dimension "
            f"{mesh.topology.dim}; pass gdim={mesh.topology.dim} when reading it"
        )


def check_approximation(degree: int, kinematics: str) -> None:
    """A degree and kinematics that exist.

    Raises:
        ValueError: one of them does not.
    """
    if degree < 1:
        raise ValueError(f"Problem: degree = {degree} must be at least 1")
    if kinematics not in KINEMATICS:
        raise ValueError(f"Problem: kinematics = {kinematics!r} must be one of {KINEMATICS}")


def check_overlap(
    mesh: Mesh, interfaces: Sequence[Interface], facets: Sequence[InterfaceFacets]
) -> None:
    """Every facet belongs to one interface; collective.

    Raises:
        ValueError: a facet belongs to two.
    """
    taken = np.full(len(facet_cells(mesh)), -1)
    message = None
    for number, (interface, selected) in enumerate(zip(interfaces, facets, strict=True)):
        twice = selected.everywhere[taken[selected.everywhere] >= 0]
        if len(twice) and message is None:
            message = (
                f"facet {twice[0]} belongs to both {interfaces[taken[twice[0]]]} and {interface}; "
                "give every facet one interface"
            )
        taken[selected.everywhere] = number
    raise_together(mesh.comm, message)
