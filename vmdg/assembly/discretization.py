"""The broken space and the assembly for a given set of open interface facets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import NamedTuple
from zlib import crc32

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import cpp, fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx.la import InsertMode
from dolfinx.mesh import Mesh
from numpy.typing import NDArray
from ufl.core.expr import Expr

from ..base.kernels import UNROLLED
from ..base.parallel import global_any, global_sum
from ..base.timers import timer
from ..domain.lattice import Lattice
from ..domain.materials import Bodies
from ..forms.geometry import GeneralizedPlane
from ..forms.kinematics import Body
from ..interface.active import (
    ActiveInterface,
    compile_kernels,
    interface_energy,
    interface_flux,
    recoverable_energy,
    take_fluid,
    update_points,
)
from ..interface.moving import MovingInterface
from ..interface.point_flux import FluxChange, PointFlux
from ..interface.stabilization import Stabilization, Stabilizers
from ..points.facets import InterfaceFacets
from ..points.interface import Interface
from ..points.jets import FacetJets
from .cell_tangents import CellTangents
from .dilatation import Dilatation
from .means import MeanSpace
from .point_matrices import (
    add_couplings,
    add_forces,
    add_tangent,
    add_uniform,
    create_matrix,
    sparsity,
    uniform_flux,
)
from .space import broken_space
from .surface import Surface
from .weak_form import WeakForm

#: GRAD u of a unit of F_33.
_ALONG_Z = np.diag([0.0, 0.0, 1.0])


class Split(NamedTuple):
    """The bodies in two sets of cells."""

    near: fem.Form
    far: fem.Form
    add_near: Callable[[PETSc.Mat], None]


class Discretization:
    """The broken space on which the displacement lives, its active interfaces, and the assembly.

    Args:
        symbolic: Integrate the interface terms of (27) over interior facets in UFL where that form
            exists, see :func:`.is_symbolic`; elsewhere, and if False, they are sums over points.

    Attributes:
        means: Unknown means of a periodic cell, or F_33; None for none.
        space: Broken space, for a periodic cell that of the fluctuation.
        u: Displacement, for a periodic cell its fluctuation [mm].
        forces: Internal minus external forces of the last assembly, owned and ghost dofs [N].
        active: Interfaces with an open facet on any rank, by number.
        stabilizers: Their tau_s and delta.
        weak_form: The bodies' terms of (27) and (85) in UFL.
    """

    def __init__(
        self,
        mesh: Mesh,
        bodies: Bodies,
        interfaces: Sequence[Interface],
        facets: Sequence[InterfaceFacets],
        degree: int,
        lattice: Lattice | None = None,
        symbolic: bool = True,
    ):
        self.mesh = mesh
        self.bodies = bodies
        self.degree = degree
        self.geometry = bodies.geometry
        cut = np.concatenate([f.cut for f in facets] or [np.zeros(0, dtype=np.int32)])
        broken = broken_space(mesh, degree, cut.astype(np.int32))
        self._axial = isinstance(self.geometry, GeneralizedPlane)
        unknown = lattice is not None or self._axial
        self.means = MeanSpace(broken, lattice, self._axial) if unknown else None
        self.space = broken if self.means is None else self.means.space
        # Forces are assembled on the nodes of the mesh, from which those on means follow.
        self._test_space = broken
        self.u = fem.Function(self.space, name="displacement")
        self.forces = fem.Function(self.space, name="forces")
        sizes = global_sum(mesh.comm, [f.size for f in facets]) if facets else []
        self.active = {
            i: (MovingInterface if f.slides else ActiveInterface)(interface, f, self.u, bodies)
            for i, (interface, f, size) in enumerate(zip(interfaces, facets, sizes, strict=True))
            if size
        }
        self.owned = self.space.dofmap.index_map.size_local * self.space.dofmap.index_map_bs
        active = list(self.active.values())
        self.stabilizers = Stabilizers([one.stabilizer for one in active], self.u, bodies)
        self._point_tangents: list[
            tuple[ActiveInterface, NDArray[np.float64], FluxChange | None]
        ] = []
        self._patterns = 0
        self.weak_form = WeakForm(self.u, bodies, active, broken, symbolic)
        self._dilatation = Dilatation(self.weak_form) if bodies.mean_dilatation else None
        self.surface = Surface(self.u, bodies)
        self._at_points = bodies.points

    def new_surface(self) -> Surface:
        """Remove all pressures and springs, and return an empty :class:`Surface`."""
        self.surface = Surface(self.u, self.bodies)
        return self.surface

    def take_fluid(self, number: int) -> ActiveInterface:
        active = self.active[number]
        if active.fluid is None:
            take_fluid(active)
        return active

    @property
    def can_fail(self) -> bool:
        return any(active.law.inelastic for active in self.active.values())

    @property
    def slides(self) -> bool:
        """Whether surfaces slide, which are paired again in every state."""
        return any(active.facets.slides for active in self.active.values())

    @property
    def symmetric(self) -> bool:
        """Whether the tangent is symmetric: symmetric laws, no follower pressures, no surfaces that
        slide, and no bodies at points next to interfaces."""
        laws = all(active.law.symmetric for active in self.active.values())
        # The moduli of an adjoint term are frozen, those of the flux are current.
        bodies = self._at_points
        points = bodies is None or (bodies.symmetric and not self.active)
        return laws and points and self.surface.symmetric and not self.slides

    # Compiled forms

    def compile(self) -> None:
        """Compile all kernels of a solve now, or load them from the cache; collective."""
        if self._dilatation is not None:
            self._dilatation.compile()
        _ = self._bulk_residual, self._add_bodies
        if self._axial:
            _ = self._axial_residual
        for active, on_facets in zip(self.active.values(), self.weak_form.on_facets, strict=True):
            compile_kernels(active, residual=on_facets is None)

    @cached_property
    def _bulk_residual(self) -> fem.Form:
        weak, eta = self.weak_form, ufl.TestFunction(self._test_space)
        return weak.compile(weak.bulk_residual(eta), "bodies' residual", UNROLLED)

    @cached_property
    def _axial_residual(self) -> fem.Form:
        """The force on F_33, a number: that of a unit of its test function."""
        form = self.weak_form.bulk_residual(fem.Constant(self.mesh, 1.0))
        return self.weak_form.compile(form, "force along z")

    @cached_property
    def _add_bodies(self) -> Callable[[PETSc.Mat], None]:
        return self._bodies_tangent()

    def _bodies_tangent(
        self, cells: NDArray[np.bool_] | None = None
    ) -> Callable[[PETSc.Mat], None]:
        """A function that adds the bodies' tangent, of all cells or of some; in the plane by a
        compiled form."""
        if self.mesh.topology.dim == 3:
            return partial(CellTangents(self.u, self.bodies).add_to, chosen=cells)
        weak = self.weak_form
        eta, du = ufl.TestFunction(self.space), ufl.TrialFunction(self.space)
        form = weak.compile(weak.bulk_tangent(eta, du, cells), "bodies' tangent")
        return lambda matrix: fem_petsc.assemble_matrix(matrix, form)

    @cached_property
    def _point_fluxes(self) -> list[PointFlux | None]:
        """Of every active interface; None without bodies at points."""
        if self._at_points is None:
            return [None] * len(self.active)
        return [PointFlux(active, self.u, self.bodies) for active in self.active.values()]

    @cached_property
    def _uniform(self) -> tuple[fem.Constant, list[fem.Form], list[fem.Form]]:
        """A uniform gradient E, in the plane or in space and with F_33 (n, n), and the forces
        GRAD eta : A : E and E : A : GRAD eta of the bodies, on nodes and on F_33."""
        weak, n = self.weak_form, self.mesh.geometry.dim + self._axial
        E = fem.Constant(self.mesh, np.zeros((n, n)))
        tests = [ufl.TestFunction(self._test_space), *[fem.Constant(self.mesh, 1.0)] * self._axial]

        def compiled(tangent: Callable[[Expr, Expr], ufl.Form]) -> list[fem.Form]:
            sums = [tangent(weak.geometry.gradient(eta), E) for eta in tests]
            return [weak.compile(form, "bodies' tangent along a gradient") for form in sums]

        forms = compiled(weak.along)
        if self._at_points is None or self._at_points.symmetric:
            return E, forms, forms
        return E, forms, compiled(lambda eta, du: weak.along(du, eta))

    @cached_property
    def _energy_form(self) -> fem.Form:
        energy = self.weak_form.over_bodies(lambda body, F: body.energy(F))
        return self.weak_form.compile(energy, "energy", UNROLLED)

    @cached_property
    def _inverted_form(self) -> fem.Form:
        def turned(body: Body, F: Expr) -> Expr:
            J = body.volume_ratio(F) if body.mean_dilatation else ufl.det(F)
            return ufl.conditional(ufl.le(J, 0), 1.0, 0.0)

        form = self.weak_form.over_bodies(turned)
        return self.weak_form.compile(form, "inverted cells", UNROLLED)

    # Assembly

    def update_stabilization(self) -> float:
        """Evaluate tau_s and delta of every interface at the current displacement; the resulting
        change of the energy (30) on this rank [N mm]; collective."""
        self.update_means(pressure=True)
        with timer("stabilization"):
            scaled = zip(self.active.values(), self._scaled_stabilization(), strict=True)
            energy = sum(active.apply(stabilization) for active, stabilization in scaled)
        return float(self.geometry.thickness) * energy

    def _scaled_stabilization(self) -> list[Stabilization]:
        return self.stabilizers.for_step([active.floor for active in self.active.values()])

    def needed_penalties(self) -> list[NDArray[np.float64]]:
        """r of every interface for a step from the current displacement (nf,) [MPa/mm];
        collective."""
        with timer("stabilization"):
            return [stabilization.norm for stabilization in self._scaled_stabilization()]

    def stabilization_suffices(self) -> bool:
        """Whether tau_s of the step satisfies coercivity at the current displacement, on this rank;
        collective."""
        with timer("stabilization"):
            applied = [active.stabilization for active in self.active.values()]
            return self.stabilizers.suffice(applied)

    def update_means(self, pressure: bool = False) -> None:
        """Update the means in the forms: H of a periodic cell, F_33, theta of mean dilatation, and
        its pressure if requested; collective."""
        if self.means is not None:
            H, d = self.means.gradient(self.u.x.array), self.mesh.geometry.dim
            if self.means.lattice is not None:
                self.geometry.macroscopic.value[:] = H[:d, :d]
            if self._axial:
                self.geometry.axial.value = H[2, 2]
        if self._dilatation is not None:
            self._dilatation.update_dilatation()
        if pressure:
            self._update_pressure()

    def _update_pressure(self) -> None:
        """With mean dilatation: p at the current displacement, theta and gap; collective."""
        if self._dilatation is not None:
            self._dilatation.update_pressure()

    def update_points(self, dt: float, hold: bool = False, anew: bool = False) -> None:
        """Return maps at the current displacement, of bodies and interfaces, see
        :meth:`assemble_residual`."""
        self.update_means()
        if self.slides:
            with timer("pairs"):
                for active in self.active.values():
                    active.pair()
        if bodies := self._at_points:
            bodies.update(bodies.deformation(self.u), dt, hold and not anew)
        with timer("return map"):
            update_points(list(self.active.values()), dt, hold)

    def assemble_residual(
        self,
        dt: float | None,
        hold: bool = False,
        loads: NDArray[np.float64] | None = None,
        anew: bool = False,
        bulk: fem.Form | None = None,
    ) -> NDArray[np.float64]:
        """Return maps, then internal minus external forces at the current displacement: (46).

        Args:
            dt: Time step of the return maps [s]; None leaves the points unchanged.
            hold: Fix zeta at its converged value instead of a return map.
            loads: Load vector over local dofs, before ghosts are added to owners.
            anew: If zeta is fixed, bodies at points have the moduli of their state at rest, not
                those of the last evaluation.
            bulk: Residual of some cells in place of all, see :func:`split`.

        Returns:
            Owned dofs, including prescribed ones [N].
        """
        if dt is not None:
            self.update_points(dt, hold, anew)
        forces = self.forces.x
        self._update_pressure()
        with timer("assemble residual"):
            forces.array[:] = 0 if loads is None else -loads
            vector = self._nodal_forces(forces.array)
            fem.assemble_vector(vector, self._bulk_residual if bulk is None else bulk)
            axial = self._add_interfaces(vector)
            if self._axial:
                axial += fem.assemble_scalar(self._axial_residual)
            self._add_nodal_forces(vector, axial, forces.array)
            if self.surface.sprung:
                forces.array[:] += self.surface.spring_vector()
            forces.scatter_reverse(InsertMode.add)
            forces.scatter_forward()
        return forces.array[: self.owned]

    def _add_interfaces(self, vector: NDArray[np.float64]) -> float:
        """Add the forces of all interfaces to a vector over local dofs, before ghosts are added to
        owners [N]; the force on F_33, on this rank."""
        axial = 0.0
        for active, on_facets in zip(self.active.values(), self.weak_form.on_facets, strict=True):
            if active.stabilization is None:
                continue
            if on_facets is not None and active.fluid is None:
                on_facets.add_to(vector)
                continue
            flux = interface_flux(active)
            add_uniform(vector, self._test_space.dofmap.list, active, flux)
            if self._axial:
                axial += float(active.point_tangent.jets.of_gradient(_ALONG_Z) @ flux.sum(0))
        return axial

    def _nodal_forces(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        return vector if self.means is None else self.means.clear_forces()

    def _add_nodal_forces(
        self, forces: NDArray[np.float64], axial: float, vector: NDArray[np.float64]
    ) -> None:
        if self.means is not None:
            self.means.add_forces(forces, axial, vector)

    def create_matrix(self, kind: PETSc.Mat.Type = PETSc.Mat.Type.AIJ) -> PETSc.Mat:
        """An empty matrix with the pattern of the tangent, without means, of type AIJ, or BAIJ in
        nodal blocks, for which PETSc inserts nine entries per look-up."""
        self.couple()
        return create_matrix(self.mesh.comm, self._pattern, kind)

    @cached_property
    def _pattern(self) -> cpp.la.SparsityPattern:
        return sparsity(self.space, self.space, list(self.active.values()))

    def couple(self) -> int:
        """Number of the pattern of :meth:`create_matrix`, another one each time when surfaces that
        slide have pairs which it lacks; collective."""
        if not self.slides:
            return self._patterns
        if global_any(self.mesh.comm, any([one.couple() for one in self.active.values()])):
            self.__dict__.pop("_pattern", None)
            self._patterns += 1
            if self._dilatation is not None:
                self._dilatation.couple()
        return self._patterns

    def uniform_forces(
        self, gradient: NDArray[np.float64], adjoint: bool = False
    ) -> NDArray[np.float64]:
        """Tangent times a uniform gradient E: forces on w and on the means, owned dofs [N];
        collective.

        At the state of the last :meth:`assemble_tangent`, whose matrix contains w only.
        """
        E, forms = self._uniform[0], self._uniform[1 + adjoint]
        E.value[:] = gradient
        d, axial = self.mesh.geometry.dim, 0.0
        total = fem.Function(self.space).x
        forces = self._nodal_forces(total.array)
        if self._axial:
            axial = fem.assemble_scalar(forms[1])
        fem.assemble_vector(forces, forms[0])
        dofs = self._test_space.dofmap.list
        fluxes = [
            (active, uniform_flux(active, D.transpose(0, 2, 1) if adjoint else D, gradient))
            for active, D, _ in self._point_tangents
        ]
        changes = [change for *_, change in self._point_tangents if change is not None]
        if not adjoint:
            fluxes += [(change.of.active, change.along(gradient)) for change in changes]
        for active, flux in fluxes:
            add_uniform(forces, dofs, active, flux)
            if self._axial:
                axial += active.point_tangent.jets.of_gradient(_ALONG_Z) @ flux.sum(0)
        for change in changes if adjoint else ():
            for cells, values in change.adjoint_along(gradient, FacetJets.displacement):
                add_forces(forces, dofs[cells], d, values)
            if self._axial:
                unit = partial(FacetJets.uniform, gradient=_ALONG_Z)
                axial += sum(values.sum() for _, values in change.adjoint_along(gradient, unit))
        self._add_nodal_forces(forces, axial, total.array)
        total.scatter_reverse(InsertMode.add)
        return total.array[: self.owned]

    def assemble_tangent(
        self,
        matrix: PETSc.Mat,
        damage: bool = True,
        failing: bool = True,
        bodies: PETSc.Mat | None = None,
    ) -> None:
        """Tangent at the state of the last :meth:`assemble_residual`, prescribed rows included.

        Args:
            damage: False fixes zeta: the damage part of (84) is omitted.
            failing: False omits interfaces that can fail: only ties connect the bodies.
            bodies: What :func:`assemble_bodies` gave, if it still holds.
        """
        with timer("tangent at points"):
            parts = []
            for flux, active in zip(self._point_fluxes, self.active.values(), strict=True):
                D, *state = active.tangent(damage)
                kept = failing or not active.law.inelastic
                # Entries of the others stay in the pattern, as zeros.
                parts.append(
                    (active, D if kept else 0.0 * D, flux(*state) if flux and kept else None)
                )
        with timer("assemble tangent"):
            fresh = not matrix.assembled
            if bodies is None:
                matrix.zeroEntries()
                # PETSc drops preallocated entries that are not set before the first assembly.
                self._add_bodies(matrix)
            else:
                bodies.copy(matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            self.surface.add_tangents(matrix)
            for part in parts:
                add_tangent(matrix, *part)
                if fresh:
                    add_couplings(matrix, part[0])
            if self.means is not None:
                # Rows that belong to no cell, for the identity of prescribed dofs.
                for dof in self.means.owned_rows:
                    matrix.setValueLocal(dof, dof, 0.0, PETSc.InsertMode.ADD_VALUES)
            matrix.assemble()
            if self.means is not None:
                self._point_tangents = parts
            if self._dilatation is not None:
                self._dilatation.add_to(matrix, parts)

    @cached_property
    def _moduli(self) -> tuple[list[fem.Constant], list[fem.Function]]:
        """What the tangent of linear bodies is made of."""
        energy = self.weak_form.over_bodies(lambda body, F: body.energy(F))
        moving = [getattr(self.geometry, name, None) for name in ("macroscopic", "axial")]
        constants = [one for one in energy.constants() if all(one is not c for c in moving)]
        fields = (self.u, *self.bodies.fields)
        return constants, [one for one in energy.coefficients() if one not in fields]

    def stored_energy(self, anew: bool = False) -> NDArray[np.float64]:
        """This rank's energy of the bodies, of the interfaces (30) and of springs (3,) [N mm];
        ``anew`` if eigenstrains have changed since the last residual."""
        self.update_means()
        stored = np.zeros(3)
        stored[0] = fem.assemble_scalar(self._energy_form)
        stored[1] = float(self.geometry.thickness) * sum(
            recoverable_energy(active) + interface_energy(active, anew)
            for active in self.active.values()
        )
        stored[2] = self.surface.spring_energy()
        return stored

    def inverted(self) -> bool:
        """Whether det F <= 0 at a quadrature point of this rank; never at small strain.

        Not every stress is unbounded as det F approaches zero: Newton's method can converge to an
        equilibrium with inverted cells.
        """
        if self.bodies.small:
            return False
        return fem.assemble_scalar(self._inverted_form) > 0

    def continue_from(self, other: Discretization) -> None:
        """Continue from the state of a discretization with fewer open facets, exactly.

        A continuous field is a special case of one that may jump, so every cell keeps its values;
        history is copied point by point and starts at zero on new facets.
        """
        _take(self, self.u, other, other.u)
        for i, active in self.active.items():
            if i in other.active:
                active.continue_from(other.active[i])


def moduli_of(discretization: Discretization) -> int | None:
    """A number that changes with the tangent of linear bodies on this rank; None where bodies are
    not linear."""
    if not discretization.bodies.linear:
        return None
    constants, functions = discretization._moduli
    number = 0
    for values in (*(one.value for one in constants), *(one.x.array for one in functions)):
        number = crc32(values, number)
    return number


def assemble_bodies(discretization: Discretization, matrix: PETSc.Mat) -> None:
    """The bodies' tangent alone, in a matrix that has been assembled before; collective."""
    with timer("assemble tangent"):
        matrix.zeroEntries()
        discretization._add_bodies(matrix)
        matrix.assemble()


def split(discretization: Discretization, cells: NDArray[np.bool_]) -> Split:
    """Residual and tangent of the bodies in marked cells, and the residual of the others;
    collective."""
    weak, eta = discretization.weak_form, ufl.TestFunction(discretization.space)
    residuals = [
        weak.compile(weak.bulk_residual(eta, marks), "bodies' residual", UNROLLED)
        for marks in (cells, ~cells)
    ]
    return Split(*residuals, discretization._bodies_tangent(cells))


def interface_forces(discretization: Discretization) -> NDArray[np.float64]:
    """Forces of all interfaces at the values of their points, owned dofs [N]; collective."""
    forces = fem.Function(discretization.space).x
    discretization._add_interfaces(forces.array)
    forces.scatter_reverse(InsertMode.add)
    return forces.array[: discretization.owned]


def _take(
    discretization: Discretization, mine: fem.Function, other: Discretization, theirs: fem.Function
) -> None:
    """Copy a field of another discretization cell by cell."""
    bs = discretization.space.dofmap.index_map_bs
    to, of = discretization.space.dofmap.list, other.space.dofmap.list
    mine.x.array.reshape(-1, bs)[to] = theirs.x.array.reshape(-1, bs)[of]
    if discretization.means is not None:
        mine.x.array[discretization.means.dofs] = theirs.x.array[other.means.dofs]


def carried(
    values: NDArray[np.float64], to: Discretization, of: Discretization
) -> NDArray[np.float64]:
    """A field in a discretization with more open facets, with the same values in every cell, at
    owned dofs of ``to``; collective."""
    mine, theirs = fem.Function(to.space), fem.Function(of.space)
    theirs.x.array[: of.owned] = values
    theirs.x.scatter_forward()
    _take(to, mine, of, theirs)
    return mine.x.array[: to.owned]
