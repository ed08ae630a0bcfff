"""Checks of the arguments of a problem: errors name the cause and the remedy."""

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
from ..base.parallel import raise_together, warn_together
from ..base.tables import rounded
from ..domain.lattice import Lattice
from ..domain.materials import Bodies, cell_values
from ..domain.tags import Group
from ..domain.topology import cells_inside, facet_cells
from ..forms.materials import Material
from ..materials.gradient_damage import GradientDamage
from ..materials.point import PointMaterial
from ..points.facets import InterfaceFacets
from ..points.interface import Interface, interface_names
from ..points.pairing import NONMATCHING, PairedFacets

SYMBOLIC = "symbolic"
RESIDUALS = SYMBOLIC, "points"
KINEMATICS = ("finite", "small")
GENERALIZED = "generalized strain"
PLANES = ("strain", GENERALIZED, "stress")
#: Stress at F = I relative to the moduli that counts as rounding.
RESTS = 1e-9

CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")


def checked_interfaces(interfaces: Sequence[Interface]) -> tuple[Interface, ...]:
    if isinstance(interfaces, Interface):
        raise TypeError(
            "Problem: interfaces must be a list, [Interface(...)], even for a single one"
        )
    for interface in interfaces:
        if not isinstance(interface, Interface):
            raise TypeError(
                f"Problem: interfaces has {interface!r}, which is not a vmdg.Interface; write "
                "Interface(between=(1, 2), law=...)"
            )
    names = interface_names(interfaces)
    for i, name in enumerate(names):
        first = names.index(name)
        if first < i:
            raise ValueError(
                f"Problem: interface {first} ({interfaces[first].place}) and interface {i} "
                f"({interfaces[i].place}) are both called {name!r}; give them different names"
            )
    return tuple(interfaces)


def checked_materials(materials: Mapping[Group, Material]) -> Mapping[Group, Material]:
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
            "Problem: cell_tags belong to another mesh; give mesh and tags that were created "
            "together"
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
    if plane not in PLANES:
        raise ValueError(f"Problem: plane = {plane!r} must be one of {PLANES}")
    if plane == "strain":
        return False
    if mesh.geometry.dim != 2 or symmetry is not None:
        raise ValueError(f"Problem: plane={plane!r} is for plane bodies: a 2D mesh, symmetry=None")
    if plane == GENERALIZED:
        if volumetric != "pointwise":
            raise ValueError(
                f"Problem: plane={plane!r} cannot be combined with volumetric={volumetric!r}; use "
                "degree=2 near incompressibility"
            )
        return False
    if volumetric != "pointwise":
        raise ValueError(
            "Problem: bodies in plane stress do not lock near incompressibility, since their "
            "thickness adapts; omit volumetric="
        )
    for tag, material in materials.items():
        if not material.mirrored:
            raise ValueError(
                f"Problem: the axes of the {type(material).__name__} of tag {tag} are tilted out "
                "of the plane, so that in-plane strains cause shear stresses out of the plane; "
                "plane='stress' requires an axis along z: rotate the material by angle=, or mesh "
                "the sheet in 3D"
            )
        closed = type(material).free_stretch is not Material.free_stretch
        if kinematics == "finite" and not closed and not isinstance(material, PointMaterial):
            raise ValueError(
                f"Problem: the {type(material).__name__} of tag {tag} has no closed form of the "
                "thickness stretch, which plane='stress' requires at finite strain; use NeoHookean "
                "or Orthotropic, kinematics='small', a sheet of one cell in 3D, or a subclass of "
                "Material with free_stretch(F, parameters)"
            )
    return True


def check_points(
    mesh: Mesh,
    materials: Mapping[int, Material],
    interfaces: Sequence[Interface],
    kinematics: str,
    locks: bool,
) -> None:
    at_points = {tag: m for tag, m in materials.items() if isinstance(m, PointMaterial)}
    for tag, material in at_points.items():
        what = f"Problem: the {type(material).__name__} of tag {tag}"
        if kinematics not in material.kinematics:
            raise ValueError(
                f"{what} is defined for kinematics={' or '.join(map(repr, material.kinematics))}, "
                f"not for {kinematics!r}"
            )
        if any(interface.traction_jump for interface in interfaces):
            raise ValueError(
                f"{what} is evaluated at points, which cannot be combined with traction_jump=True "
                "of an interface: its term uses energy of the cells that plastic flow removes"
            )
    if locks and any(material.locks for material in at_points.values()):
        bricks = mesh.topology.cell_name() in ("quadrilateral", "hexahedron")
        cure = "volumetric='mean' or degree=2" if bricks else "degree=2"
        warn_together(
            mesh.comm,
            "plastic flow keeps the volume, and cells of degree 1 lock: once a body flows, forces "
            f"are too large, in a necking bar by 80 %; use {cure}",
        )


def check_cracking(
    materials: Mapping[int, Material], interfaces: Sequence[Interface], others: Mapping[str, bool]
) -> None:
    """Refuse what bodies that crack cannot be combined with: ``others`` says whether the problem
    has a feature, by what the user wrote for it."""
    tags = [tag for tag, m in materials.items() if isinstance(m, GradientDamage)]
    if not tags:
        return
    of_interfaces = {
        "sliding=True of an interface": any(one.sliding for one in interfaces),
        "activate='on-demand' of an interface": any(
            one.activate == "on-demand" for one in interfaces
        ),
    }
    for what, present in {**of_interfaces, **others}.items():
        if present:
            raise ValueError(
                f"Problem: the GradientDamage of tag {tags[0]} cannot be combined with {what}; "
                "omit it, or give the body another material"
            )


def check_walls(bodies: Bodies, strains: Mapping[int, Any], repeats: bool, axial: bool) -> None:
    if not bodies.walls:
        return
    if len(bodies.walls) == len(bodies.cells_of):
        raise ValueError("Problem: all tags are Rigid; at least one must be a deformable body")
    if swollen := sorted(set(strains) & set(bodies.walls)):
        raise ValueError(
            f"Problem: tag {swollen[0]} has an eigenstrain and is Rigid; remove one of them"
        )
    if repeats:
        raise ValueError(
            "Problem: Rigid cannot be used in a periodic cell, whose mean strain would deform it"
        )
    if axial:
        raise ValueError(
            f"Problem: Rigid cannot be used with plane={GENERALIZED!r}, whose F_33 would deform "
            'the wall; use plane="strain", or a stiff body for the wall'
        )


def check_rest(mesh: Mesh, materials: Mapping[int, Material]) -> None:
    """Check that energies have no stress at F = I, the initial state; collective."""
    for tag, material in materials.items():
        if material.free_at_rest or type(material).energy is Material.energy:
            continue
        P, A = _at_rest(mesh, material)
        # Energies with exponents and their derivatives round to about 1e-14.
        if not np.isfinite(P).all() or np.abs(P).max() > RESTS * np.abs(A).max():
            raise ValueError(
                f"Problem: the energy of the material of tag {tag} has the stress P = "
                f"{rounded(P)} at F = I, where it must vanish; add the missing term, such as -mu "
                "ln J to mu/2 tr(F^T.F), and give an initial stress by eigenstrain="
            )


def _at_rest(mesh: Mesh, material: Material) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """P at F = I (3, 3) and some of the moduli there [MPa]; the same on every rank, collective."""
    # A Constant, since UFL would simplify the Identity while the user's function is called.
    F = ufl.variable(fem.Constant(mesh, np.eye(3)))
    # Moduli that vary are taken in one cell.
    some = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)[:1]
    parameters = {
        name: fem.Constant(mesh, float(np.sum(cell_values(mesh, value, some, name))))
        for name, value in material.parameters.items()
    }
    P = ufl.diff(material.energy(F, parameters), F)
    A = ufl.diff(P, F)
    moduli = [A[i, j, i, j] for i in range(3) for j in range(3)]
    # An energy without parameters must contain the mesh too.
    values = fem.Constant(mesh, 1.0) * ufl.as_vector(
        [P[i, j] for i, j in np.ndindex(3, 3)] + moduli
    )
    point = np.zeros((1, mesh.topology.dim))
    expression = compile_expression(values, point, mesh.comm, name="stress at rest")
    here = mesh.topology.index_map(mesh.topology.dim).size_local > 0
    row = expression.eval(mesh, np.zeros(int(here), dtype=np.int32)).reshape(-1, 18)
    rows = np.concatenate(mesh.comm.allgather(row))
    return rows[0, :9].reshape(3, 3), rows[0, 9:]


def check_approximation(mesh: Mesh, degree: int, kinematics: str, residual: str) -> None:
    """Check the degree, also against that of the cells, the kinematics and the residual.

    In a curved cell with X(xi) of degree p, displacements u(xi) of degree k < p do not contain
    affine functions of X: for a constant strain grad u, and the tractions of an interface, would
    have an error of the order of the curvature on any mesh.
    """
    if not isinstance(degree, Real) or degree < 1 or degree % 1:
        raise ValueError(f"Problem: degree = {degree!r} must be an integer, at least 1")
    if kinematics not in KINEMATICS:
        raise ValueError(f"Problem: kinematics = {kinematics!r} must be one of {KINEMATICS}")
    if residual not in RESIDUALS:
        raise ValueError(
            f"Problem: residual = {residual!r} must be one of {RESIDUALS}: how the interface terms "
            "of (27) are summed"
        )
    geometry = compat.coordinate_element(mesh).degree
    if geometry > degree:
        raise ValueError(
            f"Problem: the cells of the mesh are curved, of degree {geometry}, the displacement "
            f"has degree {degree}, which cannot represent constant strain on such cells; use "
            f"degree={geometry}, or mesh with straight cells (gmsh: mesh.setOrder({degree}))"
        )


def check_condition(what: str, where: Any, value: Any) -> None:
    if isinstance(where, fem.DirichletBC) or isinstance(value, fem.DirichletBC):
        raise TypeError(
            f"{what}: a DirichletBC of DOLFINx belongs to the dofs of another space than the "
            "displacement of the problem, which has two at a node of an interface; write "
            "problem.dirichlet(facets, value, component), the value as a number, array, Constant, "
            "Function, lambda t: ... or lambda x, t: ..."
        )
    if value is None:
        raise TypeError(f"{what}: the value is missing; 0.0 fixes the nodes")


def check_rigid_face(
    d: int, small: bool, component: int | str | None, tilts: bool, at: ArrayLike | None
) -> None:
    if tilts and component is None and not small:
        raise ValueError(
            "rigid_face: all components of a tilting face form a rigid rotation, which is linear "
            "at small strain only: use kinematics='small', one component, tilts=False, or a stiff "
            "body as the plate"
        )
    if tilts and at is None:
        raise ValueError(
            "rigid_face: a tilting face requires at=, the point of the force and the displacement, "
            "for example its centre"
        )
    point = np.zeros(d) if at is None else np.asarray(at)
    if point.shape != (d,) or point.dtype.kind not in "iuf" or not np.isfinite(point).all():
        raise ValueError(f"rigid_face: at = {at!r} must be a point of {d} finite coordinates")


def check_pairs(facets: Sequence[InterfaceFacets], others: Mapping[str, bool]) -> None:
    """Check what is given together with interfaces whose meshes do not match: ``others`` says
    whether the problem has a feature, by what the user wrote for it."""
    present = [name for name, given in others.items() if given]
    for selected in facets:
        if selected.paired and present:
            raise ValueError(
                f"{selected.label} is {NONMATCHING}, which cannot be combined with {present[0]}; "
                "omit it, or make the meshes match (gmsh.model.occ.fragment)"
            )


def check_overlap(mesh: Mesh, facets: Sequence[InterfaceFacets]) -> None:
    """Check that every facet belongs to one interface, or two of them that lie opposite each other;
    collective."""
    taken, message = np.full(len(facet_cells(mesh)), -1), None
    paired: list[PairedFacets] = []
    for number, selected in enumerate(facets):
        if isinstance(selected, PairedFacets):
            for other in paired:
                if len(twice := selected.shared(other)) and message is None:
                    message = (
                        f"{other.label} and {selected.label} both join or separate facets "
                        f"{twice[0, 0]} and {twice[0, 1]}; give two surfaces that lie opposite "
                        "each other one interface"
                    )
            paired.append(selected)
            continue
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
    """Check that no interface that can fail lies on the tied boundary of a periodic cell;
    collective."""

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
        remedy = "shift the cell so that its boundary cuts the bodies"
        if interface.between is not None:
            between = np.unique(everywhere(np.sort(tags[selected.cells], axis=1)), axis=0)
            lies = (across[:, None] == between).all(axis=2).any(axis=1)
        elif interface.level_set is not None:
            lies = np.diff(everywhere(cells_inside(mesh, interface.level_set)[cells])[faces])[:, 0]
            remedy += ", or select facets inside of it by facets="
        elif callable(interface.facets):
            chosen = locate_entities(mesh, dim - 1, interface.facets)
            lies = everywhere(np.isin(outer, chosen))[faces].any(axis=1)
            remedy += ", or exclude its boundary from facets="
        else:
            continue
        if lies.any():
            place = min(rounded(middle[faces[lies, 0]]))
            raise ValueError(
                f"Periodic: {selected.label} would lie on the boundary of the cell at {place}, "
                f"where opposite faces are tied and cannot fail; {remedy}"
            )
