"""Loads on a problem at its load factor: prescribed displacements, dead loads, eigenstrains."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from dolfinx import fem
from numpy.typing import ArrayLike, NDArray
from ufl.core.expr import Expr

from ..assembly.dirichlet import (
    AXES,
    DirichletConditions,
    Where,
    find_boundary_facets,
    find_nodes,
    nodes_of_cells,
    nodes_where,
)
from ..assembly.discretization import Discretization
from ..assembly.loads import DeadLoads
from ..assembly.means import lattice_of
from ..assembly.rigid import RigidFaces
from ..assembly.surface import Share
from ..assembly.values import Part, Value, check_resultant, not_finite, takes_points, value_at
from ..base.agreement import together
from ..base.parallel import global_any, global_sum, raise_together, warn_together
from ..base.tables import rounded
from ..domain.geometry import axis_dofs
from ..domain.tags import Group, group_tag
from ..domain.topology import Locator, facet_cells, refuse_facets
from ..forms.geometry import Axisymmetric, GeneralizedPlane
from ..interface.activation import Activation
from ..points.interface import Interface, number_of
from .arguments import check_condition, check_rigid_face
from .eigenstrain import refusal

Array = NDArray[np.float64]

#: Names of loads, in the order of :attr:`Ray.parts`.
KINDS = (
    "a prescribed displacement",
    "a dead load",
    "a pressure",
    "the displacement of a rigid face",
    "an eigenstrain",
)

#: Positions between two load factors at which loads are checked for linearity, and its tolerance.
PROBES, STRAIGHT = (0.382, 0.5), 1e-9


class Drive(NamedTuple):
    """Load on one component of H = F_bar - I, the mean gradient of a periodic cell, or on F_33 - 1.

    Attributes:
        row, column: i and j of H_ij.
        prescribed: Whether H_ij is given; otherwise the mean stress P_ij is [MPa], or the force
            along z [N].
        value: A number or f(t).
    """

    row: int
    column: int
    prescribed: bool
    value: Value


class Given(NamedTuple):
    """Information on the loads and supports given so far.

    Attributes:
        loaded: Whether dead loads act on a cell, for every local cell.
        starts: Initial displacement of all local dofs for every support with ``relative=True``, in
            the order given [mm].
        filled: Numbers of the interfaces with a fluid between their faces.
        calls: Every support and load as a function that imposes it in a new space.
    """

    loaded: NDArray[np.bool_]
    starts: list[Array]
    filled: set[int]
    calls: list[Callable[[Loading], None]]


class Ray(NamedTuple):
    """Loads and prescribed displacements that are linear in the load factor.

    Attributes:
        start: Load factor.
        end: Another load factor.
        prescribed: Prescribed displacements at both [mm].
        vectors: Dead loads over local dofs at both [N].
        pressures: Pressures at both [MPa].
        faces: Prescribed displacements of points of rigid faces at both [mm].
        strains: Eigenstrains of all local cells at both.
    """

    start: float
    end: float
    prescribed: tuple[Array, Array]
    vectors: tuple[Array, Array]
    pressures: tuple[Array, Array]
    faces: tuple[Array, Array]
    strains: tuple[Array, Array]

    def at(self, ends: tuple[Array, Array], t: float) -> Array:
        """Values at load factor ``t``, also beyond the ends."""
        share = (t - self.start) / (self.end - self.start)
        return (1 - share) * ends[0] + share * ends[1]

    def rate(self, ends: tuple[Array, Array]) -> Array:
        """Derivative by the load factor."""
        return (ends[1] - ends[0]) / (self.end - self.start)

    @property
    def parts(self) -> tuple[tuple[Array, Array], ...]:
        """All linear quantities, at both ends."""
        return self.prescribed, self.vectors, self.pressures, self.faces, self.strains


class Loading:
    """Prescribed displacements, dead loads and eigenstrains, as functions of the load factor.

    The input is stored, since facets that open on demand change the space.

    Args:
        discretization: The loaded discretization.
        activation: Facets of the interfaces.
        names: Tag by name of the groups of cells.

    Attributes:
        nearby: Whether the state is for the moment one of a neighbouring value of a parameter, at
            which a monitor is differentiated.
        load_factor: t as a UFL constant.
        dirichlet: Prescribed displacements in the current space.
        rigid: Its rigid faces.
        given: Information on loads and supports.
        parts: Parts of the problem by the interfaces that are intact, see
            :func:`.supports.parts_of`; forgotten when a load or support is added.
        t: Load factor.
    """

    def __init__(
        self, discretization: Discretization, activation: Activation, names: dict[str, int]
    ):
        self._mesh = mesh = discretization.mesh
        self._bodies = discretization.bodies
        self._activation = activation
        self._interfaces = activation.interfaces
        self._names = names
        # Functions of this object, not bound methods: a reference cycle would keep meshes alive
        # after a problem is deleted, and their communicators, of which MPICH has 2048.
        self._ray: Ray | None = None
        self.nearby, self._anchored = False, True
        self.load_factor, self.t = fem.Constant(mesh, 0.0), 0.0
        self.given = Given(np.zeros(len(self._bodies.tags), dtype=bool), [], set(), [])
        self.follow(discretization)
        self._move_walls()

    def follow(self, discretization: Discretization) -> None:
        """Apply all loads to another discretization."""
        self._discretization, space = discretization, discretization.space
        self.parts: dict[tuple[int, ...], Any] = {}
        self._vector: NDArray[np.float64] | None = None
        geometry = discretization.geometry
        self.dirichlet = DirichletConditions(space, self._zeros())
        self.rigid = RigidFaces(discretization.u, geometry)
        self._loads = DeadLoads(discretization.u, geometry)
        self._surface = discretization.new_surface()
        for impose in self.given.calls:
            impose(self)
        if self._ray is not None:
            self._ray = self._ray_between(self._ray.start, self._ray.end)
        self.move(self.t)

    def _zeros(self) -> NDArray[np.int32]:
        """Local dofs that are zero for every load."""
        parts = self._discretization
        if parts.means is None:
            return axis_dofs(parts.space, parts.geometry)
        return parts.means.fixed if self._anchored else parts.means.spare

    def _add(self, impose: Callable[[Loading], None], of_means: bool = False) -> None:
        """Apply a load or prescribed displacement now, and in all later spaces.

        Args:
            impose: Applies it in the current space.
            of_means: Whether it acts on a mean, as allowed in a periodic cell.

        Raises:
            ValueError: it conflicts with a rigid face or a periodic cell, and is not applied.
        """
        if lattice_of(self._discretization.means) is not None and not of_means:
            raise ValueError(
                "a periodic cell has no supports and loads: its load is the mean strain or stress "
                "of Periodic(...), and its boundary lies inside the material"
            )
        impose(self)
        try:
            self._refuse_held_faces()
        except ValueError:
            self.follow(self._discretization)
            raise
        self.given.calls.append(impose)
        self._vector = None
        self.parts.clear()

    # Prescribed displacements

    def add_dirichlet(
        self, facets: Where, value: Value | Expr, component: int | str | None, relative: bool
    ) -> None:
        """See :meth:`vmdg.Problem.dirichlet`."""
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
        self._prescribe("dirichlet", facets, value, component, relative)

    def add_dirichlet_points(
        self, where: Locator, value: Value | Expr, component: int | str | None
    ) -> None:
        """See :meth:`vmdg.Problem.dirichlet_points`."""
        check_condition("dirichlet_points", where, value)
        find_nodes(self._discretization.space, where, "dirichlet_points")
        self._prescribe("dirichlet_points", where, value, component)

    def _prescribe(
        self,
        what: str,
        where: NDArray[np.int32] | Locator,
        value: Value | Expr,
        component: int | str | None,
        relative: bool = False,
    ) -> None:
        start = self._discretization.u.x.array.copy() if relative else None

        def impose(loading: Loading) -> None:
            space = loading._discretization.space
            if callable(where):
                dofs = nodes_where(space, where, what)
            else:
                dofs = fem.locate_dofs_topological(space, space.mesh.topology.dim - 1, where)
            bs = space.dofmap.index_map_bs
            base = None if start is None else start.reshape(-1, bs)[dofs]
            loading.dirichlet.add(dofs, value, component, what, base)

        self._add(impose)
        if start is not None:
            self.given.starts.append(start)

    @property
    def prescribed(self) -> NDArray[np.int32]:
        """Prescribed local dofs (component-wise numbers), ghosts included."""
        return self.dirichlet.dofs

    @property
    def owned_prescribed(self) -> NDArray[np.int32]:
        """Those of :attr:`prescribed` that this rank owns."""
        return self.prescribed[self.prescribed < self._discretization.owned]

    def prescribed_values(self, t: float) -> NDArray[np.float64]:
        """Prescribed displacement of :attr:`prescribed` at load factor ``t`` [mm]."""
        if self._ray is not None:
            return self._ray.at(self._ray.prescribed, t)
        return self.dirichlet.values(t)

    # Means

    def drive_means(self, drives: Sequence[Drive]) -> None:
        """Apply loads to components of the mean gradient of a periodic cell, see
        :class:`vmdg.Periodic`, and to F_33, see :class:`vmdg.GeneralizedStrain`."""
        if drives:
            self._add(lambda loading: loading._drive_means(drives), of_means=True)

    def _drive_means(self, drives: Sequence[Drive]) -> None:
        means, geometry = self._discretization.means, self._discretization.geometry
        d, length = self._mesh.geometry.dim, means.length
        for drive in drives:
            axial = drive.column == d
            area = float(geometry.thickness) * (1.0 if axial else means.lattice.volume) / length
            factor = length if drive.prescribed else area

            def value(t: float, given: Value = drive.value, factor: float = factor) -> Array:
                return factor * value_at(given, t)

            place = means.entries.index((drive.row, drive.column))
            node, component = divmod(means.dofs[place : place + 1], d)
            if drive.prescribed:
                what = "GeneralizedStrain" if axial else "Periodic"
                self.dirichlet.add(node, value, int(component[0]), what)
            else:
                self._loads.add_point_load(node, value, int(component[0]))

    # Rigid walls and faces

    def _move_walls(self) -> None:
        """Prescribe the nodes of rigid walls, see :class:`vmdg.Rigid`; collective.

        Raises:
            ValueError: a displacement is not a displacement, depends on x at finite strain, or is
                radial in axisymmetry.
        """
        d, ring = self._mesh.geometry.dim, isinstance(self._bodies.geometry, Axisymmetric)
        for tag, value in self._bodies.walls.items():
            what = f"Rigid: displacement of tag {tag}"
            if ring or not (self._bodies.small and takes_points(value, what)):
                check_resultant(self._mesh.comm, value, [(), (d,)], what)
                if ring and any(np.ravel(value_at(value, t))[0] for t in (0.0, 1.0)):
                    raise ValueError(f"{what}: in axisymmetry a rigid wall can only move along z")

            def impose(
                loading: Loading, tag: int = tag, value: Value = value, what: str = what
            ) -> None:
                space = loading._discretization.space
                nodes = nodes_of_cells(space, loading._bodies.cells_of[tag])
                loading.dirichlet.add(nodes, value, None, what)

            self._add(impose)

    def add_rigid_face(
        self,
        where: Where,
        component: int | str | None,
        tilts: bool,
        at: ArrayLike | None,
        force: Value | None,
        displacement: Value | None,
    ) -> int:
        """See :meth:`vmdg.Problem.rigid_face`; returns its number."""
        check_rigid_face(self._mesh.geometry.dim, self._bodies.small, component, tilts, at)
        if force is not None and displacement is not None:
            raise ValueError("rigid_face: give force or displacement, not both")
        facets, number = self.boundary(where, "rigid_face"), len(self.rigid.faces)
        point = None if at is None else np.asarray(at, dtype=float)

        def impose(loading: Loading) -> None:
            space = loading._discretization.space
            nodes = fem.locate_dofs_topological(space, space.mesh.topology.dim - 1, facets)
            face = loading.rigid.add(nodes, component, tilts, point, displacement)
            if force is not None:
                loading._loads.add_face_load(face, force)

        self._add(impose)
        if force is not None:
            self.given.loaded[facet_cells(self._mesh)[facets, 0]] = True
        return number

    def _refuse_held_faces(self) -> None:
        """Check that nodes of rigid faces have no other constraint.

        Raises:
            ValueError: one belongs to two faces, or its displacement is prescribed.
        """
        if not self.rigid:
            return
        dofs, d = self.rigid.dofs, self._discretization.space.dofmap.index_map_bs
        chosen, counts = np.unique(dofs, return_counts=True)
        held, message = np.isin(chosen, self.prescribed), None
        wrong = chosen[held | (counts > 1)]
        if len(wrong):
            node, axis = divmod(int(wrong[0]), d)
            x = self._discretization.space.tabulate_dof_coordinates()[node, :d]
            other = "is prescribed too" if held.any() else "belongs to two rigid faces"
            message = (
                f"rigid_face: the displacement along {AXES[axis]} of the node at "
                f"{rounded(x)} {other}; give the rigid face another component, or exclude the "
                "facets at this node from one of them"
            )
        raise_together(self._mesh.comm, message)

    def away(self, t: float) -> Array:
        """Difference between prescribed displacements at load factor ``t`` and current ones, on
        owned dofs, zero at free dofs; collective [mm]."""
        u, result = self._discretization.u.x.array, np.zeros(self._discretization.owned)
        owned = self.owned_prescribed
        result[owned] = self.prescribed_values(t)[: len(owned)] - u[owned]
        if self.rigid:
            ray = self._ray
            values = self.rigid.values(t) if ray is None else ray.at(ray.faces, t)
            result += self.rigid.lifted(values - self.rigid.displacements())
        return result

    def rate(self) -> Array:
        """Derivative of prescribed displacements by the load factor along the ray, as
        :meth:`away`."""
        ray, result = self._ray, np.zeros(self._discretization.owned)
        owned = self.owned_prescribed
        result[owned] = ray.rate(ray.prescribed)[: len(owned)]
        return result + self.rigid.lifted(ray.rate(ray.faces))

    def balance(self, forces: Array) -> Array:
        """Remove the reactions of supports and rigid faces from forces on owned dofs, in place;
        collective [N]."""
        forces[self.owned_prescribed] = 0
        self.rigid.balance(forces)
        return forces

    # Dead loads

    def add_traction(self, facets: Where, value: Value | Expr) -> None:
        """See :meth:`vmdg.Problem.traction`."""
        facets = self.boundary(facets, "traction")
        self._add(lambda loading: loading._loads.add_traction(facets, value))
        self.given.loaded[facet_cells(self._mesh)[facets, 0]] = True

    def boundary(self, where: Where, what: str) -> NDArray[np.int32]:
        """Facets of the boundary.

        Raises:
            ValueError: one lies inside the mesh, or opposite a body to which it is joined.
        """
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
        there, for its own traction; collective.

        Raises:
            ValueError: they are joined to it for good.
        """
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

    def add_body_force(self, value: Value | Expr, tag: Group | None) -> None:
        """See :meth:`vmdg.Problem.body_force`."""
        if np.ndim(tag) != 0:
            raise ValueError(f"body_force: tag = {tag} must be one tag; call it once for each")
        tag, cells_of = group_tag(tag, self._names, "body_force"), self._bodies.cells_of
        if tag is not None and tag not in cells_of:
            raise ValueError(f"body_force: no cell has tag {tag}; tags are {sorted(cells_of)}")
        cells = np.arange(len(self._bodies.tags)) if tag is None else cells_of[tag]
        self._add(lambda loading: loading._loads.add_body_force(cells.astype(np.int32), value))
        self.given.loaded[cells] = True

    def add_point_load(self, where: Locator, value: Value, component: int | str | None) -> None:
        """See :meth:`vmdg.Problem.point_load`."""
        check_condition("point_load", where, value)
        space = self._discretization.space
        cells, loaded = space.dofmap.list, find_nodes(space, where, "point_load")
        self._refuse_split_nodes(loaded)

        def impose(loading: Loading) -> None:
            nodes = find_nodes(loading._discretization.space, where, "point_load")
            loading._loads.add_point_load(nodes, value, component)

        self._add(impose)
        self.given.loaded[np.isin(cells, loaded).any(axis=1)[: len(self.given.loaded)]] = True

    def _refuse_split_nodes(self, loaded: NDArray[np.int32]) -> None:
        """Check for nodes of an interface, which are duplicated, or will be when facets open on
        demand.

        Raises:
            ValueError: one is selected.
        """
        space = self._discretization.space
        x, message = space.tabulate_dof_coordinates(), None
        dim = self._mesh.topology.dim - 1
        for facets in self._activation.facets:
            nodes = fem.locate_dofs_topological(space, dim, facets.everywhere)
            selected = nodes[np.isin(nodes, loaded)]
            if len(selected) and message is None:
                message = (
                    f"point_load: the node at {rounded(x[selected[0]])} lies on "
                    f"{facets.label}, where it is duplicated; load a neighbouring node"
                )
        raise_together(self._mesh.comm, message)

    @property
    def vector(self) -> NDArray[np.float64]:
        """Loads at the current load factor, and pressures at the current displacement, over local
        dofs, before ghosts are added to owners [N]; collective."""
        if self._vector is None:
            ray, t = self._ray, self.t
            self._vector = self._vector_at(t) if ray is None else ray.at(ray.vectors, t)
        return self._vector + self._surface.load_vector() if self.pressurised else self._vector

    def _vector_at(self, t: float) -> Array:
        """The given dead loads at load factor ``t``."""
        if not self._loads:
            return np.zeros_like(self._discretization.u.x.array)
        self.load_factor.value = t
        vector = self._loads.vector(t)
        self.load_factor.value = self.t
        return vector

    # Pressures and springs

    def add_pressure(
        self, where: Where | Interface | str, value: Value, debonded: bool, share: Share | None
    ) -> None:
        """See :meth:`vmdg.Problem.pressure`."""
        constant = isinstance(value, fem.Constant) and value is not self.load_factor
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
            self._add_fluid(where, value, debonded, share)
            return
        if debonded or share is not None:
            raise ValueError("pressure: debonded and share apply to interfaces, not to a boundary")
        facets = self.boundary(where, "pressure")
        self._add(lambda loading: loading._surface.add_pressure(facets, value))
        self.move(self.t)
        self.given.loaded[facet_cells(self._mesh)[facets, 0]] = True

    def _add_fluid(
        self, which: Interface | str, value: Value, debonded: bool, share: Share | None
    ) -> None:
        number = number_of(self._interfaces, which)
        interface, label = self._interfaces[number], self._activation.facets[number].label
        if not interface.law.inelastic:
            raise ValueError(
                f"pressure: {label} is a tie, which has no gap for a fluid; give it a law that can "
                "fail, or vmdg.Contact() for a pre-existing crack"
            )
        if interface.activate == "on-demand" and not debonded:
            raise ValueError(
                f"pressure: {label} opens on demand, and closed facets admit no fluid; give "
                "debonded=True"
            )
        if self._activation.facets[number].slides:
            raise ValueError(
                f"pressure: {label} slides at finite strain, and where a fluid between faces that "
                "leave each other ends is not known; use sliding=False, or kinematics='small'"
            )

        def impose(loading: Loading) -> None:
            now = loading._discretization
            if number in now.active:
                loading._surface.add_fluid(now.take_fluid(number), value, debonded, share)

        self._add(impose)
        self.given.filled.add(number)
        self.move(self.t)
        self.given.loaded[self._activation.facets[number].cells] = True

    def add_spring(self, where: Where, stiffness: ArrayLike) -> None:
        """See :meth:`vmdg.Problem.spring`."""
        facets = self.boundary(where, "spring")
        self._add(lambda loading: loading._surface.add_spring(facets, stiffness))

    @property
    def pressurised(self) -> bool:
        """Whether there is a pressure."""
        return self._surface.pressurised

    def spread(self) -> None:
        """Let fluids spread to broken bonds."""
        self._surface.spread()
        self.move(self.t)

    # Load factor

    @property
    def ray(self) -> Ray | None:
        """The ray along which the load factor moves; None if loads are used as given."""
        return self._ray

    def set_ray(self, start: float, end: float) -> bool:
        """Treat loads as linear between two load factors from now on, if they are; collective.

        Returns:
            False, with loads used as given, if they are not linear or do not change.
        """
        self.clear_ray()
        if start == end:
            return False
        comm = self._mesh.comm
        ray = together(comm, lambda: self._ray_between(start, end))
        for t, values in zip((start, end), zip(*ray.parts, strict=True), strict=True):
            self._refuse_infinite(t, values)
        if not global_any(comm, any((one != other).any() for one, other in ray.parts)):
            return False
        probes = [start + share * (end - start) for share in PROBES]
        straight = together(comm, lambda: all([self._leads(ray, t) for t in probes]))
        if global_any(comm, not straight):
            return False
        self._ray, self._vector = ray, None
        return True

    def check_finite(self, t: float) -> list[Array]:
        """The given loads at load factor ``t``: displacements, loads, pressures, rigid faces and
        eigenstrains; collective.

        Raises:
            ValueError: one of them is not finite, or an eigenstrain of finite strain is -1 or less.
        """
        values = together(self._mesh.comm, lambda: [part(t) for part in self._given_parts])
        self._refuse_infinite(t, values)
        return values

    def _refuse_infinite(self, t: float, values: Sequence[Array]) -> None:
        message = None
        for kind, value in zip(KINDS, values, strict=True):
            if not np.isfinite(value).all():
                found = not_finite(self._parts_of(kind, t))
                message = (
                    f"{kind}{found and f' ({found})'} is not finite at load factor {t:.8g}: check "
                    "its function of the load factor there, for example a root or a quotient"
                )
        message = message or refusal(self._bodies, values[-1], t)
        raise_together(self._mesh.comm, message)

    def _parts_of(self, kind: str, t: float) -> Iterable[Part]:
        """All loads or supports of one kind."""
        if kind == "an eigenstrain":
            strains = self._bodies.strains(t)
            places = np.zeros((3, 0))
            return (
                Part(f"eigenstrain of tag {tag}", np.atleast_1d(e), places) for tag, e in strains
            )
        containers = self.dirichlet, self._loads, self._surface, self.rigid
        return containers[KINDS.index(kind)].parts(t)

    def as_given(self, t: float) -> bool:
        """Whether the current ray reproduces the given loads at ``t``; collective."""
        comm = self._mesh.comm
        return not global_any(comm, not together(comm, lambda: self._leads(self._ray, t)))

    def _leads(self, ray: Ray, t: float) -> bool:
        """Whether a ray reproduces the given loads at a load factor, on this rank."""
        leads = True
        for pair, at in zip(ray.parts, self._given_parts, strict=True):
            if pair[0].size:
                off = np.abs(at(t) - ray.at(pair, t)).max()
                leads &= bool(off <= STRAIGHT * np.abs(pair).max())
        return leads

    def clear_ray(self) -> None:
        """Use loads as given from now on."""
        self._ray, self._vector = None, None

    def _ray_between(self, start: float, end: float) -> Ray:
        return Ray(start, end, *(tuple(at(t) for t in (start, end)) for at in self._given_parts))

    @property
    def _given_parts(self) -> tuple[Callable[[float], Array], ...]:
        """The quantities of :attr:`Ray.parts` as given functions of the load factor."""
        displacements, faces = self.dirichlet.values, self.rigid.values
        strains = self._bodies.eigenstrains
        return displacements, self._vector_at, self._surface.pressures, faces, strains

    def strained(self, t: float, other: float) -> bool:
        """Whether eigenstrains differ between two load factors; collective."""
        if not self._bodies.grow:
            return False
        if self._ray is not None:
            one, another = self._ray.strains if t != other else (0.0, 0.0)
        else:
            one, another = (self._bodies.eigenstrains(factor) for factor in (t, other))
        return global_any(self._mesh.comm, bool(np.any(one != another)))

    def strain(self, t: float) -> None:
        """Set eigenstrains to load factor ``t`` of the current ray."""
        given = self._bodies.eigenstrains
        self._bodies.set_eigenstrains(
            given(t) if self._ray is None else self._ray.at(self._ray.strains, t)
        )

    def move(self, t: float) -> None:
        """Move to load factor ``t`` of the current ray, without imposing prescribed
        displacements."""
        self.load_factor.value = self.t = float(t)
        self._vector = None
        self.strain(t)
        if self.pressurised:
            ray, given = self._ray, self._surface.pressures
            pressures = given(t) if ray is None else ray.at(ray.pressures, t)
            self._surface.set_pressures(pressures)


def groups_of(loading: Loading) -> dict[str, int]:
    """Tag by name of the groups of cells; empty where they have no names."""
    return loading._names


def let_go(loading: Loading) -> None:
    """Let a periodic cell translate in time, where its momentum is kept."""
    if loading._anchored and lattice_of(loading._discretization.means) is not None:
        loading._anchored = False
        loading.dirichlet.fix(loading._zeros())


def anchor(loading: Loading) -> None:
    """Translate a periodic cell such that its anchor is where statics fixes it; collective."""
    if loading._anchored:
        return
    parts, d = loading._discretization, loading._mesh.geometry.dim
    owned, here = parts.means.anchor[parts.means.anchor < parts.owned], np.zeros(d)
    here[owned % d] = parts.u.x.array[owned]
    nodes = np.unique(parts.means.nodes)
    parts.u.x.array.reshape(-1, d)[nodes] -= global_sum(loading._mesh.comm, here)
    loading._anchored = True
    loading.dirichlet.fix(loading._zeros())
