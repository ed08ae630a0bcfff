"""Supports and loads as a user gives them: checked, and imposed on the loading; rigid faces."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from dolfinx import fem
from numpy.typing import ArrayLike, NDArray
from ufl.core.expr import Expr

from ..assembly.dirichlet import (
    Where,
    find_boundary_facets,
    find_nodes,
    nodes_of_cells,
    nodes_of_facets,
    nodes_where,
)
from ..assembly.surface import Share
from ..assembly.values import Value, check_resultant, takes_points, value_at
from ..base.parallel import global_any, raise_together, warn_together
from ..base.tables import rounded
from ..domain.tags import Group, group_tag
from ..domain.topology import Locator, facet_cells, refuse_facets
from ..forms.geometry import Axisymmetric, GeneralizedPlane
from ..interface.activation import Activation
from ..points.interface import Interface, number_of
from .arguments import check_condition, check_rigid_face
from .loading import Loading


class Drive(NamedTuple):
    """Load on one component of H = F_bar - I, the mean gradient of a periodic cell, or on F_33 - 1.

    Attributes:
        prescribed: Whether H_ij is given; otherwise the mean stress P_ij is [MPa], or the force
            along z [N].
    """

    row: int
    column: int
    prescribed: bool
    value: Value


class LoadCalls:
    """What a user calls to support and load a problem.

    Functions passed on to the loading keep no reference to this object, nor to the loading: a
    reference cycle would keep meshes alive after a problem is deleted, and their communicators, of
    which MPICH has 2048.
    """

    def __init__(self, loading: Loading, activation: Activation, names: dict[str, int]):
        self._loading, self._activation, self._names = loading, activation, names
        self._mesh, self._bodies = loading.discretization.mesh, loading.discretization.bodies
        self._move_walls()

    @property
    def _space(self) -> fem.FunctionSpace:
        return self._loading.discretization.space

    # Supports

    def dirichlet(
        self, facets: Where, value: Value | Expr, component: int | str | None, relative: bool
    ) -> None:
        check_condition("dirichlet", facets, value)
        facets = find_boundary_facets(self._mesh, facets, "dirichlet")
        reason = (
            "lies on an interface, whose two sides would be tied; prescribe boundary facets, or "
            "exclude these from the interface"
        )
        self._activation.refuse(facets, "dirichlet", reason)
        if relative and self._activation:
            raise ValueError(
                "dirichlet: relative=True cannot be combined with activate='on-demand'; prescribe "
                "the displacement from the start"
            )
        start = self._loading.discretization.u.x.array.copy() if relative else None

        def impose(loading: Loading) -> None:
            space = loading.discretization.space
            nodes = nodes_of_facets(space, facets)
            base = None if start is None else start.reshape(-1, space.dofmap.index_map_bs)[nodes]
            loading.dirichlet.add(nodes, value, component, "dirichlet", base)

        self._loading.add(impose)
        if start is not None:
            self._loading.given.starts.append(start)

    def dirichlet_points(
        self, where: Locator, value: Value | Expr, component: int | str | None
    ) -> None:
        what = "dirichlet_points"
        check_condition(what, where, value)
        find_nodes(self._space, where, what)

        def impose(loading: Loading) -> None:
            nodes = nodes_where(loading.discretization.space, where, what)
            loading.dirichlet.add(nodes, value, component, what)

        self._loading.add(impose)

    def drive_means(self, drives: Sequence[Drive]) -> None:
        """Apply loads to components of the mean gradient of a periodic cell, see
        :class:`vmdg.Periodic`, and to F_33, see :class:`vmdg.GeneralizedStrain`."""
        if drives:
            self._loading.add(partial(_drive_means, drives), of_means=True)

    def _move_walls(self) -> None:
        """Prescribe the nodes of rigid walls, see :class:`vmdg.Rigid`; collective."""
        d, ring = self._mesh.geometry.dim, isinstance(self._bodies.geometry, Axisymmetric)
        for tag, value in self._bodies.walls.items():
            what, cells = f"Rigid: displacement of tag {tag}", self._bodies.cells_of[tag]
            if ring or not (self._bodies.small and takes_points(value, what)):
                check_resultant(self._mesh.comm, value, [(), (d,)], what)
                if ring and any(np.ravel(value_at(value, t))[0] for t in (0.0, 1.0)):
                    raise ValueError(f"{what}: in axisymmetry a rigid wall can only move along z")
            self._loading.add(partial(_move_wall, cells, value, what))

    def rigid_face(
        self,
        where: Where,
        component: int | str | None,
        tilts: bool,
        at: ArrayLike | None,
        force: Value | None,
        displacement: Value | None,
    ) -> int:
        check_rigid_face(self._mesh.geometry.dim, self._bodies.small, component, tilts, at)
        if force is not None and displacement is not None:
            raise ValueError("rigid_face: give force or displacement, not both")
        facets, number = self.boundary(where, "rigid_face"), len(self._loading.rigid.faces)
        point = None if at is None else np.asarray(at, dtype=float)

        def impose(loading: Loading) -> None:
            nodes = nodes_of_facets(loading.discretization.space, facets)
            face = loading.rigid.add(nodes, component, tilts, point, displacement)
            if force is not None:
                loading.dead.add_face_load(face, force)

        self._loading.add(impose, [] if force is None else self._behind(facets))
        return number

    # Facets

    def boundary(self, where: Where, what: str) -> NDArray[np.int32]:
        facets = find_boundary_facets(self._mesh, where, what)
        remedy = {
            "traction": "or let an interface transmit the traction",
            "pressure": "or the interface itself for a fluid between its faces",
        }
        reason = "lies inside the mesh and would load one of its sides; give boundary facets"
        if what in remedy:
            reason += f", {remedy[what]}"
        inside = (facet_cells(self._mesh) >= 0).all(axis=1)
        refuse_facets(self._mesh, facets, inside, what, reason)
        if what != "rigid_face":
            self._check_opposite(facets, what)
        return facets

    def _check_opposite(self, facets: NDArray[np.int32], what: str) -> None:
        """Check for facets opposite another body, whose contact would take the load, a part of P.N
        there, for its own traction; collective."""
        for other in self._activation.facets:
            if not other.paired:
                continue
            joined = np.zeros(len(facet_cells(self._mesh)), dtype=bool)
            joined[other.everywhere] = True
            where = f"lies opposite the other side of {other.label}, whose traction it would change"
            if not other.slides:
                refuse_facets(self._mesh, facets, joined, what, f"{where}; leave it out")
            elif global_any(self._mesh.comm, joined[facets].any()):
                warn_together(
                    self._mesh.comm,
                    f"{what}: a facet {where} wherever they touch; leave out facets that come into "
                    "contact",
                )

    def _behind(self, facets: NDArray[np.int32]) -> NDArray[np.int32]:
        return facet_cells(self._mesh)[facets, 0]

    # Dead loads

    def traction(self, facets: Where, value: Value | Expr) -> None:
        facets = self.boundary(facets, "traction")
        self._loading.add(lambda to: to.dead.add_traction(facets, value), self._behind(facets))

    def body_force(self, value: Value | Expr, tag: Group | None) -> None:
        if np.ndim(tag) != 0:
            raise ValueError(f"body_force: tag = {tag} must be one tag; call it once for each")
        tag, cells_of = group_tag(tag, self._names, "body_force"), self._bodies.cells_of
        if tag is not None and tag not in cells_of:
            raise ValueError(f"body_force: no cell has tag {tag}; tags are {sorted(cells_of)}")
        cells = np.arange(len(self._bodies.tags)) if tag is None else cells_of[tag]
        self._loading.add(lambda to: to.dead.add_body_force(cells.astype(np.int32), value), cells)

    def point_load(self, where: Locator, value: Value, component: int | str | None) -> None:
        check_condition("point_load", where, value)
        loaded = find_nodes(self._space, where, "point_load")
        self._refuse_split_nodes(loaded)

        def impose(loading: Loading) -> None:
            nodes = find_nodes(loading.discretization.space, where, "point_load")
            loading.dead.add_point_load(nodes, value, component)

        touched = np.isin(self._space.dofmap.list, loaded).any(axis=1)
        self._loading.add(impose, np.flatnonzero(touched[: len(self._bodies.tags)]))

    def _refuse_split_nodes(self, loaded: NDArray[np.int32]) -> None:
        """Check for nodes of an interface, which are duplicated, or will be when facets open on
        demand."""
        x, message = self._space.tabulate_dof_coordinates(), None
        for facets in self._activation.facets:
            nodes = nodes_of_facets(self._space, facets.everywhere)
            selected = nodes[np.isin(nodes, loaded)]
            if len(selected) and message is None:
                message = (
                    f"point_load: the node at {rounded(x[selected[0]])} lies on "
                    f"{facets.label}, where it is duplicated; load a neighbouring node"
                )
        raise_together(self._mesh.comm, message)

    # Pressures and springs

    def pressure(
        self, where: Where | Interface | str, value: Value, debonded: bool, share: Share | None
    ) -> None:
        constant = isinstance(value, fem.Constant) and value is not self._loading.load_factor
        if isinstance(value, Expr) and not constant:
            raise ValueError(
                "pressure: a UFL expression cannot be evaluated along the load path; give a "
                "number, f(t) or f(x, t) at points x (3, n)"
            )
        thickens = self._bodies.plane_stress or isinstance(self._bodies.geometry, GeneralizedPlane)
        if thickens and not self._bodies.small:
            raise ValueError(
                "pressure: a surface of a body in plane stress or generalized plane strain changes "
                "its thickness with the strain, which follower loads neglect; use traction(), "
                "plane='strain', 3D, or kinematics='small'"
            )
        if isinstance(where, Interface | str):
            self._fluid(where, value, debonded, share)
            return
        if debonded or share is not None:
            raise ValueError("pressure: debonded and share apply to interfaces, not to a boundary")
        facets = self.boundary(where, "pressure")
        self._loading.add(lambda to: to.surface.add_pressure(facets, value), self._behind(facets))

    def _fluid(
        self, which: Interface | str, value: Value, debonded: bool, share: Share | None
    ) -> None:
        number = number_of(self._activation.interfaces, which)
        interface, facets = self._activation.interfaces[number], self._activation.facets[number]
        if not interface.law.inelastic:
            raise ValueError(
                f"pressure: {facets.label} is a tie, which has no gap for a fluid; give it a law "
                "that can fail, or vmdg.Contact() for a pre-existing crack"
            )
        if interface.activate == "on-demand" and not debonded:
            raise ValueError(
                f"pressure: {facets.label} opens on demand, and closed facets admit no fluid; give "
                "debonded=True"
            )
        if facets.slides:
            raise ValueError(
                f"pressure: {facets.label} slides at finite strain, and where a fluid between "
                "faces that leave each other ends is not known; use sliding=False, or "
                "kinematics='small'"
            )

        def impose(loading: Loading) -> None:
            now = loading.discretization
            if number in now.active:
                loading.surface.add_fluid(now.take_fluid(number), value, debonded, share)

        self._loading.add(impose, facets.cells)
        self._loading.given.filled.add(number)

    def spring(self, where: Where, stiffness: ArrayLike) -> None:
        facets = self.boundary(where, "spring")
        self._loading.add(lambda to: to.surface.add_spring(facets, stiffness))


def _drive_means(drives: Sequence[Drive], loading: Loading) -> None:
    means, geometry = loading.discretization.means, loading.discretization.geometry
    d, length = loading.discretization.mesh.geometry.dim, means.length
    for drive in drives:
        axial = drive.column == d
        area = float(geometry.thickness) * (1.0 if axial else means.lattice.volume) / length
        factor = length if drive.prescribed else area

        def value(t: float, given: Value = drive.value, factor: float = factor) -> NDArray:
            return factor * value_at(given, t)

        place = means.entries.index((drive.row, drive.column))
        node, component = divmod(means.dofs[place : place + 1], d)
        if drive.prescribed:
            what = "GeneralizedStrain" if axial else "Periodic"
            loading.dirichlet.add(node, value, int(component[0]), what)
        else:
            loading.dead.add_point_load(node, value, int(component[0]))


def _move_wall(cells: NDArray[np.int32], value: Value, what: str, loading: Loading) -> None:
    nodes = nodes_of_cells(loading.discretization.space, cells)
    loading.dirichlet.add(nodes, value, None, what)


class RigidMotion:
    """Motion of a rigid face, see :meth:`vmdg.Problem.rigid_face`.

    Args:
        loading: The loading with the face.
        number: Number of the face.
    """

    def __init__(self, loading: Loading, number: int):
        self._loading, self._number = loading, number

    def displacement(self) -> float | NDArray[np.float64]:
        """Displacement of its point, a number with one component, else (d,) [mm]; collective."""
        faces = self._loading.rigid
        face = faces.faces[self._number]
        found = faces.displacement(face)
        return found if face.component is None else float(found[0])

    def rotation(self) -> float | NDArray[np.float64]:
        """Rotation, about z in 2D, about the axes (3,) in 3D [rad]; collective."""
        faces = self._loading.rigid
        angles = faces.rotation(faces.faces[self._number])
        if len(angles) == 1:
            return float(angles[0])
        xy, xz, yz = angles
        return np.array([yz, -xz, xy])
