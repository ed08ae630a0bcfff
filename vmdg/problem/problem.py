"""The problem: spaces, forms, loads and history, from a mesh, materials and interfaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from types import MappingProxyType

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.la import InsertMode
from dolfinx.mesh import Mesh, MeshTags
from numpy.typing import NDArray
from ufl.core.expr import Expr

from ..assembly.dirichlet import (
    DirichletConditions,
    Value,
    Where,
    find_boundary_facets,
    refuse_facets,
)
from ..assembly.discretization import Discretization
from ..assembly.loads import DeadLoads
from ..assembly.stress import CauchyStress
from ..base.parallel import global_any, global_max, global_sum
from ..domain.cells import check_cells
from ..domain.geometry import axis_dofs, make_geometry
from ..domain.materials import Bodies, LoadFactor, Region
from ..domain.tags import Group, by_tag, group_tag, names_of
from ..domain.topology import Locator, facet_cells, tags_of_cells
from ..forms.materials import Material
from ..interface.activation import Activation
from ..interface.facets import InterfaceFacets, check_ghosts, find_facets
from ..interface.interface import Interface, InterfaceList, Which, number_of
from ..interface.points import InterfaceState
from ..interface.stabilization import Stabilization
from .arguments import (
    check_arguments,
    check_mesh,
    check_numbers,
    check_overlap,
    checked_interfaces,
    checked_materials,
)
from .states import Energy, InterfaceMean, Snapshot, Start
from .step import Step

#: Share of the strength that a broken bond has lost.
GONE = 0.99


class Problem:
    """Bodies tied by interfaces that may fail.

    Args:
        mesh: Triangles, quadrilaterals, tetrahedra or hexahedra; in 2D plane strain unless
            ``symmetry`` says otherwise. On more than one rank it needs facet ghosts
            (``GhostMode.shared_facet``).
        cell_tags: A tag for every cell. With :class:`vmdg.NamedTags` (meshes from gmsh have them)
            a group may be given by its name wherever a tag is asked for.
        materials: Material of every tag.
        interfaces: Where and how the displacement may jump.
        degree: Degree of the displacement.
        kinematics: "finite", or "small" for linear elasticity.
        thickness: Of a plane body [mm].
        eigenstrain: Isotropic stress-free strain by tag, a number or a function of the load
            factor; at finite strain F = F_e (1 + theta).
        symmetry: "axisymmetric" makes a 2D mesh the half section of a body of revolution without
            torsion: x = r >= 0, y = z, displacement (u_r, u_z). Forces, energies, load vectors and
            the areas of interface points are those of the whole body; u_r = 0 is imposed on nodes
            on the axis, whatever else is prescribed there. None for plane strain and 3D.
        volumetric: "pointwise", or "mean" for mean dilatation (F-bar; B-bar at small strain): J of
            a cell is one number, so that quadrilaterals and hexahedra of degree 1 do not lock near
            incompressibility.

    Attributes:
        u: Displacement [mm].
        geometry: Gradient and measure of the forms, from ``symmetry`` and ``thickness``.
        t: Load factor of the current state.
        load_factor: The same as a UFL constant, for loads given as UFL expressions.
        stabilization: tau_s and delta of every interface, from the start of the last step.

    Raises:
        ValueError: input that cannot work; the message names it and the remedy.
        TypeError: an argument of another kind, such as a class in place of its instance.
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
        eigenstrain: Mapping[Group, LoadFactor] | None = None,
        symmetry: str | None = None,
        volumetric: str = "pointwise",
    ):
        interfaces = checked_interfaces(interfaces)
        check_mesh(mesh, cell_tags)
        check_numbers(mesh)
        check_arguments(mesh, degree, kinematics)
        self.geometry = make_geometry(mesh, symmetry, thickness, volumetric, degree)
        check_ghosts(mesh)
        check_cells(mesh)
        self.mesh = mesh
        self.comm = mesh.comm
        self._names = names = names_of(cell_tags)
        materials = by_tag(checked_materials(materials), names, "materials")
        eigenstrain = by_tag(eigenstrain or {}, names, "eigenstrain")
        self.interfaces = interfaces
        self.materials = MappingProxyType(materials)
        self._tags = tags = tags_of_cells(mesh, cell_tags)
        self._bodies = Bodies(
            mesh, tags, materials, kinematics == "small", eigenstrain, volumetric == "mean"
        )
        self._facets = [find_facets(mesh, tags, interface, names) for interface in interfaces]
        check_overlap(mesh, self.interfaces, self._facets)
        self._degree = degree
        self._activation = Activation(
            mesh, self.interfaces, self._facets, self._bodies, degree, self.geometry
        )
        self.t = 0.0
        self.load_factor = fem.Constant(mesh, 0.0)
        self._prescriptions: list[tuple[str, Where, Value, int | str | None]] = []
        self._dead_loads: list[tuple[str, NDArray[np.int32], Value | Expr]] = []
        self._load_vector: NDArray[np.float64] | None = None
        self._dissipated = np.zeros(3)
        self._external = 0.0
        self.step = Step()
        self._start: Start | None = None
        self._set_discretization(self._discretize(self._activation.open))
        self.apply_loads(0.0)
        self.update_stabilization(None)

    def _discretize(self, marks: Sequence[NDArray[np.bool_]]) -> Discretization:
        """Everything that depends on which facets are open, marked on all local facets."""
        return Discretization(
            self.mesh,
            self._bodies,
            self.interfaces,
            [facets.among(mark) for facets, mark in zip(self._facets, marks, strict=True)],
            self._degree,
            self.geometry,
        )

    def _set_discretization(self, discretization: Discretization) -> None:
        """Work with ``discretization``: loads and closed facets follow its space."""
        self.discretization = discretization
        self._activation.follow(self.u)
        self._dirichlet = DirichletConditions(self.space, axis_dofs(self.space, self.geometry))
        for prescription in self._prescriptions:
            self._prescribe(*prescription)
        self._loads = DeadLoads(self.space, self.geometry)
        for load in self._dead_loads:
            self._load(*load)

    @property
    def u(self) -> fem.Function:
        """Displacement [mm]; another Function after facets have been opened on demand."""
        return self.discretization.u

    @property
    def space(self) -> fem.FunctionSpace:
        """Broken space of the displacement."""
        return self.discretization.space

    @property
    def can_fail(self) -> bool:
        """Whether an interface with open facets has a law that can fail, on any rank."""
        return any(active.law.inelastic for active in self.discretization.active.values())

    @property
    def small_strain(self) -> bool:
        """Whether kinematics are small and the bodies linear."""
        return self._bodies.regions[0].body.small

    @property
    def opens_on_demand(self) -> bool:
        """Whether an interface has facets that open on demand."""
        return bool(self._activation)

    @property
    def symmetric(self) -> bool:
        """Whether the tangent is symmetric: the laws of all active interfaces say so."""
        return all(active.law.symmetric for active in self.discretization.active.values())

    @property
    def forces(self) -> fem.Function:
        """Internal minus external forces of the last assembly, owned and ghost dofs [N]."""
        return self.discretization.forces

    @property
    def _owned(self) -> int:
        return self.discretization.owned

    # Loads

    def dirichlet(
        self,
        facets: Where,
        value: Value,
        component: int | str | None = None,
        relative: bool = False,
    ) -> None:
        """Prescribe the displacement on boundary facets.

        Args:
            facets: Local facets, or a predicate on coordinates (3, n).
            value: Number, array (d,), f(t) of the load factor, or f(x, t) at points x (3, n)
                [mm].
            component: 0.. d-1 or "x", "y", "z"; None for all.
            relative: Add the value to the displacement that the nodes have now, for a tool that
                grips a body as it is.

        Raises:
            TypeError: a tag in place of its facets.
            ValueError: nothing selected, facets of an interface, unknown component or a value of
                the wrong shape; relative where facets open on demand, whose new nodes would not
                know their start.
        """
        if not callable(facets):
            facets = find_boundary_facets(self.mesh, facets, "dirichlet")
            marks = np.zeros(len(facet_cells(self.mesh)), dtype=bool)
            for selected in self._facets:
                marks[selected.everywhere] = True
            reason = (
                "lies on an interface, whose two sides would be held together; prescribe boundary "
                "facets, or leave these out of the interface"
            )
            refuse_facets(self.mesh, facets, marks, "dirichlet", reason)
        if relative:
            if self._activation:
                raise ValueError(
                    "dirichlet: relative=True does not go with activate='on-demand'; prescribe the "
                    "displacement from the start"
                )
        self._prescribe("dirichlet", facets, value, component, relative)
        if not relative:
            self._prescriptions.append(("dirichlet", facets, value, component))

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
        self._prescribe("dirichlet_points", where, value, component)
        self._prescriptions.append(("dirichlet_points", where, value, component))

    def _prescribe(
        self,
        what: str,
        where: Where,
        value: Value,
        component: int | str | None,
        relative: bool = False,
    ) -> None:
        if what == "dirichlet":
            facets = find_boundary_facets(self.mesh, where, what)
            dofs = fem.locate_dofs_topological(self.space, self.mesh.topology.dim - 1, facets)
        else:
            dofs = fem.locate_dofs_geometrical(self.space, where)
        base = (
            self.u.x.array.reshape(-1, self.space.dofmap.index_map_bs)[dofs] if relative else None
        )
        self._dirichlet.add(dofs, value, component, what, base)

    def traction(self, facets: Where, value: Value | Expr) -> None:
        """Dead traction per reference area on boundary facets.

        Args:
            facets: Local facets, or a predicate on coordinates (3, n).
            value: Array (d,), f(t) of the load factor, f(x, t) at points x (3, n), which is
                interpolated in degree k, or a UFL expression, integrated as it is: of
                ``ufl.SpatialCoordinate(problem.mesh)``, ``ufl.FacetNormal(problem.mesh)`` and
                :attr:`load_factor`, for example [MPa].

        Raises:
            TypeError: a tag in place of its facets.
            ValueError: nothing selected, facets inside the mesh, or a value of the wrong shape or
                of another mesh.
        """
        facets = find_boundary_facets(self.mesh, facets, "traction")
        reason = (
            "lies inside the mesh and would load one side of it; give boundary facets, or let an "
            "interface transmit the traction"
        )
        inside = (facet_cells(self.mesh) >= 0).all(axis=1)
        refuse_facets(self.mesh, facets, inside, "traction", reason)
        self._add_load("traction", facets, value)

    def body_force(self, value: Value | Expr, tag: Group | None = None) -> None:
        """Dead body force per reference volume.

        Args:
            value: As for :meth:`traction` [N/mm3].
            tag: Act on the cells of this tag only; None for all.

        Raises:
            ValueError: unknown tag, or a value of the wrong shape or of another mesh.
        """
        if np.ndim(tag) != 0:
            raise ValueError(f"body_force: tag = {tag} must be one tag; call it once for each")
        tag = group_tag(tag, self._names, "body_force")
        chosen = np.ones(len(self._tags), dtype=bool) if tag is None else self._tags == tag
        cells = np.flatnonzero(chosen).astype(np.int32)
        if global_sum(self.comm, len(cells)) == 0:
            known = sorted(self.materials)
            raise ValueError(f"body_force: no cell has tag {tag}; tags are {known}")
        self._add_load("body_force", cells, value)

    def _add_load(self, what: str, entities: NDArray[np.int32], value: Value | Expr) -> None:
        self._load(what, entities, value)
        self._dead_loads.append((what, entities, value))

    def _load(self, what: str, entities: NDArray[np.int32], value: Value | Expr) -> None:
        add = self._loads.add_traction if what == "traction" else self._loads.add_body_force
        add(entities, value)
        self._load_vector = None

    @property
    def tags(self) -> NDArray[np.int32]:
        """Tag of every local cell, ghosts included."""
        return self._tags

    @property
    def loaded_cells(self) -> NDArray[np.int32]:
        """Local cells on which dead loads act."""
        cells = [np.zeros(0, dtype=np.int32)]
        for what, entities, _ in self._dead_loads:
            cells.append(facet_cells(self.mesh)[entities, 0] if what == "traction" else entities)
        return np.unique(np.concatenate(cells))

    def contradiction(self, t: float) -> str | None:
        """Prescribed displacements that differ at a node of this rank, in words; None if none do.

        Args:
            t: Load factor.
        """
        return self._dirichlet.contradiction(t)

    @property
    def prescribed(self) -> NDArray[np.int32]:
        """Prescribed local dofs (component-wise numbers), ghosts included."""
        return self._dirichlet.dofs

    @property
    def owned_prescribed(self) -> NDArray[np.int32]:
        """Those of :attr:`prescribed` that this rank owns."""
        return self.prescribed[self.prescribed < self._owned]

    def prescribed_values(self, t: float) -> NDArray[np.float64]:
        """Prescribed displacement of :attr:`prescribed` at load factor ``t`` [mm]."""
        return self._dirichlet.values(t)

    def apply_loads(self, t: float) -> None:
        """Set loads and eigenstrains to load factor ``t``; prescribed displacements are not
        imposed here but by the solver's predictor."""
        self.t = t
        self.load_factor.value = t
        self._bodies.apply_eigenstrain(t)
        if self._loads:
            self._load_vector = self._loads.vector(t)

    # Assembly

    def compile(self) -> None:
        """Compile all kernels of a solve now, or load them from the cache; collective."""
        self.discretization.compile_residual()
        self.discretization.compile_tangent()

    def residual_ufl(self) -> ufl.Form:
        """The stabilized residual (27) without dead loads."""
        return self.discretization.residual_ufl()

    def tangent_ufl(self) -> ufl.Form:
        """The tangent (85), interfaces in staged coefficients."""
        return self.discretization.tangent_ufl()

    def update_stabilization(self, dt: float | None) -> None:
        """Evaluate tau_s and delta of every interface at the current displacement.

        Args:
            dt: Time step [s]; None where it is not known yet, then laws with viscosity are not
                checked.

        Raises:
            ValueError: the softening of a law is too steep for the mesh (r <= H - eta).
        """
        self.discretization.update_stabilization(dt)

    def assemble_residual(self, dt: float = 1.0, hold: bool = False) -> NDArray[np.float64]:
        """Return maps, then internal minus external forces at the current displacement.

        Args:
            dt: Time step of the return maps [s].
            hold: Keep zeta at its converged value instead of mapping back.

        Returns:
            Owned dofs, nothing removed at prescribed ones [N].
        """
        return self.discretization.assemble_residual(dt, hold, self._load_vector)

    def create_matrix(self) -> PETSc.Mat:
        """An empty matrix with the pattern of the tangent."""
        return self.discretization.create_matrix()

    def assemble_tangent(self, matrix: PETSc.Mat, damage: bool = True) -> None:
        """Tangent at the state of the last :meth:`assemble_residual`, prescribed rows included.

        Args:
            matrix: From :meth:`create_matrix`.
            damage: False holds zeta: the damage part of (84) is left out.
        """
        self.discretization.assemble_tangent(matrix, damage)

    def bulk_forces(self) -> NDArray[np.float64]:
        """The bodies' part of the last :meth:`assemble_residual`, owned dofs [N]."""
        return self.discretization.bulk_forces()

    def inverted(self) -> bool:
        """Whether cells are turned inside out, det F <= 0; collective."""
        return global_any(self.comm, self.discretization.inverted())

    def outgrown(self) -> bool:
        """Whether the step has ended where its tau_s is not enough for coercivity; collective."""
        return global_any(self.comm, not self.discretization.stabilization_suffices())

    # Steps

    def begin_step(
        self, t: float, dt: float, overstress: float = 0.0, watch_energy: bool = False
    ) -> None:
        """Remember the converged state, then set loads and stabilization for a step to ``t``.

        Args:
            t: Load factor.
            dt: Time step [s].
            overstress: Viscous regularisation of the step: overstress per gap increment in
                multiples of the softening modulus H.
            watch_energy: As :meth:`watch_energy`.

        Raises:
            ValueError: r <= H - eta on a facet; the converged state is kept.
        """
        if self._load_vector is None:
            self.apply_loads(self.t)
        self._start = Start(
            self.t,
            self.u.x.array.copy(),
            self.forces.x.array.copy(),
            self._load_vector,
            stored=0.0,
        )
        if watch_energy:
            self.watch_energy()
        for active in self.discretization.active.values():
            active.begin_step(overstress, dt)
        try:
            self.update_stabilization(dt)
        except ValueError:
            self.cancel_step()
            raise
        self.apply_loads(t)

    @property
    def start_of_step(self) -> tuple[float, NDArray[np.float64]]:
        """Load factor and displacement, ghosts included, at the last :meth:`begin_step`."""
        return self._start.t, self._start.u

    def cancel_step(self) -> None:
        """Return to the state before :meth:`begin_step`: a failed step leaves no trace."""
        self.u.x.array[:] = self._start.u
        self.forces.x.array[:] = self._start.forces
        self.apply_loads(self._start.t)
        for active in self.discretization.active.values():
            active.cancel_step()

    def discretization_of(self, marks: Sequence[NDArray[np.bool_]]) -> Discretization:
        """The discretization with these open facets: the present one where it has them.

        Args:
            marks: For every interface, a mark on all local facets of the mesh.
        """
        same = all(map(np.array_equal, marks, self._activation.open))
        if not global_any(self.comm, not same):
            return self.discretization
        return self._discretize(marks)

    def snapshot(self) -> Snapshot:
        """The converged state as it can be returned to later."""
        return Snapshot(
            self.t,
            self.discretization,
            self.u.x.array.copy(),
            self.forces.x.array.copy(),
            [active.snapshot() for active in self.discretization.active.values()],
            list(self._activation.open),
            self._dissipated.copy(),
            self._external,
        )

    def return_to(self, snapshot: Snapshot) -> None:
        """Go back to a converged state, to its set of open facets too.

        Args:
            snapshot: From :meth:`snapshot`.
        """
        if snapshot.discretization is not self.discretization:
            self._activation.open = list(snapshot.open)
            self._set_discretization(snapshot.discretization)
        self.u.x.array[:] = snapshot.u
        self.forces.x.array[:] = snapshot.forces
        self._dissipated = snapshot.dissipated.copy()
        self._external = snapshot.external
        interfaces = self.discretization.active.values()
        for active, interface in zip(interfaces, snapshot.interfaces, strict=True):
            active.return_to(interface)
        self.apply_loads(snapshot.t)

    # Facets that open on demand

    def nearness(self) -> float:
        """How near a facet that is still closed is to being opened, 1 when it should; collective.

        Zero where no interface opens on demand.
        """
        if not self._activation:
            return 0.0
        self._nearness = self._activation.nearness()
        return self._activation.largest(self._nearness)

    def open_facets(self) -> bool:
        """Open the facets found near their strength by the last :meth:`nearness`; collective.

        The state is carried over exactly: the new facets start bonded, with no opening.

        Returns:
            Whether there were any.
        """
        if not self._activation.mark(self._nearness):
            return False
        before = self.discretization
        self._set_discretization(self._discretize(self._activation.open))
        self.discretization.continue_from(before)
        self.apply_loads(self.t)
        self.update_stabilization(None)
        # What a node bore is now shared by its duplicates.
        self.assemble_residual(hold=True)
        return True

    def largest_overstress(self) -> float:
        """Largest viscous overstress of the last step relative to the strength, on all ranks."""
        here = [active.overstress() for active in self.discretization.active.values()]
        return global_max(self.comm, max(here, default=0.0))

    def watch_energy(self) -> None:
        """Keep the stored energy of the start of a step, at which the problem stands, for
        :meth:`created_energy`."""
        stored = float(self.discretization.stored_energy().sum())
        self._start = replace(self._start, stored=stored)

    def created_energy(self) -> float:
        """Energy that the step would have to create, relative to the work seen so far; collective.

        -(external - stored - dissipated) of the step that has converged and is not committed yet.
        Zero where bodies swell in the step, whose work is not counted.
        """
        change, external, _ = self._exchange()
        total = float(global_sum(self.comm, self._external)) + external
        work = max(self.step.scales.work, abs(total))
        self.step.scales = replace(self.step.scales, work=work)
        return change / max(work, np.finfo(float).tiny)

    def unaccounted_energy(self) -> float:
        """Size of the same energy, created or lost, relative to what the step exchanged.

        That is the external work and the dissipation of the step; collective.
        """
        change, external, dissipated = self._exchange()
        return abs(change) / max(abs(external) + dissipated, np.finfo(float).tiny)

    def _exchange(self) -> tuple[float, float, float]:
        """Created energy, external work and dissipation of the step, over all ranks [N mm]."""
        external, works = self._external_work(self._start), self._works()
        stored = float(self.discretization.stored_energy().sum())
        change = works.sum() + stored - self._start.stored - external
        if self._bodies.swell_between(self._start.t, self.t):
            change = 0.0
        values = global_sum(self.comm, [change, external, works.sum()])
        return tuple(float(value) for value in values)

    def _works(self) -> NDArray[np.float64]:
        """Damage, friction and viscous work of the step, this rank's."""
        works = [active.works() for active in self.discretization.active.values()]
        return float(self.geometry.thickness) * sum(works, start=np.zeros(3))

    def commit(self) -> None:
        """Take the current state as converged: history, dissipation and external work."""
        self._external += self._external_work(self._start)
        self._dissipated += self._works()
        for active in self.discretization.active.values():
            active.commit()

    def _external_work(self, start: Start) -> float:
        """Trapezoidal work of prescribed displacements and dead loads in the step, this rank's."""
        owned = slice(self._owned)
        du = (self.u.x.array - start.u)[owned]
        reactions = np.zeros(self._owned)
        prescribed = self.owned_prescribed
        reactions[prescribed] = (self.forces.x.array + start.forces)[prescribed]
        loads = np.zeros(self._owned)
        if self._load_vector is not None:
            total = fem.Function(self.space)
            total.x.array[:] = self._load_vector + start.loads
            total.x.scatter_reverse(InsertMode.add)
            loads = total.x.array[owned]
        return float((reactions + loads) @ du) / 2

    # Results

    @property
    def stabilization(self) -> InterfaceList[Stabilization]:
        """tau_s and delta of every interface as last evaluated; at F = I before any step.

        By number, name or interface, as :attr:`state` is.
        """
        d, active = self.mesh.geometry.dim, self.discretization.active
        return InterfaceList(
            self.interfaces,
            (
                active[i].stabilization if i in active else Stabilization.empty(d)
                for i in range(len(self.interfaces))
            ),
        )

    def interface_facets(self, interface: Which) -> InterfaceFacets:
        """All facets of an interface on this rank, open or not; by number, name or itself."""
        return self._facets[number_of(self.interfaces, interface)]

    @property
    def regions(self) -> list[Region]:
        """Groups of materials that share a kernel, with their cells on this rank."""
        return self._bodies.regions

    @property
    def state(self) -> InterfaceList[InterfaceState]:
        """Values at the facet points of every interface at the last assembled residual.

        ``state[0]``, ``state["bond"]`` by the name, or ``state[interface]``.
        """
        d, active = self.mesh.geometry.dim, self.discretization.active
        return InterfaceList(
            self.interfaces,
            (
                active[i].state() if i in active else InterfaceState.empty(d)
                for i in range(len(self.interfaces))
            ),
        )

    def mean(self, interface: Which) -> InterfaceMean:
        """Averages over an interface, weighted by area, the same on every rank.

        Args:
            interface: Its number, its name or itself.
        """
        state = self.state[interface]
        area = max(float(global_sum(self.comm, state.weights.sum())), np.finfo(float).tiny)
        values = [
            global_sum(self.comm, state.weights @ value) / area
            for value in (state.opening, state.gap, state.traction, state.softening)
        ]
        return InterfaceMean(*values, area)

    def debonded(self) -> float:
        """Share of the area of the interfaces whose bond is gone, the same on every rank.

        Of all interfaces with a bond that can fail, facets that may open on demand included. The
        bond counts as gone at Q >= .99 P_c: an exponential law never quite reaches P_c.
        """
        areas = np.zeros(2)
        for i, interface in enumerate(self.interfaces):
            law, active = interface.law, self.discretization.active.get(i)
            if not law.inelastic or law.strength <= 0:
                continue
            if active is not None:
                weights = active.quadrature.weights
                areas[0] += weights[active.history.softening >= GONE * law.strength].sum()
            potential = self._activation.area(i)
            areas[1] += weights.sum() if potential is None else potential
        gone, area = global_sum(self.comm, areas)
        return float(gone / area) if area > 0 else 0.0

    def reaction(self, facets: Where) -> NDArray[np.float64]:
        """Total force that holds the nodes of boundary facets (d,) [N], the same on every rank.

        In axisymmetry the axial component is the force on the whole body. The radial one is the
        sum of the radial forces all around (2 pi r t_r ds), which works with u_r: as a resultant
        it is zero.
        """
        facets = find_boundary_facets(self.mesh, facets, "reaction")
        dofs = fem.locate_dofs_topological(self.space, self.mesh.topology.dim - 1, facets)
        d = self.space.dofmap.index_map_bs
        dofs = dofs[dofs < self.space.dofmap.index_map.size_local]
        return global_sum(self.comm, self.forces.x.array.reshape(-1, d)[dofs].sum(axis=0))

    def fine_scale(self, interface: Which) -> NDArray[np.float64]:
        """Fine scales (24) at the facet points of an interface, both sides (nq, 2, d) [mm].

        Args:
            interface: Its number, its name or itself.
        """
        i = number_of(self.interfaces, interface)
        if i not in self.discretization.active:
            return np.zeros((0, 2, self.mesh.geometry.dim))
        return self.discretization.active[i].fine_scales()

    def error_indicator(self, interface: Which) -> NDArray[np.float64]:
        """Size of the fine scales on every owned facet of an interface (nf,) [mm].

        The root mean square over the facet of |du_1|^2 + |du_2|^2 with (24): a local measure of
        the error (Figures 18 and 22), of order h^(k+1).

        Args:
            interface: Its number, its name or itself.
        """
        i = number_of(self.interfaces, interface)
        if i not in self.discretization.active:
            return np.zeros(0)
        quadrature = self.discretization.active[i].quadrature
        square = (self.fine_scale(i) ** 2).sum(axis=(1, 2))
        integral = np.bincount(
            quadrature.facet, quadrature.weights * square, minlength=len(quadrature.area)
        )
        return np.sqrt(integral / quadrature.area)

    def fine_scale_error(self, interface: Which) -> float:
        """Size of the fine scales of an interface in one number [mm]; collective.

        The root mean square over the whole interface of |du_1|^2 + |du_2|^2 with (24), the same on
        every rank: for the history, beside the opening a measure of the accuracy of the interface.

        Args:
            interface: Its number, its name or itself.
        """
        square = (self.fine_scale(interface) ** 2).sum(axis=(1, 2))
        weights = self.state[interface].weights
        integral, area = global_sum(self.comm, [weights @ square, weights.sum()])
        return float(np.sqrt(integral / area)) if area > 0 else 0.0

    @cached_property
    def _stress(self) -> CauchyStress:
        return CauchyStress(self.discretization)

    def stress(self) -> fem.Function:
        """Cauchy stress sigma = P.F^T / J at the current displacement (3, 3) [MPa]; collective.

        Discontinuous of degree k. In axisymmetry the order is r, z, theta; in plane strain sigma_zz
        stands at the end. Every call returns the same function with new values: copy what is to
        stay.
        """
        return self._stress.update(self.discretization)

    def energy(self) -> Energy:
        """Energies at the current state, with what is dissipated as in (34); collective."""
        stored = self.discretization.stored_energy()
        values = [*stored, *self._dissipated, self._external]
        return Energy(*(float(value) for value in global_sum(self.comm, values)))
