"""(27) and (30) in UFL, where meshes match: what the sums over points are compared with."""

from __future__ import annotations

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

import vmdg
from vmdg.base.kernels import compile_form
from vmdg.interface.symbolic import SymbolicInterface


class SymbolicForm:
    """(27) and (30) of a problem whose meshes match, at the values of its points.

    Attributes:
        interfaces: The terms of every interface.
    """

    def __init__(self, problem: vmdg.Problem):
        parts = problem.discretization
        self._comm, self._weak_form = problem.comm, parts.weak_form
        self.interfaces = [
            SymbolicInterface(one, problem.u, parts.bodies) for one in parts.active.values()
        ]
        for one in self.interfaces:
            one.update()

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
        submeshes = [one.submesh for one in self.interfaces]
        return compile_form(form, self._comm, submeshes=submeshes)
