"""The terms of (27) and (85) in UFL: on bodies, and of (27) on the facets of plain interfaces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.core.expr import Expr

from ..base.kernels import JIT_OPTIONS, VECTORIZED, compile_form
from ..base.quadrature import bulk_degree
from ..domain.materials import Bodies
from ..forms import kinematics
from ..forms.kinematics import Body
from ..interface.active import ActiveInterface
from ..interface.symbolic import SymbolicInterface, is_symbolic

#: Of all local cells.
Marks = NDArray[np.bool_]


class WeakForm:
    """The forms for a displacement with given open facets."""

    def __init__(
        self,
        u: fem.Function,
        bodies: Bodies,
        active: Sequence[ActiveInterface],
        test_space: fem.FunctionSpace,
        symbolic: bool,
    ):
        self.u = u
        self.space = u.function_space
        self.geometry = bodies.geometry
        self._bodies = bodies
        self.active = active
        self.symbolic = symbolic
        self._test_space = test_space
        self._mesh = mesh = self.space.mesh
        degree = self.space.ufl_element().degree
        self._dx = ufl.Measure(
            "dx",
            domain=mesh,
            subdomain_data=[(i, region.cells) for i, region in enumerate(bodies.regions)],
            metadata={
                "quadrature_degree": bulk_degree(mesh.topology.cell_name(), degree, self.geometry)
            },
        )

    @cached_property
    def on_facets(self) -> list[SymbolicInterface | None]:
        """The terms of (27) of every interface on interior facets; None where they are sums over
        points. Compiles their kernels, collective."""
        eta = ufl.TestFunction(self._test_space)
        return [
            SymbolicInterface(one, self.u, self._bodies, eta)
            if self.symbolic and is_symbolic(one, self._bodies)
            else None
            for one in self.active
        ]

    def bulk_residual(self, eta: Expr, cells: Marks | None = None) -> ufl.Form:
        """First term of (27), of all cells or of some."""
        virtual = self.geometry.gradient(eta)
        return self.over_bodies(
            lambda body, F: ufl.inner(virtual, kinematics.bulk_stress(body, self.geometry, F)),
            cells,
        )

    def bulk_tangent(self, eta: Expr, du: Expr, cells: Marks | None = None) -> ufl.Form:
        """First term of (85), of all cells or of some."""
        return self.along(*map(self.geometry.gradient, (eta, du)), cells)

    def along(self, eta: Expr, du: Expr, cells: Marks | None = None) -> ufl.Form:
        """First term of (85) of these gradients (n, n). Both directions of a sum belong in one of
        them: UFL takes minutes to put in order two terms that differ in a leaf of a material."""
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

    def compile(self, form: ufl.Form, name: str = "form", options: dict | None = None) -> fem.Form:
        if options is None:
            options = VECTORIZED if self._mesh.topology.dim == 3 else JIT_OPTIONS
        return compile_form(form, self._mesh.comm, options, name)
