"""The interface terms of (27) as UFL on interior facets, for elastic bodies on one mesh.

They are the same as those of :mod:`.point_residual`, of which every other interface is made: the
coefficients of the form, on a mesh of the facets, are set to what the points have.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.core.expr import Expr

from .. import compat
from ..base.kernels import compile_form
from ..domain.materials import Bodies
from ..domain.shapes import GeometryMap
from ..forms import residual
from ..forms.geometry import GeneralizedPlane
from ..points.facets import InterfaceFacets
from .active import ActiveInterface

Array = NDArray[np.float64]


def is_symbolic(active: ActiveInterface, bodies: Bodies) -> bool:
    """Whether the terms of an interface can be integrated over interior facets.

    Its facets match, are open from the start and hold no fluid, and all bodies are elastic, without
    eigenstrain, mean dilatation or generalized plane strain: every other product of features is a
    sum over points.
    """
    return not (
        active.facets.paired
        or active.fluid is not None
        or active.interface.activate == "on-demand"
        or bodies.points is not None
        or bodies.grow
        or bodies.mean_dilatation
        or isinstance(bodies.geometry, GeneralizedPlane)
    )


class SymbolicInterface:
    """One interface on interior facets, with its coefficients.

    Attributes:
        pairs: Facets as rows (cell 1, facet in it, cell 2, facet in it), flat, and the bodies on
            their sides, of every pair of regions.
    """

    def __init__(
        self,
        active: ActiveInterface,
        u: fem.Function,
        bodies: Bodies,
        eta: Expr | None = None,
    ):
        self.active, self._u = active, u
        quadrature, facets = active.quadrature, active.facets
        mesh = quadrature.mesh
        self.submesh = compat.facet_submesh(mesh, facets.facets)
        self._point = self._points_of_dofs()
        regions = bodies.region[facets.cells]
        self.pairs = [
            (
                facets.rows((regions == pair).all(axis=1)),
                tuple(bodies.regions[i].body for i in pair),
            )
            for pair in _region_pairs(facets, bodies, mesh.comm)
        ]
        self.measure = ufl.Measure(
            "dS",
            domain=mesh,
            subdomain_data=[(i, rows) for i, (rows, _) in enumerate(self.pairs)],
            metadata={"quadrature_degree": quadrature.degree},
        )
        d = quadrature.d
        law, turns = active.law, active.turns
        tensor, vector = self._space((d, d)), self._space((d,))
        # delta_1, delta_2, tau_s, zeta, delta_s of the form, and M of a rotating frame.
        self._delta = fem.Function(tensor), fem.Function(tensor)
        self._penalty = fem.Function(tensor)
        self._zeta = fem.Function(vector) if law.inelastic else None
        self._delta_s = fem.Function(tensor) if active.interface.traction_jump else None
        self._moment = fem.Function(tensor) if turns else None
        self._written: object = None
        self._residual = None if eta is None else self.compile(self.residual(eta))

    def _space(self, shape: tuple[int, ...]) -> fem.FunctionSpace:
        """Space of values at the points (44)-(45), on the mesh of the facets."""
        mesh = self.submesh.mesh
        element = basix.ufl.quadrature_element(
            mesh.basix_cell(), value_shape=shape, degree=self.active.quadrature.degree
        )
        return fem.functionspace(mesh, element)

    def _points_of_dofs(self) -> NDArray[np.int32]:
        quadrature, mesh = self.active.quadrature, self.submesh.mesh
        count = mesh.topology.index_map(mesh.topology.dim).size_local
        facets = np.searchsorted(self.active.facets.facets, self.submesh.facets[:count])
        cells = np.argsort(facets).astype(np.int32)
        rule, _ = basix.make_quadrature(mesh.basix_cell(), quadrature.degree)
        there = GeometryMap(mesh, rule)
        x = np.moveaxis(there.positions(there.nodes(cells)), 0, -1)
        points = quadrature.points_of_facet
        mine = quadrature.points[points][..., : quadrature.d]
        order = np.linalg.norm(mine[:, None] - x[:, :, None], axis=3).argmin(axis=2)
        found = np.empty(points.size, dtype=np.int32)
        found[self._space(()).dofmap.list[cells]] = np.take_along_axis(points, order, axis=1)
        return found

    def field(self, values: Array) -> Expr:
        """Values at the points (nq, ...) as a coefficient of forms on the facets."""
        function = fem.Function(self._space(values.shape[1:]))
        self._write(function, values)
        return function("+")

    def _write(self, function: fem.Function, values: Array) -> None:
        function.x.array[:] = values[self._point].ravel()

    def update(self) -> None:
        """Set the coefficients to tau_s and the values at the points."""
        stabilization, values = self.active.stabilization, self.active.values
        if self._written is not stabilization:
            facet = self.active.quadrature.facet
            for a, delta in enumerate(self._delta):
                self._write(delta, stabilization.weights[facet, a])
            self._write(self._penalty, stabilization.penalty[facet])
            if self._delta_s is not None:
                self._write(self._delta_s, stabilization.delta_s[facet])
            self._written = stabilization
        if self._zeta is not None:
            self._write(self._zeta, values.gap)
        if self._moment is not None:
            self._write(self._moment, values.moment)

    def add_to(self, vector: Array) -> None:
        """Add the forces of (27), over local dofs before ghosts are added to owners [N]."""
        self.update()
        fem.assemble_vector(vector, self._residual)

    def residual(self, eta: Expr) -> ufl.Form:
        """Interface terms of (27), or of (26) with the traction jump."""
        moment = None if self._moment is None else self._moment("+")
        return self._sum(lambda *known: residual.residual(eta, *known, moment=moment))

    def energy(self) -> ufl.Form:
        """Interface terms of (30), without a fluid, whose work is that of a load."""
        return self._sum(
            lambda bodies, *known: residual.energy(
                tuple(replace(body, fluid=None) for body in bodies), *known
            )
        )

    def _sum(self, integrand: Callable[..., Expr]) -> ufl.Form:
        """Integral of ``integrand(bodies, geometry, u, N, delta, tau_s, zeta, delta_s)``."""
        quadrature = self.active.quadrature
        geometry, N = quadrature.geometry, ufl.FacetNormal(quadrature.mesh)("+")
        zeta, delta_s = (None if f is None else f("+") for f in (self._zeta, self._delta_s))
        delta = tuple(f("+") for f in self._delta)
        known = geometry, self._u, N, delta, self._penalty("+"), zeta, delta_s
        terms = (
            geometry.weight * integrand(bodies, *known) * self.measure(i)
            for i, (_, bodies) in enumerate(self.pairs)
        )
        return sum(terms, start=ufl.Form([]))

    def compile(self, form: ufl.Form, name: str = "interface's residual") -> fem.Form:
        comm = self.active.quadrature.mesh.comm
        return compile_form(form, comm, name=name, submeshes=[self.submesh])


def _region_pairs(facets: InterfaceFacets, bodies: Bodies, comm: MPI.Comm) -> list[tuple[int, ...]]:
    """Pairs of regions on the two sides of a facet on any rank, in the same order on all."""
    pairs = comm.allgather(np.unique(bodies.region[facets.cells], axis=0))
    return [tuple(pair) for pair in np.unique(np.concatenate(pairs), axis=0)]
