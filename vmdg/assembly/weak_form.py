"""The weak form (27) in UFL, summed over bodies and interfaces, and the bodies' tangent."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.core.expr import Expr

from ..base.kernels import JIT_OPTIONS, VECTORIZED, compile_form
from ..base.quadrature import bulk_degree, facet_degree
from ..domain.materials import Bodies
from ..forms import kinematics
from ..forms.kinematics import Body
from ..interface.active import ActiveInterface
from ..interface.terms import InterfaceTerms, RegionPair

#: Of all local cells.
Marks = NDArray[np.bool_]


class WeakForm:
    """The forms for a displacement with given open facets.

    Args:
        u: Displacement.
        bodies: Materials.
        active: Interfaces with open facets.

    Attributes:
        u: As given.
        space: Space of the displacement.
        active: As given.
        geometry: Gradient and measure.
    """

    def __init__(self, u: fem.Function, bodies: Bodies, active: Sequence[ActiveInterface]):
        self.u = u
        self.space = u.function_space
        self.geometry = bodies.geometry
        self._bodies = bodies
        self.active = active
        self._mesh = mesh = self.space.mesh
        degree = self.space.ufl_element().degree
        self._facet_degree = facet_degree(degree)
        self._dx = ufl.Measure(
            "dx",
            domain=mesh,
            subdomain_data=[(i, region.cells) for i, region in enumerate(bodies.regions)],
            metadata={
                "quadrature_degree": bulk_degree(mesh.topology.cell_name(), degree, self.geometry)
            },
        )

    def residual(self, eta: Expr | None = None) -> ufl.Form:
        """The stabilized residual (27) without dead loads.

        Args:
            eta: Test function of the displacement, or with mean dilatation of the dilatation.
        """
        eta = ufl.TestFunction(self.space) if eta is None else eta
        return self.bulk_residual(eta) + self.interface_residual(eta)

    def energy(self) -> tuple[ufl.Form, ufl.Form]:
        """Stored energy of the bodies, and of the interfaces (30)."""
        stored = self.over_interfaces(lambda terms, pair: terms.energy(pair.bodies))
        return self.over_bodies(lambda body, F: body.energy(F)), stored

    # Parts

    def bulk_residual(self, eta: Expr, cells: Marks | None = None) -> ufl.Form:
        """First term of (27), of all cells or of some."""
        virtual = self.geometry.gradient(eta)
        return self.over_bodies(
            lambda body, F: ufl.inner(virtual, kinematics.bulk_stress(body, self.geometry, F)),
            cells,
        )

    def interface_residual(
        self, eta: Expr, interfaces: Sequence[ActiveInterface] | None = None
    ) -> ufl.Form:
        """The other terms of (27), for all interfaces or for these."""
        return self.over_interfaces(
            lambda terms, pair: terms.residual(eta, pair.bodies), interfaces
        )

    def bulk_tangent(self, eta: Expr, du: Expr, cells: Marks | None = None) -> ufl.Form:
        """First term of (85), of all cells or of some."""
        return self.over_bodies(
            lambda body, F: kinematics.stiffness(body, self.geometry, F, eta, du), cells
        )

    def over_bodies(
        self, integrand: Callable[[Body, Expr], Expr], cells: Marks | None = None
    ) -> ufl.Form:
        """Sum over the regions of ``integrand(body, F)``, in all cells or in some."""
        F, dx = ufl.variable(self.geometry.deformation(self.u)), self._dx
        if cells is not None:
            dx = dx(
                subdomain_data=[
                    (i, region.cells[cells[region.cells]])
                    for i, region in enumerate(self._bodies.regions)
                ]
            )
        terms = [
            self.geometry.weight * integrand(region.body, F) * dx(i)
            for i, region in enumerate(self._bodies.regions)
        ]
        return sum(terms, start=ufl.Form([]))

    def over_interfaces(
        self,
        integrand: Callable[[InterfaceTerms, RegionPair], Expr],
        interfaces: Sequence[ActiveInterface] | None = None,
    ) -> ufl.Form:
        """Sum over all interfaces, or over these, of ``integrand(terms, pair)``."""
        chosen = self.active if interfaces is None else interfaces
        pairs = [(terms, pair) for terms in _of_facets(chosen) for pair in terms.pairs]
        dS = ufl.Measure(
            "dS",
            domain=self._mesh,
            subdomain_data=[(i, pair.rows) for i, (_, pair) in enumerate(pairs)],
            metadata={"quadrature_degree": self._facet_degree},
        )
        terms = [self.geometry.weight * integrand(*pair) * dS(i) for i, pair in enumerate(pairs)]
        return sum(terms, start=ufl.Form([]))

    def compile(self, form: ufl.Form, name: str = "form", options: dict | None = None) -> fem.Form:
        """Compile a form with possible interface coefficients; collective."""
        submeshes = [terms.submesh for terms in _of_facets(self.active)]
        if options is None:
            options = VECTORIZED if self._mesh.topology.dim == 3 else JIT_OPTIONS
        return compile_form(form, submeshes, self._mesh.comm, options, name)


def _of_facets(active: Sequence[ActiveInterface]) -> list[InterfaceTerms]:
    """Integrands of the interfaces whose meshes match; the others are sums over points."""
    return [one.terms for one in active if isinstance(one.terms, InterfaceTerms)]
