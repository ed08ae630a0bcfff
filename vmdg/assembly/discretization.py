"""Space, forms and assembly for a given set of open interface facets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx.la import InsertMode
from dolfinx.mesh import Mesh
from numpy.typing import NDArray
from ufl.core.expr import Expr

from .. import compat
from ..base.kernels import JIT_OPTIONS, VECTORIZED, compile_form
from ..base.parallel import global_sum
from ..base.quadrature import bulk_degree, facet_degree
from ..base.timers import timer
from ..domain.materials import Bodies
from ..forms import kinematics
from ..forms.dilatation import MeanDilatation
from ..forms.geometry import Geometry
from ..forms.kinematics import Body
from ..interface.active import ActiveInterface
from ..interface.facets import InterfaceFacets
from ..interface.interface import Interface
from ..interface.stabilization import Stabilizers
from ..interface.terms import InterfaceTerms, RegionPair
from .dilatation import Dilatation
from .space import broken_space


class _Forms(NamedTuple):
    """Compiled parts of a residual or tangent.

    A cell integral is given the coefficients of its whole form: with those of the interfaces, all
    of their points, it would read 600 to 1200 numbers a hexahedron of which it needs 26.

    Attributes:
        bulk: The bodies.
        interfaces: Every active interface.
    """

    bulk: fem.Form
    interfaces: list[fem.Form]


class Discretization:
    """The broken space on which the displacement lives, its active interfaces, and the forms.

    Args:
        mesh: The mesh.
        bodies: Materials.
        interfaces: What the user described.
        facets: Open facets of every interface, on this rank.
        degree: Degree of the displacement.
        geometry: Gradient and measure.

    Attributes:
        space: Broken space.
        u: Displacement [mm].
        forces: Internal minus external forces of the last assembly, owned and ghost dofs [N].
        active: Interfaces of which a rank has an open facet, by their number.
        owned: Number of component-wise dofs this rank owns.
        dilatation: theta, p and their elimination with mean dilatation, else None.
    """

    def __init__(
        self,
        mesh: Mesh,
        bodies: Bodies,
        interfaces: Sequence[Interface],
        facets: Sequence[InterfaceFacets],
        degree: int,
        geometry: Geometry,
    ):
        self.mesh = mesh
        self.bodies = bodies
        self.degree = degree
        cut = np.concatenate([f.everywhere for f in facets] or [np.zeros(0, dtype=np.int32)])
        self.space = broken_space(mesh, degree, cut.astype(np.int32))
        self.u = fem.Function(self.space, name="displacement")
        self.forces = fem.Function(self.space, name="forces")
        self.geometry = geometry
        sizes = global_sum(mesh.comm, [len(f.facets) for f in facets]) if facets else []
        self.active = {
            i: ActiveInterface(interface, f, self.u, bodies, degree, geometry)
            for i, (interface, f, size) in enumerate(zip(interfaces, facets, sizes, strict=True))
            if size
        }
        self._dx = self._make_dx()
        self._residual_forms: _Forms | None = None
        self._tangent_forms: _Forms | None = None
        self._bulk_forces = np.zeros_like(self.forces.x.array)
        self._bulk_inputs: tuple[fem.Function | fem.Constant, ...] = ()
        self._bulk_state: NDArray[np.float64] | None = None
        self._energy_forms: list[fem.Form] | None = None
        self._inverted_form: fem.Form | None = None
        stabilizers = [active.stabilizer for active in self.active.values()]
        self._stabilizers = Stabilizers(stabilizers, self.u, bodies, geometry, degree)
        self.owned = self.space.dofmap.index_map.size_local * self.space.dofmap.index_map_bs
        self.dilatation = Dilatation(self) if isinstance(geometry, MeanDilatation) else None

    @property
    def constant_stabilization(self) -> bool:
        """Whether tau_s and delta are the same at every displacement."""
        return self._stabilizers.constant

    @property
    def can_fail(self) -> bool:
        """Whether an active interface has a law that can fail."""
        return any(active.law.inelastic for active in self.active.values())

    @property
    def symmetric(self) -> bool:
        """Whether the tangent is symmetric: the laws of all active interfaces say so."""
        return all(active.law.symmetric for active in self.active.values())

    # Forms

    def _make_dx(self) -> ufl.Measure:
        degree = bulk_degree(self.mesh.topology.cell_name(), self.degree, self.geometry)
        return ufl.Measure(
            "dx",
            domain=self.mesh,
            subdomain_data=[(i, region.cells) for i, region in enumerate(self.bodies.regions)],
            metadata={"quadrature_degree": degree},
        )

    def bulk(self, integrand: Callable[[Body, Expr], Expr]) -> ufl.Form:
        """Sum over the regions of ``integrand(body, F)``."""
        F = ufl.variable(self.geometry.deformation(self.u))
        terms = [
            self.geometry.weight * integrand(region.body, F) * self._dx(i)
            for i, region in enumerate(self.bodies.regions)
        ]
        return sum(terms, start=ufl.Form([]))

    def _interface_form(
        self,
        integrand: Callable[[InterfaceTerms, RegionPair], Expr],
        interfaces: Sequence[ActiveInterface] | None = None,
    ) -> ufl.Form:
        """Sum over the active interfaces, or some of them, of ``integrand(terms, pair)``."""
        chosen = self.active.values() if interfaces is None else interfaces
        pairs = [(active, pair) for active in chosen for pair in active.terms.pairs]
        dS = ufl.Measure(
            "dS",
            domain=self.mesh,
            subdomain_data=[(i, pair.rows) for i, (_, pair) in enumerate(pairs)],
            metadata={"quadrature_degree": facet_degree(self.degree)},
        )
        terms = [
            self.geometry.weight * integrand(active.terms, pair) * dS(i)
            for i, (active, pair) in enumerate(pairs)
        ]
        return sum(terms, start=ufl.Form([]))

    def _compile_interfaces(
        self, integrand: Callable[[InterfaceTerms, RegionPair], Expr], name: str
    ) -> list[fem.Form]:
        """One form for every active interface; interfaces of one kind share their kernel."""
        forms = [self._interface_form(integrand, [active]) for active in self.active.values()]
        return [self.compile_form(form, name) for form in forms]

    def compile_form(self, form: ufl.Form, name: str = "form") -> fem.Form:
        submeshes = [active.terms.submesh for active in self.active.values()]
        options = VECTORIZED if self.mesh.topology.dim == 3 else JIT_OPTIONS
        return compile_form(form, submeshes, self.mesh.comm, options, name)

    def residual_ufl(self, eta: Expr | None = None) -> ufl.Form:
        """The stabilized residual (27) without dead loads.

        Args:
            eta: Test function; that of the displacement, or with mean dilatation of the dilatation.
        """
        eta = ufl.TestFunction(self.space) if eta is None else eta
        return self._bulk_residual(eta) + self._interface_form(self._residual_of(eta))

    def _bulk_residual(self, eta: Expr) -> ufl.Form:
        virtual = self.geometry.gradient(eta)
        return self.bulk(
            lambda body, F: ufl.inner(virtual, kinematics.bulk_stress(body, self.geometry, F))
        )

    @staticmethod
    def _residual_of(eta: Expr) -> Callable[[InterfaceTerms, RegionPair], Expr]:
        return lambda terms, pair: terms.residual(eta, pair.bodies)

    def tangent_ufl(self, eta: Expr | None = None, du: Expr | None = None) -> ufl.Form:
        """The tangent (85), the interfaces in staged coefficients.

        Args:
            eta: Test function, as for :meth:`residual_ufl`.
            du: Trial function.
        """
        eta = ufl.TestFunction(self.space) if eta is None else eta
        du = ufl.TrialFunction(self.space) if du is None else du
        return self._bulk_tangent(eta, du) + self._interface_form(self._tangent_of(eta, du))

    def _bulk_tangent(self, eta: Expr, du: Expr) -> ufl.Form:
        return self.bulk(lambda body, F: kinematics.stiffness(body, self.geometry, F, eta, du))

    @staticmethod
    def _tangent_of(eta: Expr, du: Expr) -> Callable[[InterfaceTerms, RegionPair], Expr]:
        return lambda terms, pair: terms.tangent(eta, du)

    def compile(self) -> None:
        """Compile all kernels of a solve now, or load them from the cache; collective."""
        self.compile_residual()
        self.compile_tangent()

    def compile_residual(self) -> None:
        """Compile the residual, or load it from the cache; collective."""
        if self.dilatation is not None:
            self.dilatation.compile_residual()
        if self._residual_forms is None:
            eta = ufl.TestFunction(self.space)
            bulk = self._bulk_residual(eta)
            self._bulk_inputs = *bulk.coefficients(), *bulk.constants()
            self._residual_forms = _Forms(
                self.compile_form(bulk, "bodies' residual"),
                self._compile_interfaces(self._residual_of(eta), "interface's residual"),
            )

    def compile_tangent(self) -> None:
        """Compile the tangent, or load it from the cache; collective."""
        if self.dilatation is not None:
            self.dilatation.compile_tangent()
        if self._tangent_forms is None:
            eta, du = ufl.TestFunction(self.space), ufl.TrialFunction(self.space)
            self._tangent_forms = _Forms(
                self.compile_form(self._bulk_tangent(eta, du), "bodies' tangent"),
                self._compile_interfaces(self._tangent_of(eta, du), "interface's tangent"),
            )

    # Assembly

    def update_stabilization(self, dt: float | None) -> None:
        """Evaluate tau_s and delta of every interface at the current displacement; collective.

        Args:
            dt: Time step [s]; None where it is not known yet, then laws with viscosity are not
                checked.

        Raises:
            ValueError: the softening of a law is too steep for the mesh (r <= H - eta).
        """
        self.update_dilatation()
        self._update_pressure()
        with timer("stabilization"):
            raised = self._stabilizers.raised()
            for active, stabilization in zip(self.active.values(), raised, strict=True):
                active.apply(stabilization, dt)

    def stabilization_suffices(self) -> bool:
        """Whether tau_s of the step is what coercivity asks for now too, on this rank; collective.

        At finite strain a step that goes far from where tau_s was evaluated may end in an
        equilibrium that only the lack of it makes possible.
        """
        with timer("stabilization"):
            applied = [active.stabilization for active in self.active.values()]
            return self._stabilizers.suffice(applied)

    def update_dilatation(self) -> None:
        """With mean dilatation: theta at the current displacement."""
        if self.dilatation is not None:
            self.dilatation.update_dilatation()

    def _update_pressure(self) -> None:
        """With mean dilatation: p at the current displacement, dilatation and gap."""
        if self.dilatation is not None:
            self.dilatation.update_pressure()

    def assemble_residual(
        self, dt: float, hold: bool, loads: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """Return maps, then internal minus external forces at the current displacement: (46).

        Args:
            dt: Time step of the return maps [s].
            hold: Keep zeta at its converged value instead of mapping back.
            loads: Load vector over local dofs, ghosts still to be added to their owners.

        Returns:
            Owned dofs, nothing removed at prescribed ones [N].
        """
        self.compile_residual()
        self.update_dilatation()
        with timer("return map"):
            for active in self.active.values():
                active.update_points(dt, hold)
        self._update_pressure()
        with timer("assemble residual"):
            forces, forms = self.forces.x, self._residual_forms
            forces.array[:] = 0 if loads is None else -loads
            for form in forms.interfaces:
                fem.assemble_vector(forces.array, form)
            self._update_bulk_forces()
            forces.array[:] += self._bulk_forces
            forces.scatter_reverse(InsertMode.add)
            forces.scatter_forward()
        return forces.array[: self.owned]

    def _update_bulk_forces(self) -> None:
        """The bodies' part, ghosts still to be added to their owners.

        A step starts where the last one has ended, and the interfaces may be asked again with zeta
        held: they are known where no coefficient or constant of their form has changed.
        """
        values = [
            item.x.array if isinstance(item, fem.Function) else np.ravel(item.value)
            for item in self._bulk_inputs
        ]
        state = np.concatenate(values)
        if self._bulk_state is not None and np.array_equal(self._bulk_state, state):
            return
        self._bulk_state = state
        self._bulk_forces[:] = 0
        fem.assemble_vector(self._bulk_forces, self._residual_forms.bulk)

    def create_matrix(self) -> PETSc.Mat:
        """An empty matrix with the pattern of the tangent."""
        cells = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        everything = [
            c.facets.rows(np.ones(len(c.facets.facets), bool)) for c in self.active.values()
        ]
        facets = np.concatenate([np.zeros(0, dtype=np.int32), *everything])
        return compat.create_matrix(self.space, np.arange(cells, dtype=np.int32), facets)

    def assemble_tangent(self, matrix: PETSc.Mat, damage: bool = True) -> None:
        """Tangent at the state of the last :meth:`assemble_residual`, prescribed rows included.

        Args:
            matrix: From :meth:`create_matrix`.
            damage: False holds zeta: the damage part of (84) is left out.
        """
        self._stage_tangent(damage)
        with timer("assemble tangent"):
            matrix.zeroEntries()
            # All of the pattern is filled before the matrix is first assembled, or it is lost.
            fem_petsc.assemble_matrix(matrix, self._tangent_forms.bulk)
            for form in self._tangent_forms.interfaces:
                fem_petsc.assemble_matrix(matrix, form)
            matrix.assemble()
            if self.dilatation is not None:
                self.dilatation.add_to(matrix)

    def _stage_tangent(self, damage: bool) -> None:
        self.compile_tangent()
        with timer("stage tangent"):
            for active in self.active.values():
                active.stage_tangent(damage)

    def add_interface_tangent(self, matrix: PETSc.Mat, damage: bool) -> None:
        """Add the interfaces' part of :meth:`assemble_tangent` to a matrix."""
        self._stage_tangent(damage)
        with timer("assemble interface tangent"):
            for form in self._tangent_forms.interfaces:
                fem_petsc.assemble_matrix(matrix, form)
            matrix.assemble()

    def traction_matrix(self, active: ActiveInterface) -> PETSc.Mat:
        """int q.Tt(du) dA over an interface: rows q at its points, columns du.

        Tt(du) = {(A : GRAD du).N} + r (du_2 - du_1) of (84) with the staged moduli, which at small
        strain are constant. The caller destroys the matrix.
        """
        active.stage_tangent(damage=False)
        return self._point_matrix(active, active.terms.traction)

    def jump_matrix(self, active: ActiveInterface) -> PETSc.Mat:
        """int q.du_2 dA over an interface: the part of side 2 in its opening, as above."""
        return self._point_matrix(active, lambda q, du: ufl.dot(q, du("-")))

    def _point_matrix(
        self, active: ActiveInterface, integrand: Callable[[Expr, Expr], Expr]
    ) -> PETSc.Mat:
        q = ufl.TestFunction(active.quadrature.space((self.mesh.geometry.dim,)))("+")
        du = ufl.TrialFunction(self.space)
        form = self._interface_form(lambda terms, pair: integrand(q, du), [active])
        form = self.compile_form(form, "gap equation")
        matrix = fem_petsc.create_matrix(form)
        fem_petsc.assemble_matrix(matrix, form)
        matrix.assemble()
        return matrix

    def bulk_forces(self) -> NDArray[np.float64]:
        """The bodies' part of the last :meth:`assemble_residual`, owned dofs [N]."""
        forces = fem.Function(self.space).x
        forces.array[:] = self._bulk_forces
        forces.scatter_reverse(InsertMode.add)
        return forces.array[: self.owned].copy()

    def stored_energy(self) -> NDArray[np.float64]:
        """Strain energy of the bodies and energy of the interfaces (30), this rank's [N mm]."""
        self.update_dilatation()
        if self._energy_forms is None:
            bulk = self.bulk(lambda body, F: body.energy(F))
            interfaces = self._interface_form(lambda terms, pair: terms.energy(pair.bodies))
            self._energy_forms = [
                self.compile_form(form, "energy") for form in (bulk, interfaces) if not form.empty()
            ]
        stored = np.zeros(2)
        for i, form in enumerate(self._energy_forms):
            stored[i] = fem.assemble_scalar(form)
        stored[1] += float(self.geometry.thickness) * sum(
            active.recoverable_energy() for active in self.active.values()
        )
        return stored

    def inverted(self) -> bool:
        """Whether det F <= 0 at a quadrature point of this rank; never at small strain.

        Not every stress grows without bound as det F falls to zero: Newton's method can end in an
        equilibrium of cells that are turned inside out.
        """
        if self.bodies.regions[0].body.small:
            return False
        if self._inverted_form is None:

            def turned(body: Body, F: Expr) -> Expr:
                J = body.volume_ratio(F) if body.mean_dilatation else ufl.det(F)
                return ufl.conditional(ufl.le(J, 0), 1.0, 0.0)

            self._inverted_form = self.compile_form(self.bulk(turned), "inverted cells")
        return fem.assemble_scalar(self._inverted_form) > 0

    def continue_from(self, other: Discretization) -> None:
        """Continue from the state of a discretization with fewer open facets, exactly.

        A field that is continuous across a facet is one of those that may jump there, so every
        cell keeps its values; history is kept point by point and starts at zero on new facets.
        """
        mine, theirs = self.space.dofmap.list, other.space.dofmap.list
        bs = self.space.dofmap.index_map_bs
        self.u.x.array.reshape(-1, bs)[mine] = other.u.x.array.reshape(-1, bs)[theirs]
        for i, active in self.active.items():
            if i in other.active:
                active.continue_from(other.active[i])
