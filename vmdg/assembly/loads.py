"""Dead loads: tractions, body forces, point forces, as functions of position and load factor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import compute_midpoints
from numpy.typing import NDArray
from ufl.algorithms import extract_arguments, extract_coefficients
from ufl.core.expr import Expr
from ufl.domain import extract_domains

from ..base.kernels import compile_form
from ..base.quadrature import load_degree
from ..base.timers import timer
from ..domain.topology import boundary_rows
from ..forms.geometry import Geometry
from .dirichlet import component_index
from .rigid import RigidFace
from .values import Part, Value, check_resultant, check_shape, first_value, takes_points, value_at


@dataclass(frozen=True)
class _Load:
    """A load on some entities."""

    # Owned cells, or flat rows (cell, facet in it) of owned boundary facets
    entities: NDArray[np.int32]
    density: Expr  # Integrand against the test function, UFL (d,)
    value: Value | Expr
    # If ``value`` is f(x, t), the nodes (3, n) at which it is evaluated, otherwise None
    points: NDArray[np.float64] | None = None
    dofs: NDArray[np.int32] | None = None  # Nodes of ``density`` that belong to ``points``
    what: str = ""

    def update(self, t: float) -> None:
        """Set the density to load factor ``t``; UFL expressions contain it."""
        if isinstance(self.value, Expr):
            return
        if isinstance(self.density, fem.Constant):
            self.density.value[:] = value_at(self.value, t)
        elif self.points is not None:
            d = self.density.ufl_shape[0]
            value = value_at(self.value, t, self.points)
            value = np.broadcast_to(value.reshape(d, -1), (d, len(self.dofs)))
            self.density.x.array.reshape(-1, d)[self.dofs] = value.T


@dataclass(frozen=True)
class _Force:
    """A force at nodes."""

    dofs: NDArray[np.int32]  # Component-wise numbers of owned nodes (n, components)
    # Forces on them by the components of the value (n, components, components)
    spread: NDArray[np.float64]
    value: Value
    what: str


class DeadLoads:
    """Tractions per reference area, body forces per volume, (29), and forces at points."""

    kind = "a dead load"

    def __init__(self, u: fem.Function, geometry: Geometry, load_factor: fem.Constant):
        self._u, self._space = u, u.function_space
        space = self._space
        self._mesh = space.mesh
        self._d = space.dofmap.index_map_bs
        self._weight, self._load_factor = geometry.weight, load_factor
        self._tractions: list[_Load] = []
        self._body_forces: list[_Load] = []
        self._forces: list[_Force] = []
        self._nodes: fem.FunctionSpace | None = None
        self._form: fem.Form | None = None
        # All that densities depend on, and its values at the last assembly with the vector.
        self._given: list[fem.Constant | fem.Function] = []
        self._last: tuple[list[NDArray[np.float64]], NDArray[np.float64]] | None = None

    def add_traction(self, facets: NDArray[np.int32], value: Value | Expr) -> None:
        """Traction [MPa] on boundary facets."""
        dim, rows = self._mesh.topology.dim - 1, boundary_rows(self._mesh, facets)
        self._tractions.append(self._load(value, rows, dim, facets, "traction"))

    def add_body_force(self, cells: NDArray[np.int32], value: Value | Expr) -> None:
        """Body force [N/mm3] on local cells."""
        dim = self._mesh.topology.dim
        owned = cells[cells < self._mesh.topology.index_map(dim).size_local]
        self._body_forces.append(self._load(value, owned, dim, cells, "body_force"))

    def add_point_load(
        self, nodes: NDArray[np.int32], value: Value, component: int | str | None
    ) -> None:
        """Force [N] at each of some nodes, block numbers (n,)."""
        what = "point_load"
        index = component_index(component, self._d, what)
        shapes = [(self._d,)] if index is None else [(), (1,)]
        check_resultant(self._mesh.comm, value, shapes, what)
        components = np.arange(self._d) if index is None else np.array([index])
        owned = nodes[nodes < self._space.dofmap.index_map.size_local]
        spread = np.broadcast_to(np.eye(len(components)), (len(owned), *2 * components.shape))
        self._forces.append(_Force(owned[:, None] * self._d + components, spread, value, what))

    def add_face_load(self, face: RigidFace, value: Value) -> None:
        """Force [N] at the point of a rigid face."""
        shapes = [(self._d,)] if face.component is None else [(), (1,)]
        check_resultant(self._mesh.comm, value, shapes, "rigid_face")
        self._forces.append(_Force(face.dofs, face.spread, value, "rigid_face"))

    def _load(
        self,
        value: Value | Expr,
        entities: NDArray[np.int32],
        dim: int,
        support: NDArray[np.int32],
        what: str,
    ) -> _Load:
        """The load on ``entities``, nodal where it is given at points of the ``support``."""
        self._form = None
        if isinstance(value, Expr):
            self._check_expression(value, what)
            return _Load(entities, value, value, what=what)
        if not takes_points(value, what):
            initial = first_value(self._mesh.comm, value, what)
            check_shape(self._mesh.comm, initial.shape, [(self._d,)], what)
            return _Load(entities, fem.Constant(self._mesh, initial), value, what=what)
        if self._nodes is None:
            degree = self._space.ufl_element().degree
            self._nodes = fem.functionspace(self._mesh, ("Lagrange", degree, (self._d,)))
        self._mesh.topology.create_connectivity(dim, self._mesh.topology.dim)
        dofs = fem.locate_dofs_topological(self._nodes, dim, support)
        points = self._nodes.tabulate_dof_coordinates()[dofs].T
        shape = first_value(self._mesh.comm, value, what, points).shape
        check_shape(self._mesh.comm, shape, [(self._d,), (self._d, len(dofs))], what)
        return _Load(entities, fem.Function(self._nodes), value, points, dofs, what)

    def _check_expression(self, value: Expr, what: str) -> None:
        check_shape(self._mesh.comm, value.ufl_shape, [(self._d,)], what)
        if extract_arguments(value):
            raise ValueError(f"{what}: the expression contains a test or trial function")
        if any(domain != self._mesh.ufl_domain() for domain in extract_domains(value)):
            raise ValueError(f"{what}: the expression belongs to another mesh")
        if self._u in extract_coefficients(value):
            raise ValueError(
                f"{what}: the expression contains problem.u, but a dead load does not depend on "
                "the displacement; use problem.pressure(facets, value) for a follower load, "
                "problem.spring(facets, stiffness) for one proportional to the displacement"
            )

    def parts(self, t: float) -> Iterator[Part]:
        """Values of every load at load factor ``t``, except UFL expressions."""
        dim, x = self._mesh.topology.dim, self._space.tabulate_dof_coordinates()
        loads = [
            *((load, 2) for load in self._tractions),
            *((load, 1) for load in self._body_forces),
        ]
        for load, columns in loads:
            if isinstance(load.value, Expr) and not isinstance(load.value, fem.Constant):
                continue
            value, places = value_at(load.value, t, load.points), load.points
            if places is None:
                places = compute_midpoints(self._mesh, dim, load.entities[:columns:columns]).T
            yield Part(load.what, np.atleast_2d(value).T, places)
        for force in self._forces:
            value = np.atleast_2d(value_at(force.value, t))
            yield Part(force.what, value, x[force.dofs[:1, 0] // self._d].T)

    def values(self, t: float) -> NDArray[np.float64]:
        """Load vector at load factor ``t`` over local dofs, before ghosts are added to owners."""
        result, now = np.zeros_like(self._u.x.array), self._load_factor.value.copy()
        self._load_factor.value = t
        try:
            loads = [*self._tractions, *self._body_forces]
            for load in loads:
                load.update(t)
            if loads:
                result += self._of_densities()
            for force in self._forces:
                result[force.dofs] += force.spread @ np.atleast_1d(value_at(force.value, t))
        finally:
            self._load_factor.value = now
        return result

    def _of_densities(self) -> NDArray[np.float64]:
        """The vector of tractions and body forces, assembled again where one has changed.

        Ranks decide for themselves, so nothing here may be collective once the form is compiled.
        """
        if self._form is None:
            self._form, self._last = self._compile(), None
        values = [
            np.array(one.value) if isinstance(one, fem.Constant) else one.x.array.copy()
            for one in self._given
        ]
        if self._last is None or not all(map(np.array_equal, values, self._last[0])):
            with timer("assemble loads"):
                vector = np.zeros_like(self._u.x.array)
                self._last = values, fem.assemble_vector(vector, self._form)
        return self._last[1]

    def _compile(self) -> fem.Form:
        eta = ufl.TestFunction(self._space)
        metadata = {"quadrature_degree": load_degree(self._space.ufl_element().degree)}
        terms = []
        for kind, loads in (("ds", self._tractions), ("dx", self._body_forces)):
            entities = [(i, load.entities) for i, load in enumerate(loads)]
            measure = ufl.Measure(
                kind, domain=self._mesh, subdomain_data=entities, metadata=metadata
            )
            terms += [
                self._weight * ufl.dot(load.density, eta) * measure(i)
                for i, load in enumerate(loads)
            ]
        form = sum(terms[1:], terms[0])
        self._given = [*form.constants(), *form.coefficients()]
        return compile_form(form, self._mesh.comm, name="loads")
