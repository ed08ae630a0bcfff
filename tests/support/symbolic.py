"""(27) and (30) in UFL, where meshes match: what the sums over points are compared with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

import vmdg
from vmdg import compat
from vmdg.domain.shapes import GeometryMap
from vmdg.forms import residual
from vmdg.interface.active import ActiveInterface


class SymbolicInterface:
    """One interface on dS, with the coefficients of its points.

    Attributes:
        submesh: Mesh of the coefficients.
        measure: dS of the facets, by pairs of regions.
    """

    def __init__(self, problem: vmdg.Problem, active: ActiveInterface):
        self.active, self._problem = active, problem
        q, facets, self._d = active.quadrature, active.facets, problem.mesh.geometry.dim
        self.submesh = compat.facet_submesh(problem.mesh, facets.facets)
        sub = self.submesh.mesh
        self._cell = sub.basix_cell()
        count = sub.topology.index_map(sub.topology.dim).size_local
        cells = np.argsort(np.searchsorted(facets.facets, self.submesh.facets[:count]))
        points, _ = basix.make_quadrature(self._cell, q.degree)
        there = GeometryMap(sub, points)
        x = np.moveaxis(there.positions(there.nodes(cells.astype(np.int32))), 0, -1)
        mine = q.points[q.points_of_facet][..., : self._d]
        order = np.linalg.norm(mine[:, None] - x[:, :, None], axis=3).argmin(axis=2)
        #: Point of the interface for every dof of the submesh.
        self._point = np.empty(q.points_of_facet.size, dtype=np.int64)
        dofs = self.space(()).dofmap.list[cells]
        self._point[dofs] = np.take_along_axis(q.points_of_facet, order, axis=1)
        bodies = problem.discretization.bodies
        regions = bodies.region[facets.cells]
        self.pairs = [
            (facets.rows((regions == pair).all(axis=1)), [bodies.regions[i].body for i in pair])
            for pair in np.unique(regions, axis=0)
        ]
        self.measure = ufl.Measure(
            "dS",
            domain=problem.mesh,
            subdomain_data=[(i, rows) for i, (rows, _) in enumerate(self.pairs)],
            metadata={"quadrature_degree": q.degree},
        )

    def space(self, shape: tuple[int, ...]) -> fem.FunctionSpace:
        """Space of values at the points."""
        element = basix.ufl.quadrature_element(
            self._cell, value_shape=shape, degree=self.active.quadrature.degree
        )
        return fem.functionspace(self.submesh.mesh, element)

    def field(self, values: np.ndarray) -> Expr:
        """Values at the points (nq, ...) as a coefficient."""
        function = fem.Function(self.space(values.shape[1:]))
        function.x.array[:] = values[self._point].ravel()
        return function("+")

    def terms(self, integrand: Callable[..., Expr]) -> ufl.Form:
        """Sum of ``integrand(bodies, geometry, u, N, delta_1, tau_s, zeta, delta_s)``."""
        active, q = self.active, self.active.quadrature
        of, values = active.stabilization, active.values
        scalar = active.law.inelastic or active.turns
        tau = self.field((of.norm if active.law.inelastic else of.tau)[q.facet])
        delta = self.field(of.weights[q.facet, 0])
        zeta = self.field(values.gap) if active.law.inelastic else None
        delta_s = self.field(of.delta_s[q.facet]) if active.interface.traction_jump else None
        assert scalar or values.gap is None
        geometry, N = q.geometry, ufl.FacetNormal(self._problem.mesh)("+")
        known = geometry, self._problem.u, N, delta, tau, zeta, delta_s
        return sum(
            (
                geometry.weight * integrand(tuple(bodies), *known) * self.measure(i)
                for i, (_, bodies) in enumerate(self.pairs)
            ),
            start=ufl.Form([]),
        )

    def residual(self, eta: Expr) -> ufl.Form:
        """Interface terms of (27), or of (26) with the traction jump."""
        moment = self.active.values.moment
        turned = None if moment is None else self.field(moment)
        return self.terms(lambda *known: residual.residual(eta, *known, moment=turned))

    def energy(self) -> ufl.Form:
        """Interface term of (30), without a fluid."""
        return self.terms(
            lambda bodies, *known: residual.energy(
                tuple(replace(body, fluid=None) for body in bodies), *known
            )
        )


class SymbolicForm:
    """(27) and (30) of a problem whose meshes match."""

    def __init__(self, problem: vmdg.Problem):
        parts = problem.discretization
        self._problem, self._weak_form = problem, parts.weak_form
        self.interfaces = [SymbolicInterface(problem, one) for one in parts.active.values()]

    def residual(self, eta: Expr) -> ufl.Form:
        """(27) without dead loads."""
        parts = (one.residual(eta) for one in self.interfaces)
        return sum(parts, start=self._weak_form.bulk_residual(eta))

    def energy(self) -> ufl.Form:
        """Stored energy of bodies and interfaces."""
        stored = self._weak_form.over_bodies(lambda body, F: body.energy(F))
        return sum((one.energy() for one in self.interfaces), start=stored)

    def compile(self, form: ufl.Form) -> fem.Form:
        """Compile a form with coefficients at the points."""
        maps = [one.submesh.entity_map for one in self.interfaces]
        if maps and isinstance(maps[0], dict):  # DOLFINx 0.9
            maps = {mesh: entities for one in maps for mesh, entities in one.items()}
        return fem.form(form, entity_maps=maps)
