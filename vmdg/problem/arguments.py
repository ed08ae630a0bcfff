"""What a problem is given: errors at the door that name the thing and the remedy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import (
    Mesh,
    MeshTags,
    compute_midpoints,
    exterior_facet_indices,
    locate_entities,
)
from numpy.typing import ArrayLike, NDArray

from .. import compat
from ..base.kernels import compile_expression
from ..base.parallel import raise_together
from ..base.tables import rounded
from ..domain.lattice import Lattice
from ..domain.materials import cell_values
from ..domain.tags import Group
from ..domain.topology import cells_inside, facet_cells
from ..forms.materials import Material
from ..interface.facets import InterfaceFacets
from ..interface.interface import Interface, interface_names

KINEMATICS = ("finite", "small")
GENERALIZED = "generalized strain"
PLANES = ("strain", GENERALIZED, "stress")
#: Stress at F = I relative to the moduli that rounding may leave.
RESTS = 1e-9

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
                f"Problem: interface {first} ({interfaces[first].place}) and interface {i} "
                f"({interfaces[i].place}) are both called {name!r}; give each a name of its own"
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


def in_numbers(materials: Mapping[int, Material], interfaces: Sequence[Interface]) -> list[str]:
    """What is to be the same of materials and laws on all ranks, kinds and numbers, in words."""
    bodies = [(f"material {t}", body, body.parameters) for t, body in materials.items()]
    laws = [(f"interface {i}", one.law, vars(one.law)) for i, one in enumerate(interfaces)]
    return [
        f"{what}: {type(given).__name__} "
        + ", ".join(f"{k}={v}" for k, v in values.items() if isinstance(v, Real | str))
        for what, given, values in (*bodies, *laws)
    ]


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


def check_plane(
    mesh: Mesh,
    plane: str,
    materials: Mapping[int, Material],
    kinematics: str,
    symmetry: str | None,
    volumetric: str,
) -> bool:
    """Whether a problem is one of plane stress.

    Raises:
        ValueError: an unknown word, what has no meaning in plane stress or generalized plane
            strain; in plane stress a material that is tilted out of the plane, or one without the
            stretch of its thickness.
    """
    if plane not in PLANES:
        raise ValueError(f"Problem: plane = {plane!r} must be one of {PLANES}")
    if plane == "strain":
        return False
    if mesh.geometry.dim != 2 or symmetry is not None:
        raise ValueError(f"Problem: plane={plane!r} is for plane bodies: a 2D mesh, symmetry=None")
    if plane == GENERALIZED:
        if volumetric != "pointwise":
            raise ValueError(
                f"Problem: plane={plane!r} does not go with volumetric={volumetric!r}; take "
                "degree=2 near incompressibility"
            )
        return False
    if volumetric != "pointwise":
        raise ValueError(
            "Problem: bodies in plane stress do not lock near incompressibility, their thickness "
            "follows; leave out volumetric="
        )
    for tag, material in materials.items():
        if not material.mirrored:
            raise ValueError(
                f"Problem: the axes of the {type(material).__name__} of tag {tag} are tilted out "
                "of the plane, so that strains in it make shear stresses out of it; plane='stress' "
                "needs an axis along z: turn the material by angle=, or mesh the sheet in 3D"
            )
        if kinematics == "finite" and type(material).free_stretch is Material.free_stretch:
            raise ValueError(
                f"Problem: the {type(material).__name__} of tag {tag} has no closed form of the "
                "stretch of the thickness, which plane='stress' needs at finite strain; use "
                "NeoHookean or Orthotropic, kinematics='small', a sheet of one cell in 3D, or a "
                "subclass of Material with free_stretch(F, parameters)"
            )
    return True


def check_rest(mesh: Mesh, materials: Mapping[int, Material]) -> None:
    """Energies without stress at F = I, where a body starts; collective.

    Raises:
        ValueError: one has a stress there, or gives no number.
    """
    for tag, material in materials.items():
        if material.free_at_rest or type(material).energy is Material.energy:
            continue
        P, A = _at_rest(mesh, material)
        # Exponents of energies and their derivatives round to 1e-14 or so.
        if not np.isfinite(P).all() or np.abs(P).max() > RESTS * np.abs(A).max():
            raise ValueError(
                f"Problem: the energy of the material of tag {tag} has the stress P = "
                f"{rounded(P)} at F = I, where it must vanish; add what is missing, such "
                "as -mu ln J to mu/2 tr(F^T.F), and give a stress that is there from the start by "
                "eigenstrain="
            )


def _at_rest(mesh: Mesh, material: Material) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """P at F = I (3, 3) and some of the moduli there [MPa]; the same on every rank, collective."""
    # A Constant, and not the Identity, which UFL would put in while the user's function is called.
    F = ufl.variable(fem.Constant(mesh, np.eye(3)))
    # Of moduli that vary those of one cell.
    some = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)[:1]
    parameters = {
        name: fem.Constant(mesh, float(np.sum(cell_values(mesh, value, some, name))))
        for name, value in material.parameters.items()
    }
    P = ufl.diff(material.energy(F, parameters), F)
    A = ufl.diff(P, F)
    moduli = [A[i, j, i, j] for i in range(3) for j in range(3)]
    # An energy without parameters must know the mesh too.
    values = fem.Constant(mesh, 1.0) * ufl.as_vector(
        [P[i, j] for i, j in np.ndindex(3, 3)] + moduli
    )
    point = np.zeros((1, mesh.topology.dim))
    expression = compile_expression(values, point, mesh.comm, name="stress at rest")
    here = mesh.topology.index_map(mesh.topology.dim).size_local > 0
    row = expression.eval(mesh, np.zeros(int(here), dtype=np.int32)).reshape(-1, 18)
    rows = np.concatenate(mesh.comm.allgather(row))
    return rows[0, :9].reshape(3, 3), rows[0, 9:]


def check_approximation(mesh: Mesh, degree: int, kinematics: str) -> None:
    """A degree that exists and that fits the cells, and kinematics that exist.

    Of a cell with X(xi) of degree p the displacement u(xi) of degree k < p has no affine function
    of X in it, save where the cell is straight: grad u would be wrong by the curvature of the cell
    even for a constant strain, on any mesh, and with it the tractions of an interface.

    Raises:
        ValueError: one of them does not, or the cells are of a higher degree than the displacement.
    """
    if not isinstance(degree, Real) or degree < 1 or degree % 1:
        raise ValueError(f"Problem: degree = {degree!r} must be a whole number, at least 1")
    if kinematics not in KINEMATICS:
        raise ValueError(f"Problem: kinematics = {kinematics!r} must be one of {KINEMATICS}")
    geometry = compat.coordinate_element(mesh).degree
    if geometry > degree:
        raise ValueError(
            f"Problem: the cells of the mesh are curved, of degree {geometry}, the displacement "
            f"has degree {degree}, which contains no constant strain on such cells; take "
            f"degree={geometry}, or mesh with straight cells (gmsh: mesh.setOrder({degree}))"
        )


def check_condition(what: str, where: Any, value: Any) -> None:
    """A place and a value, not a condition of DOLFINx.

    Args:
        what: Name of the condition for messages.
        where: What the user gave as the place.
        value: What the user gave as the value.

    Raises:
        TypeError: one of them is a DirichletBC, or there is no value.
    """
    if isinstance(where, fem.DirichletBC) or isinstance(value, fem.DirichletBC):
        raise TypeError(
            f"{what}: a DirichletBC of DOLFINx belongs to the dofs of a space of its own, and the "
            "displacement of the problem has others, two at a node of an interface; write "
            "problem.dirichlet(facets, value, component), the value as a number, array, Constant, "
            "Function, lambda t: ... or lambda x, t: ..."
        )
    if value is None:
        raise TypeError(f"{what}: the value is missing; 0.0 holds the nodes where they are")


def check_rigid_face(
    d: int, small: bool, component: int | str | None, tilts: bool, at: ArrayLike | None
) -> None:
    """How a rigid face moves, at small strain or not, and its point.

    Raises:
        ValueError: large rotations, or no point (d,) where the face tilts.
    """
    if tilts and component is None and not small:
        raise ValueError(
            "rigid_face: all components of a face that tilts are those of a rigid rotation, which "
            "is linear at small strain only: take kinematics='small', one component, tilts=False, "
            "or a stiff body as the plate"
        )
    if tilts and at is None:
        raise ValueError(
            "rigid_face: a face that tilts needs at=, the point at which the force acts and whose "
            "displacement is meant, for example its centre"
        )
    if at is not None and (np.shape(at) != (d,) or not np.isfinite(at).all()):
        raise ValueError(f"rigid_face: at = {at!r} must be a point of {d} finite coordinates")


def check_overlap(mesh: Mesh, facets: Sequence[InterfaceFacets]) -> None:
    """Every facet belongs to one interface; collective.

    Raises:
        ValueError: a facet belongs to two.
    """
    taken = np.full(len(facet_cells(mesh)), -1)
    message = None
    for number, selected in enumerate(facets):
        twice = selected.everywhere[taken[selected.everywhere] >= 0]
        if len(twice) and message is None:
            message = (
                f"facet {twice[0]} belongs to both {facets[taken[twice[0]]].label} and "
                f"{selected.label}; give every facet one interface"
            )
        taken[selected.everywhere] = number
    raise_together(mesh.comm, message)


def check_faces(
    mesh: Mesh,
    tags: NDArray[np.int32],
    lattice: Lattice,
    interfaces: Sequence[Interface],
    facets: Sequence[InterfaceFacets],
) -> None:
    """No interface that can fail lies on the boundary of a periodic cell, which ties; collective.

    Args:
        mesh: The mesh.
        tags: Tag of every local cell.
        lattice: Of the cell.
        interfaces: What the user gave.
        facets: Theirs.

    Raises:
        ValueError: opposite faces do not match, two groups that such an interface is between meet
            across the boundary, or its predicate or the change of sign of its level set is there.
    """

    def everywhere(values: NDArray) -> NDArray:
        return np.concatenate(comm.allgather(values))

    comm, dim = mesh.comm, mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    outer = exterior_facet_indices(mesh.topology)
    middle = compute_midpoints(mesh, dim - 1, outer)[:, : mesh.geometry.dim]
    cells, middle = facet_cells(mesh)[outer, 0], everywhere(middle)
    faces = lattice.images(middle[:, None])
    across = np.sort(everywhere(tags[cells])[faces], axis=1)
    for interface, selected in zip(interfaces, facets, strict=True):
        if not interface.law.inelastic:
            continue
        remedy = "shift the cell so that its boundary runs through the bodies"
        if interface.between is not None:
            between = np.unique(everywhere(np.sort(tags[selected.cells], axis=1)), axis=0)
            lies = (across[:, None] == between).all(axis=2).any(axis=1)
        elif interface.level_set is not None:
            lies = np.diff(everywhere(cells_inside(mesh, interface.level_set)[cells])[faces])[:, 0]
            remedy += ", or select what is meant inside of it by facets="
        elif callable(interface.facets):
            chosen = locate_entities(mesh, dim - 1, interface.facets)
            lies = everywhere(np.isin(outer, chosen))[faces].any(axis=1)
            remedy += ", or leave its boundary out of facets="
        else:
            continue
        if lies.any():
            place = min(rounded(middle[faces[lies, 0]]))
            raise ValueError(
                f"Periodic: {selected.label} would lie on the boundary of the cell at {place}, "
                f"where opposite faces are tied and nothing fails; {remedy}"
            )
