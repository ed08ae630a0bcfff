"""Pressures and springs: surface loads that depend on the displacement."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx.mesh import Mesh
from numpy.typing import ArrayLike, NDArray
from ufl.core.expr import Expr

from ..base.agreement import together
from ..base.kernels import compile_form
from ..base.parallel import global_max, raise_together
from ..base.quadrature import load_degree
from ..base.words import as_numbers
from ..domain.materials import Bodies
from ..domain.topology import boundary_rows
from ..forms import surface
from ..interface.active import ActiveInterface
from ..interface.fluid import Fluid
from .dirichlet import SAME_VALUE
from .point_matrices import add_forces
from .space import at_owners
from .values import Part, Value, first_value, takes_points, value_at

Array = NDArray[np.float64]

#: Fraction of a pressure as a function of openings (n,) [mm].
Share = Callable[[Array], ArrayLike]

#: Lost fraction of the strength at which a bond counts as broken: an exponential law never loses
#: all of it.
BROKEN = 0.99


@dataclass(frozen=True)
class _Term:
    """Forces that depend on the displacement."""

    forces: ufl.Form
    u: fem.Function
    name: str

    @cached_property
    def _vector_form(self) -> fem.Form:
        return self._compile(self.forces)

    @cached_property
    def _tangent_form(self) -> fem.Form:
        du = ufl.TrialFunction(self.u.function_space)
        return self._compile(ufl.derivative(self.forces, self.u, du))

    def _compile(self, form: ufl.Form) -> fem.Form:
        comm = self.u.function_space.mesh.comm
        return compile_form(form, comm, name=self.name)

    def add_to(self, vector: Array) -> None:
        """Add the forces at the current displacement, over local dofs [N]."""
        fem.assemble_vector(vector, self._vector_form)

    def add_tangent(self, matrix: PETSc.Mat) -> None:
        fem_petsc.assemble_matrix(matrix, self._tangent_form)


@dataclass(frozen=True)
class _FluidTerm:
    """Forces of a fluid between the faces of an interface."""

    active: ActiveInterface
    dofs: NDArray[np.int32]

    def add_to(self, vector: Array) -> None:
        nodes, d = self.dofs[self.active.facets.cells], self.active.quadrature.d
        add_forces(vector, nodes, d, self.active.fluid.forces())

    def add_tangent(self, matrix: PETSc.Mat) -> None:
        for cells, matrices in self.active.fluid.tangents():
            nodes = self.dofs[cells]
            matrix.setValuesBlockedLocalRCV(nodes, nodes, matrices, PETSc.InsertMode.ADD_VALUES)


@dataclass(frozen=True)
class _Pressure:
    """A pressure on one part of the surface."""

    term: _Term | _FluidTerm
    function: fem.Function
    value: Value
    points: Array | None  # Evaluation points (3, n) if it is f(x, t), otherwise None
    dofs: NDArray[np.int32]  # Dofs of ``function`` at the points
    places: Array  # Positions of the dofs (3, n)
    fluid: Fluid | None = None  # Fluid between crack faces; None on the boundary

    def at(self, t: float) -> Array:
        """p at all points at load factor ``t``, wherever the fluid is."""
        value = value_at(self.value, t, self.points)
        return np.broadcast_to(value, len(self.dofs)).astype(float)

    def set(self, p: Array) -> None:
        share = 1.0 if self.fluid is None else self.fluid.share
        self.function.x.array[self.dofs] = p * share


class Surface:
    """Pressures and springs on the boundary, pressures on the crack faces of interfaces."""

    kind = "a pressure"

    def __init__(self, u: fem.Function, bodies: Bodies):
        self._u, self._bodies = u, bodies
        self._space, self._geometry = u.function_space, bodies.geometry
        self._mesh: Mesh = self._space.mesh
        self._pressures: list[_Pressure] = []
        self._springs: list[_Term] = []
        self._spreading: list[tuple[ActiveInterface, bool, Share | None]] = []
        self._nodes: fem.FunctionSpace | None = None
        self.fluids: list[ActiveInterface] = []

    @property
    def pressurised(self) -> bool:
        return bool(self._pressures)

    @property
    def sprung(self) -> bool:
        return bool(self._springs)

    @property
    def symmetric(self) -> bool:
        return self._bodies.small or not self._pressures

    # User input

    def add_pressure(self, facets: NDArray[np.int32], value: Value) -> None:
        if self._nodes is None:
            degree = self._space.ufl_element().degree
            self._nodes = fem.functionspace(self._mesh, ("Lagrange", degree))
        dim = self._mesh.topology.dim
        self._mesh.topology.create_connectivity(dim - 1, dim)
        p = fem.Function(self._nodes, name="pressure")
        dofs = fem.locate_dofs_topological(self._nodes, dim - 1, facets)
        points = self._nodes.tabulate_dof_coordinates()[dofs].T
        eta, N = ufl.TestFunction(self._space), ufl.FacetNormal(self._mesh)
        body = self._bodies.regions[0].body  # used for its kinematics only
        density = surface.pressure_force(eta, body, self._geometry, self._u, N, p)
        self._add(self._term(density, self._ds(facets)), p, value, points, dofs)

    def add_fluid(
        self, active: ActiveInterface, value: Value, debonded: bool, share: Share | None
    ) -> None:
        """Pressure [MPa] on both faces of an interface with a fluid, times a share of the opening
        at the points, if there is one."""
        if active in self.fluids:
            raise ValueError(
                f"pressure: {active.facets.label} has a pressure already; give their sum"
            )
        active.fluid.share = self._share(active, debonded, share)
        quadrature, p = active.quadrature, active.fluid.pressure
        dofs = np.arange(len(quadrature.weights), dtype=np.int32)
        term = _FluidTerm(active, self._space.dofmap.list)
        self._add(term, p, value, quadrature.points.T, dofs, active.fluid)
        self.fluids.append(active)
        self._spreading.append((active, debonded, share))

    def _term(self, density: Expr, measure: ufl.Measure) -> _Term:
        forces = self._geometry.weight * density * measure
        return _Term(forces, self._u, "surface")

    def _add(
        self,
        term: _Term | _FluidTerm,
        p: fem.Function,
        value: Value,
        points: Array,
        dofs: NDArray[np.int32],
        fluid: Fluid | None = None,
    ) -> None:
        comm, message = self._mesh.comm, None
        local = points if takes_points(value, "pressure") else None
        shape = first_value(comm, value, "pressure", local).shape
        if shape != () and (local is None or shape != (len(dofs),)):
            message = (
                f"pressure: the value has shape {shape}; it must be a number, f(t), or f(x, t) "
                "with one number for each of the points x (3, n), positive if compressive"
            )
        raise_together(comm, message)
        self._pressures.append(_Pressure(term, p, value, local, dofs, points, fluid))

    def add_spring(self, facets: NDArray[np.int32], stiffness: ArrayLike) -> None:
        K, eta = self._foundation(np.asarray(stiffness)), ufl.TestFunction(self._space)
        density = surface.spring_force(eta, K, self._u)
        self._springs.append(self._term(density, self._ds(facets)))

    def _foundation(self, stiffness: Array) -> Expr:
        d = self._mesh.geometry.dim
        if stiffness.dtype.kind not in "iuf":
            raise TypeError(
                f"spring: the stiffness {stiffness.tolist()!r} must be numbers in MPa/mm; springs "
                "are constant in the load factor and in space"
            )
        stiffness = stiffness.astype(float)
        rounding = SAME_VALUE * np.abs(stiffness).max(initial=0.0)
        if stiffness.shape in ((), (2,)):
            least = stiffness.min()
            both = (fem.Constant(self._mesh, float(k)) for k in np.broadcast_to(stiffness, 2))
            K = surface.foundation(*both, ufl.FacetNormal(self._mesh))
        elif stiffness.shape == (d, d) and np.allclose(stiffness, stiffness.T, 0.0, rounding):
            least = np.linalg.eigvalsh(stiffness)[0]
            K = fem.Constant(self._mesh, stiffness)
        else:
            raise ValueError(
                f"spring: the stiffness {stiffness.tolist()} must be a number, a pair (normal, "
                f"tangential), or a symmetric matrix of {d} x {d}, in MPa/mm"
            )
        if not (np.isfinite(stiffness).all() and least >= 0 and np.abs(stiffness).max() > 0):
            raise ValueError(
                f"spring: the stiffness {stiffness.tolist()} must be finite and positive "
                "semidefinite"
            )
        return K

    def _ds(self, facets: NDArray[np.int32]) -> ufl.Measure:
        rows = boundary_rows(self._mesh, facets)
        return ufl.Measure(
            "ds",
            domain=self._mesh,
            subdomain_data=[(0, rows)],
            subdomain_id=0,
            metadata={"quadrature_degree": load_degree(self._space.ufl_element().degree)},
        )

    # Pressures

    def spread(self) -> None:
        """Let fluids spread where bonds are broken and crack faces are open; collective."""
        for active, debonded, share in self._spreading:
            active.fluid.share = self._share(active, debonded, share)

    def _share(self, active: ActiveInterface, debonded: bool, share: Share | None) -> Array:
        """Current fraction of the pressure at the points of an interface (nq,); collective."""
        result, message = np.ones(len(active.quadrature.weights)), None
        if debonded:
            result *= active.history.softening >= BROKEN * active.law.strength
        if share is not None:
            width = active.values.width(active.quadrature.normal)
            given = together(self._mesh.comm, lambda: as_numbers(share(width)))
            if given.shape not in ((), result.shape) or not np.isfinite(given).all():
                message = "pressure: share must return one finite number for each opening (n,)"
                given = np.zeros(())
            result = result * given
        raise_together(self._mesh.comm, message)
        return result

    def values(self, t: float) -> Array:
        """All pressures at load factor ``t``, wherever fluids are, concatenated [MPa]."""
        return np.concatenate([np.zeros(0), *(pressure.at(t) for pressure in self._pressures)])

    def parts(self, t: float) -> Iterator[Part]:
        for pressure in self._pressures:
            yield Part("pressure", pressure.at(t), pressure.places)

    def apply(self, values: Array) -> None:
        ends = np.cumsum([0, *(len(pressure.dofs) for pressure in self._pressures)])
        for pressure, start, end in zip(self._pressures, ends, ends[1:], strict=False):
            pressure.set(values[start:end])

    # Forces

    def load_vector(self) -> Array:
        """Forces of the pressures at the current displacement over local dofs, before ghosts are
        added to owners [N]."""
        return -self._sum([pressure.term for pressure in self._pressures])

    def spring_vector(self) -> Array:
        """Spring forces at the current displacement, in the same way [N]."""
        return self._sum(self._springs)

    def spring_forces(self) -> Array:
        """The same on owned dofs, with ghost contributions added; collective [N]."""
        if not self._springs:
            dofs = self._space.dofmap
            return np.zeros(dofs.index_map.size_local * dofs.index_map_bs)
        return at_owners(self._space, self.spring_vector())

    def spring_work(self, motions: Array) -> Array:
        """Work m_i.K.m_j of the springs at every local dof, for displacements m (k, local dofs).

        Relative to the largest of their forces (local dofs, k, k).
        """
        forces, u = np.zeros_like(motions), self._u.x.array
        displacement = u.copy()
        for force, motion in zip(forces, motions, strict=True):
            u[:] = motion
            force[:] = self.spring_vector()
        u[:] = displacement
        largest = global_max(self._mesh.comm, float(np.abs(forces).max(initial=0.0)))
        return np.einsum("in,jn->nij", motions, forces) / max(largest, np.finfo(float).tiny)

    def _sum(self, terms: Sequence[_Term | _FluidTerm]) -> Array:
        vector = np.zeros_like(self._u.x.array)
        for term in terms:
            term.add_to(vector)
        return vector

    def spring_energy(self) -> float:
        """Energy of the springs on this rank [N mm]."""
        return float(self.spring_vector() @ self._u.x.array) / 2

    def add_tangents(self, matrix: PETSc.Mat) -> None:
        """Add the derivatives of the forces of springs and of follower pressures, not assembled."""
        turning = [] if self._bodies.small else [pressure.term for pressure in self._pressures]
        for term in (*self._springs, *turning):
            term.add_tangent(matrix)
