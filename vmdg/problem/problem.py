"""The public problem: bodies connected by interfaces that may fail."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from html import escape
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh, MeshTags
from numpy.typing import ArrayLike, NDArray
from ufl.core.expr import Expr

from ..assembly.dirichlet import (
    Where,
    find_boundary_facets,
    find_nodes,
    nodes_of_cells,
    nodes_of_facets,
)
from ..assembly.discretization import Discretization
from ..assembly.indicator import cell_errors, facet_errors
from ..assembly.means import lattice_of
from ..assembly.stress import CauchyStress
from ..assembly.surface import BROKEN, Share
from ..assembly.values import Value
from ..base.agreement import of_all_ranks, same_arguments
from ..base.parallel import global_sum, raise_together
from ..base.tables import html_table
from ..domain.cells import check_cells
from ..domain.geometry import make_geometry
from ..domain.lattice import make_lattice
from ..domain.materials import Bodies
from ..domain.moduli import mean_modulus
from ..domain.point_bodies import BodyState
from ..domain.tags import Group, by_tag, group_tag, names_of
from ..domain.topology import Locator, facet_cells, tags_of_cells
from ..forms.materials import Material
from ..interface.activation import Activation
from ..interface.active import ActiveInterface, fine_scales
from ..interface.stabilization import Stabilization
from ..interface.values import InterfaceState
from ..points.facets import check_ghosts
from ..points.interface import (
    Interface,
    InterfaceList,
    Which,
    interface_names,
    label_of,
    number_of,
)
from ..points.pairing import place
from .arguments import (
    GENERALIZED,
    SYMBOLIC,
    check_approximation,
    check_cracking,
    check_faces,
    check_mesh,
    check_overlap,
    check_pairs,
    check_plane,
    check_points,
    check_rest,
    check_walls,
    checked_interfaces,
    checked_materials,
)
from .calls import LoadCalls, RigidMotion
from .damping import Rayleigh, checked_viscosity
from .eigenstrain import checked_eigenstrains, refusal
from .loading import Loading
from .motion import Motion, checked_density, moving
from .periodic import GeneralizedStrain, Periodic, checked_periodic, generalized
from .states import Energy, InterfaceMean, Snapshot
from .step import Step, energy_of

T = TypeVar("T")


class Problem:
    """Bodies connected by interfaces that may fail.

    Args:
        mesh: Triangles, quadrilaterals, tetrahedra or hexahedra; in 2D plane strain unless
            ``plane`` or ``symmetry`` says otherwise. On several ranks it needs facet ghosts
            (``GhostMode.shared_facet``).
        cell_tags: A tag for every cell. With :class:`vmdg.NamedTags` (meshes from gmsh have them)
            a group may be given by its name wherever a tag is expected.
        materials: Material of every tag, or :class:`vmdg.Rigid` for a wall.
        interfaces: Where and how the displacement may jump.
        degree: Degree of the displacement, at least that of the cells of the mesh.
        kinematics: "finite", or "small" for linear elasticity.
        thickness: Thickness of a plane body [mm].
        eigenstrain: Stress-free strain by tag: a number e, F_s = (1 + e) I, or a symmetric tensor
            (3, 3), F_s = I + e, with F = F_e F_s at finite strain; in axisymmetry its axes are r, z
            and hoop. Given as a value, a Constant, f(t), f(x, t) at midpoints x (3, n) of cells
            with e (n,) or (3, 3, n), a Function of degree 0, or an array over local cells.
        symmetry: "axisymmetric" makes a 2D mesh the half section of a body of revolution without
            torsion: x = r >= 0, y = z, displacement (u_r, u_z). Forces, energies, load vectors and
            the areas of interface points are those of the whole body; u_r = 0 is imposed on the
            axis and overrides other conditions there. None for plane strain and 3D.
        volumetric: "pointwise", or "mean" for mean dilatation (F-bar; B-bar at small strain): J is
            constant in a cell, so that quadrilaterals and hexahedra of degree 1 do not lock near
            incompressibility.
        periodic: Periodicity of the mesh and loads on its means, see :class:`Periodic`; None for a
            body with a surface.
        plane: "strain"; "generalized strain", in which F_33 is one number for the whole body,
            without force along z, or with a load given by :class:`GeneralizedStrain`; or "stress"
            for thin sheets, in the bodies and in the tractions of their interfaces: F_33 is such
            that P_33 vanishes. At finite strain hyperelastic materials need a ``free_stretch`` for
            that (:class:`NeoHookean` and :class:`Orthotropic` have one).
        density: Mass per reference volume by tag, for :func:`vmdg.solve_dynamics`; with N, mm and s
            in t/mm3. None for statics.
        damping: Rayleigh damping of the bodies in motion; None for none.
        residual: "symbolic" integrates the interface terms of (27) as they are written in UFL over
            interior facets, where that form exists: elastic bodies on one mesh, with facets open
            from the start, without eigenstrain, mean dilatation, generalized plane strain or
            fluid. Everywhere else, and with "points", they are summed over the points by the
            kernels that the tangent has too; both agree to rounding.

    Attributes:
        mesh: As given.
        comm: Communicator of the mesh.
        interfaces: As given.
        materials: Material of every tag.
        load_factor: Load factor as a UFL constant, for loads given as UFL expressions; its value
            is :attr:`t`.
        loading: Prescribed displacements and dead loads, for the solver.
        step: The protocol of a load step, for solvers and checkpoints.

    Raises:
        ValueError: invalid input; the message names it and the remedy.
        TypeError: an argument of the wrong type, such as a class instead of its instance.
        RuntimeError: a distributed mesh without facet ghosts, or PETSc with complex numbers.
    """

    def __init__(
        self,
        mesh: Mesh,
        cell_tags: MeshTags,
        materials: Mapping[Group, Material],
        interfaces: Sequence[Interface],
        degree: int = 1,
        kinematics: str = "finite",
        thickness: float = 1.0,
        eigenstrain: Mapping[Group, Any] | None = None,
        symmetry: str | None = None,
        volumetric: str = "pointwise",
        periodic: Periodic | None = None,
        plane: str | GeneralizedStrain = "strain",
        density: Mapping[Group, float] | None = None,
        damping: Rayleigh | None = None,
        residual: str = "symbolic",
    ):
        check_mesh(mesh, cell_tags)
        same_arguments(
            mesh.comm,
            "Problem",
            materials=materials,
            interfaces=interfaces,
            degree=degree,
            kinematics=kinematics,
            thickness=thickness,
            eigenstrain=eigenstrain,
            symmetry=symmetry,
            volumetric=volumetric,
            periodic=periodic,
            plane=plane,
            density=density,
            damping=damping,
            residual=residual,
        )
        self.interfaces = checked_interfaces(interfaces)
        check_approximation(mesh, degree, kinematics, residual)
        repeats = checked_periodic(periodic) is not None
        self._names = names = names_of(cell_tags)
        materials = by_tag(checked_materials(materials), names, "materials")
        axial = generalized(plane)
        word = GENERALIZED if axial else plane
        stress_only = check_plane(mesh, word, materials, kinematics, symmetry, volumetric)
        geometry = make_geometry(
            mesh, symmetry, thickness, volumetric, degree, repeats, axial is not None
        )
        check_ghosts(mesh)
        check_cells(mesh)
        self.mesh = mesh
        self.comm = mesh.comm
        check_rest(mesh, materials)
        locks = degree == 1 and volumetric == "pointwise" and not stress_only
        check_points(mesh, materials, self.interfaces, kinematics, locks)
        refused = {"a periodic cell": repeats, f"plane={GENERALIZED!r}": axial is not None}
        refused |= {"volumetric='mean'": volumetric == "mean", "density=": density is not None}
        check_cracking(materials, self.interfaces, refused)
        self.materials = MappingProxyType(materials)
        tags = tags_of_cells(mesh, cell_tags)
        lattice = make_lattice(mesh, periodic.vectors) if repeats else None
        strains = checked_eigenstrains(mesh, tags, eigenstrain, names)
        small = kinematics == "small"
        bodies = Bodies(mesh, tags, materials, small, strains, geometry, degree, stress_only)
        check_walls(bodies, strains, repeats, axial is not None)
        raise_together(mesh.comm, refusal(bodies, bodies.eigenstrains(0.0), 0.0))
        stiffness = partial(mean_modulus, mesh, bodies)
        facets = [
            place(
                mesh,
                tags,
                interface,
                names,
                label_of(self.interfaces, i),
                bodies.walls,
                stiffness,
                geometry,
                small,
            )
            for i, interface in enumerate(self.interfaces)
        ]
        check_pairs(facets, {"a periodic cell": repeats})
        check_overlap(mesh, facets)
        if lattice is not None:
            check_faces(mesh, tags, lattice, self.interfaces, facets)
        activation = Activation(mesh, self.interfaces, facets, bodies, degree)
        opened = activation.facets_among(activation.open)
        symbolic = residual == SYMBOLIC
        discretization = Discretization(
            mesh, bodies, self.interfaces, opened, degree, lattice, symbolic
        )
        self.loading = Loading(discretization, names)
        self.load_factor = self.loading.load_factor
        drives = periodic.drives(self.comm, mesh.geometry.dim, bodies.small) if repeats else []
        drives += axial.drives(self.comm) if axial else []
        self._calls = LoadCalls(self.loading, activation, names)
        self._calls.drive_means(drives)
        motion = None
        if density is not None:
            deformable = set(materials) - set(bodies.walls)
            density = checked_density(mesh.comm, by_tag(density, names, "density"), deformable)
            motion = Motion(discretization, density, damping or Rayleigh())
        elif damping is not None:
            raise ValueError("Problem: damping= is for bodies in motion, give density= too")
        self.step = Step(discretization, activation, self.loading, motion)

    @property
    def discretization(self) -> Discretization:
        """Space, forms and assembly; replaced when facets open on demand."""
        return self.step.discretization

    @property
    def u(self) -> fem.Function:
        """Displacement [mm]; a new Function when facets open on demand.

        For a periodic cell the fluctuation w; the total is in :class:`vmdg.PeriodicCell`.
        """
        return self.discretization.u

    @property
    def space(self) -> fem.FunctionSpace:
        """Broken space of the displacement."""
        return self.discretization.space

    @property
    def t(self) -> float:
        """Load factor of the current state, a number: the column ``load`` of a history.

        :attr:`load_factor` is the same as a symbol, a Constant of UFL for expressions of loads,
        which is set by :func:`vmdg.solve` and should neither be read nor set.
        """
        return self.loading.t

    def __repr__(self) -> str:
        topology, dofmap = self.mesh.topology, self.space.dofmap
        cells = f"{topology.index_map(topology.dim).size_global} cells ({topology.cell_name()})"
        dofs = dofmap.index_map.size_global * dofmap.index_map_bs
        bodies = ", ".join(f"{tag}: {type(m).__name__}" for tag, m in self.materials.items())
        facets, named = self.step.activation.facets, interface_names(self.interfaces)
        sides = (one.chosen_side for one in facets)
        told = ("" if tag is None else f" (side 1: {tag})" for tag in sides)
        names = ", ".join(map("".join, zip(named, told, strict=True))) or "none"
        return (
            f"<Problem: {cells}, {dofs} dofs; materials {bodies}; interfaces {names}; "
            f"t = {self.t:.6g}>"
        )

    def _repr_html_(self) -> str:
        names = interface_names(self.interfaces)
        rows = [(i, names[i], repr(interface)) for i, interface in enumerate(self.interfaces)]
        table = html_table(("number", "name", "interface"), rows)
        return f"<p>{escape(repr(self))}</p>{table}"

    # Loads

    @of_all_ranks
    def dirichlet(
        self,
        facets: Where,
        value: Value | Expr | None = None,
        component: int | str | None = None,
        relative: bool = False,
    ) -> None:
        """Prescribe the displacement on boundary facets.

        Args:
            facets: Local facets, or a predicate on coordinates (3, n).
            value: Number, array (d,), Constant, f(t) of the load factor, f(x, t) at points
                x (3, n), or a displacement, a DOLFINx Function that is interpolated at the start of
                each step [mm]. Arguments with a default are ignored: lambda t, v=v: v * t is f(t).
            component: 0.. d-1 or "x", "y", "z"; None for all.
            relative: Add the value to the current displacement of the nodes, for a tool that grips
                a deformed body.

        Raises:
            TypeError: a tag instead of its facets, or a DirichletBC of DOLFINx.
            ValueError: nothing selected, facets of an interface, unknown component, or a value of
                the wrong shape or with other arguments; relative=True where facets open on demand,
                whose new nodes have no initial displacement.
        """
        self._calls.dirichlet(facets, value, component, relative)

    @of_all_ranks
    def dirichlet_points(
        self, where: Locator, value: Value, component: int | str | None = None
    ) -> None:
        """Prescribe the displacement of single nodes.

        Args:
            where: Predicate on the coordinates (3, n) of the nodes.
            value: As for :meth:`dirichlet` [mm].
            component: As for :meth:`dirichlet`.

        Raises:
            ValueError: no node is selected, unknown component or a value of the wrong shape.
        """
        self._calls.dirichlet_points(where, value, component)

    @of_all_ranks
    def traction(self, facets: Where, value: Value | Expr) -> None:
        """Dead traction per reference area on boundary facets.

        Args:
            facets: Local facets, or a predicate on coordinates (3, n).
            value: Array (d,), f(t) of the load factor, f(x, t) at points x (3, n), which is
                interpolated in degree k, or a UFL expression, integrated directly: a Constant, a
                Function, or of ``ufl.SpatialCoordinate(problem.mesh)``,
                ``ufl.FacetNormal(problem.mesh)`` and :attr:`load_factor`, for example [MPa].

        Raises:
            TypeError: a tag instead of its facets.
            ValueError: nothing selected, facets inside the mesh, or a value of the wrong shape or
                of another mesh.
        """
        self._calls.traction(facets, value)

    @of_all_ranks
    def point_load(self, where: Locator, value: Value, component: int | str | None = None) -> None:
        """Dead force at single nodes.

        The stress under a point force is singular, and the displacement there diverges with
        log(1/h) (in 3D with 1/h): evaluate displacements elsewhere, or distribute the force by
        :meth:`traction`. For a plane body it is the force on the whole thickness, for a body of
        revolution that on the full circle.

        Args:
            where: Predicate on the coordinates (3, n) of the nodes; the force acts on each of them.
            value: Number, array (d,), Constant, or f(t) of the load factor [N].
            component: As for :meth:`dirichlet`; with one, the value is a number.

        Raises:
            TypeError: ``where`` is not a predicate.
            ValueError: no node is selected, or one on an interface, unknown component or a value of
                the wrong shape.
        """
        self._calls.point_load(where, value, component)

    @of_all_ranks
    def pressure(
        self,
        facets: Where | Interface | str,
        value: Value,
        debonded: bool = False,
        share: Share | None = None,
    ) -> None:
        """Fluid pressure on boundary facets, or on both faces of an interface.

        It acts normal to the deformed surface, -p J F^-T.N per reference area: a follower load,
        with its tangent; at small strain -p N. Between crack faces bond and contact carry the
        effective traction T = P.N + p J F^-T.N, which is then the traction of :attr:`state`: a
        crack opens where the pressure exceeds the compression, a bond softens where both together
        exceed its strength.

        Args:
            facets: Local boundary facets, a predicate on coordinates (3, n), an
                :class:`vmdg.Interface` of the problem or its name.
            value: Number, f(t) of the load factor, or f(x, t) with a number for each of the points
                x (3, n); positive in compression [MPa].
            debonded: The fluid is only where the bond of the interface is broken, Q >= 0.99 P_c at
                the start of a step.
            share: Fraction of the value that acts at points of an interface, a function of the
                openings along the current normal, (n,) [mm], at the start of a step.

        Raises:
            TypeError: a tag instead of its facets.
            ValueError: nothing selected, facets inside the mesh, an interface that is a tie, or
                that slides at finite strain, a UFL expression or a value of the wrong shape.
        """
        self._calls.pressure(facets, value, debonded, share)

    @of_all_ranks
    def spring(
        self,
        facets: Where,
        stiffness: ArrayLike | None = None,
        viscosity: ArrayLike | str | None = None,
    ) -> None:
        """Springs and dashpots between boundary facets and rigid ground.

        The force per reference area is -K.u - C.v, with fixed directions. The energy of springs
        counts as stored, and :meth:`reaction` of their facets is their force; dashpots act in
        :func:`vmdg.solve_dynamics` only.

        Args:
            facets: Local facets, or a predicate on coordinates (3, n).
            stiffness: k in all directions, (k_n, k_t) normal and tangential to the reference
                surface, or K symmetric (d, d) [MPa/mm]. None for none.
            viscosity: c in all directions, or (c_n, c_t) [MPa s/mm]; "absorbing" for a surface that
                waves leave as into more of the body, rho c_p and rho c_s (Lysmer and Kuhlemeyer
                1969, J. Eng. Mech. Div. 95). None for none.

        Raises:
            TypeError: a tag instead of its facets.
            ValueError: nothing selected, facets inside the mesh, a stiffness of the wrong shape
                or not positive semidefinite, a wrong viscosity or one without density, or neither.
        """
        if viscosity is not None:
            given = checked_viscosity(viscosity)
            damping = moving(self.step.motion).damping
            damping.dashpots.append((self._calls.boundary(facets, "spring"), given))
        elif stiffness is None:
            raise ValueError("spring: give a stiffness, a viscosity, or both")
        if stiffness is not None:
            self._calls.spring(facets, stiffness)

    @of_all_ranks
    def rigid_face(
        self,
        facets: Where,
        component: int | str | None = None,
        tilts: bool = False,
        at: ArrayLike | None = None,
        force: Value | None = None,
        displacement: Value | None = None,
    ) -> RigidMotion:
        """Let boundary facets move as a rigid plate: free, under a force, or with a displacement.

        All nodes of the face have the same displacement, or one that is linear in the reference
        coordinates, a translation and a rotation of small angle. With one component the others are
        free, as under a frictionless plate. Other loads on the face, such as tractions and springs,
        act on the plate. The reaction of its facets is the force of a given displacement.

        Args:
            facets: Local facets, or a predicate on coordinates (3, n).
            component: The rigid component, as for :meth:`dirichlet`; None for all.
            tilts: Whether the plate may rotate. Rotations are small; at finite strain only for one
                component, which is then linear in the reference coordinates (the face stays plane).
            at: Point of the plate (d,) at which the force acts and whose displacement is given or
                returned; required if it tilts, ignored otherwise [mm].
            force: Dead force on the plate, a number with one component, else an array (d,), or f(t)
                of the load factor [N]. None for other loads only.
            displacement: Displacement of the point, in the same way [mm]; the plate rotates about
                it. None if it is free.

        Returns:
            The motion of the face, for monitors.

        Raises:
            TypeError: a tag instead of its facets.
            ValueError: nothing selected, facets inside the mesh, a node that is prescribed or
                belongs to two faces, or inconsistent arguments or ones of the wrong shape.
        """
        number = self._calls.rigid_face(facets, component, tilts, at, force, displacement)
        return RigidMotion(self.loading, number)

    @of_all_ranks
    def body_force(self, value: Value | Expr, tag: Group | None = None) -> None:
        """Dead body force per reference volume.

        Args:
            value: As for :meth:`traction` [N/mm3].
            tag: Act on the cells of this tag only; None for all.

        Raises:
            ValueError: unknown tag, or a value of the wrong shape or of another mesh.
        """
        self._calls.body_force(value, tag)

    # Results

    @property
    def stabilization(self) -> InterfaceList[Stabilization]:
        """tau_s and delta of every interface at the last evaluation; at F = I before the first
        step.

        Indexed by number, name or interface, like :attr:`state`.
        """
        empty = Stabilization.empty(self.mesh.geometry.dim)
        return self._of_interfaces(lambda active: active.stabilization, empty)

    @property
    def state(self) -> InterfaceList[InterfaceState]:
        """Values at the facet points of every interface at the last assembled residual.

        ``state[0]``, ``state["bond"]`` by name, or ``state[interface]``. Local: a rank has the
        points of its own facets, possibly none, so a maximum or a sum differs between ranks.
        :meth:`mean`, :meth:`debonded`, :func:`vmdg.extremes`, :func:`vmdg.average`,
        :func:`vmdg.integral` and :func:`vmdg.profile` (sorted along the interface) are over all
        ranks.
        """
        empty = InterfaceState.empty(self.mesh.geometry.dim)
        return self._of_interfaces(lambda active: active.state(), empty)

    def body_state(self, tag: Group) -> BodyState:
        """Values at the points of a body whose material is evaluated at points, as :class:`J2`.

        Local, like :attr:`state`.

        Args:
            tag: Cell tag or its name.

        Raises:
            ValueError: the tag has no such material.
        """
        number = group_tag(tag, self._names, "body_state")
        bodies = self.discretization.bodies.points
        if bodies is None or number not in bodies.materials:
            kinds = {tag: type(m).__name__ for tag, m in self.materials.items()}
            raise ValueError(
                f"body_state: the material of tag {tag!r} has no values at points (materials "
                f"{kinds}); the stress of a hyperelastic body is a field, see vmdg.FieldWriter"
            )
        return bodies.of_tag(number)

    def _of_interfaces(self, value: Callable[[ActiveInterface], T], empty: T) -> InterfaceList[T]:
        """A value of every active interface; ``empty`` of those without open facets."""
        active, numbers = self.discretization.active, range(len(self.interfaces))
        values = (value(active[i]) if i in active else empty for i in numbers)
        return InterfaceList(self.interfaces, values)

    @of_all_ranks
    def mean(self, interface: Which) -> InterfaceMean:
        """Averages over an interface, weighted by area, the same on every rank.

        Args:
            interface: Its number, its name or the interface itself.
        """
        state = self.state[interface]
        area = max(float(global_sum(self.comm, state.weights.sum())), np.finfo(float).tiny)
        values = [
            global_sum(self.comm, state.weights @ value) / area
            for value in (state.opening, state.gap, state.traction, state.softening)
        ]
        return InterfaceMean(*values, area)

    @of_all_ranks
    def debonded(self, interface: Which | None = None) -> float:
        """Fraction of the interface area with a broken bond, the same on every rank.

        Over all interfaces with a bond that can fail, including facets that may open on demand. The
        bond counts as broken at Q >= 0.99 P_c, since an exponential law never reaches P_c.

        Args:
            interface: One interface, by number, name or itself; None for all together.

        Raises:
            ValueError, IndexError: there is no such interface.
        """
        areas, every = np.zeros(2), interface is None
        chosen = None if every else number_of(self.interfaces, interface)
        for i, one in enumerate(self.interfaces):
            active = self.discretization.active.get(i)
            if not one.law.has_bond or not (every or i == chosen):
                continue
            whole = 0.0
            if active is not None:
                intact = active.history.softening < BROKEN * active.law.strength
                whole = active.bonded_area
                areas[0] += whole - active.quadrature.weights[intact].sum()
            area = self.step.activation.area(i)
            areas[1] += whole if area is None else area
        broken, area = global_sum(self.comm, areas)
        return float(broken / area) if area > 0 else 0.0

    @of_all_ranks
    def reaction(self, facets: Where) -> NDArray[np.float64]:
        """Total reaction at the nodes of boundary facets (d,) [N], the same on every rank.

        From prescribed displacements and springs; zero on a free or loaded face, since loads are
        not reactions. In motion supports carry the inertia and viscous forces of their nodes too,
        and dashpots are supports. In axisymmetry the axial component is the force on the whole
        body. The radial one is the sum of the radial forces around the circle (2 pi r t_r ds),
        conjugate to u_r; its resultant is zero. Of a rigid wall it is the force on the whole wall.

        Raises:
            ValueError: nothing is selected, facets of an interface, or the problem is a periodic
                cell, which has none.
        """
        facets = find_boundary_facets(self.mesh, facets, "reaction")
        reason = (
            "lies on an interface, whose nodes are unconstrained; the force across an interface is "
            "vmdg.integral(problem, interface, lambda state: state.traction[:, 0]) along x"
        )
        self.step.activation.refuse(facets, "reaction", reason)
        dofs = nodes_of_facets(self.space, facets)
        bodies = self.discretization.bodies
        cells = facet_cells(self.mesh)[facets]
        touched = np.unique(bodies.tags[cells[cells >= 0]])
        known = set(np.concatenate(self.comm.allgather(touched)).tolist())
        for tag in bodies.walls:
            if tag in known:
                dofs = np.union1d(dofs, nodes_of_cells(self.space, bodies.cells_of[tag]))
        return self._force_on(dofs)

    @of_all_ranks
    def reaction_points(self, where: Locator) -> NDArray[np.float64]:
        """Total reaction at single nodes (d,) [N], as :meth:`reaction`.

        Args:
            where: Predicate on the coordinates (3, n) of the nodes.

        Raises:
            ValueError: no node is selected.
        """
        return self._force_on(find_nodes(self.space, where, "reaction_points"))

    def _force_on(self, nodes: NDArray[np.int32]) -> NDArray[np.float64]:
        """Sum of the forces of supports on nodes, block numbers (d,) [N]; collective."""
        discretization = self.discretization
        if lattice_of(discretization.means) is not None:
            raise ValueError(
                "reaction: a periodic cell has no supports, since it continues beyond its "
                "boundary; the force on its mean gradient is vmdg.PeriodicCell(problem).stress "
                "times the volume"
            )
        nodes = nodes[nodes < self.space.dofmap.index_map.size_local]
        # Springs are part of the internal forces.
        forces = discretization.forces.x.array[: discretization.owned].copy()
        if self.step.motion is not None and self.step.motion.moves:
            # What is free has inertia in place of supports.
            free = np.ones(discretization.owned, dtype=bool)
            free[self.loading.owned_prescribed] = False
            forces[free] = 0.0
            forces += self.step.motion.carried
        forces -= discretization.surface.spring_forces()
        d = self.space.dofmap.index_map_bs
        return global_sum(self.comm, forces.reshape(-1, d)[nodes].sum(axis=0))

    def fine_scale(self, interface: Which) -> NDArray[np.float64]:
        """Fine scales (24) at the points of :attr:`state`, both sides (nq, 2, d) [mm].

        Args:
            interface: Its number, its name or the interface itself.
        """
        i = number_of(self.interfaces, interface)
        found = np.zeros((len(self.state[i].weights), 2, self.mesh.geometry.dim))
        if i in self.discretization.active:
            scales = fine_scales(self.discretization.active[i])
            found[: len(scales)] = scales
        return found

    @of_all_ranks
    def indicator(self, interface: Which | None = None) -> fem.Function | NDArray[np.float64]:
        """Where the mesh is too coarse, dimensionless; collective.

        Of the bodies, without an interface: by jumps of the stress across facets, those of
        interfaces included, see :mod:`vmdg.assembly.indicator`. The root of the sum of its squares
        estimates the error relative to the energy norm of the displacement. Of an interface: the
        fine scales (24) relative to the critical gap 2 G_c/P_c of opening. Bonds are resolved
        where it is below 0.01.

        Args:
            interface: Its number, its name or the interface itself; None for the bodies.

        Returns:
            A new function of degree 0, the share of every cell; or the largest values on the open
            facets of the interface on this rank, ascending (nf,).

        Raises:
            ValueError: the interface has no bond.
        """
        if interface is None:
            return cell_errors(self.discretization)
        i = number_of(self.interfaces, interface)
        if not self.interfaces[i].law.has_bond:
            raise ValueError(
                f"indicator: {label_of(self.interfaces, i)} has no bond, and no critical gap; its "
                "fine scales are vmdg.average(problem, interface, 'fine_scale')"
            )
        active = self.discretization.active.get(i)
        return np.zeros(0) if active is None else facet_errors(active)

    @cached_property
    def _stress(self) -> CauchyStress:
        return CauchyStress(self.discretization)

    @of_all_ranks
    def stress(self) -> fem.Function:
        """Cauchy stress sigma = P.F^T / J at the current displacement (3, 3) [MPa]; collective.

        At small strain sigma = P.

        Discontinuous of degree k. In axisymmetry the order is r, z, hoop; in plane strain sigma_zz
        is the last entry. Every call returns the same function with new values: copy it to keep
        them.
        """
        return self._stress.update(self.discretization)

    def snapshot(self) -> Snapshot:
        """A copy of the converged state of this rank, as :func:`vmdg.plot.animate` shows it.

        Taken in the monitor of a run, one in every row. It does not change while the run continues,
        and has displacement, load factor, nodal forces and the history of all interfaces.
        """
        return self.step.snapshot()

    @of_all_ranks
    def energy(self) -> Energy:
        """Energies at the current state, with the dissipation (34); collective.

        At finite strain the external work of a step is integrated accurately only if its energies
        are evaluated before the next step starts; otherwise by the trapezoidal rule, corrected if
        the previous step allows an estimate. ``SolveOptions(energy=True)`` evaluates them after
        every step.
        """
        return energy_of(self.step, anew=True)

    @property
    def velocity(self) -> fem.Function:
        """Velocity of a problem with a density [mm/s].

        Raises:
            ValueError: it has none.
        """
        return moving(self.step.motion).velocity
