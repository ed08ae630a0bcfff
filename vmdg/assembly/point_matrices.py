"""Matrices between the points of an interface, as rows, and displacements, as columns."""

from __future__ import annotations

from collections.abc import Callable

from petsc4py import PETSc

import ufl
from dolfinx.fem import petsc as fem_petsc
from ufl.core.expr import Expr

from ..interface.active import ActiveInterface
from .weak_form import WeakForm


def traction_matrix(weak_form: WeakForm, active: ActiveInterface) -> PETSc.Mat:
    """int q.Tt(du) dA over an interface, q the test functions of its points.

    Tt(du) = {(A : GRAD du).N} + r (du_2 - du_1) of (84) with the staged moduli, which at small
    strain are constant. The caller destroys the matrix.
    """
    active.stage_tangent(damage=False)
    return _point_matrix(weak_form, active, active.terms.traction)


def jump_matrix(weak_form: WeakForm, active: ActiveInterface) -> PETSc.Mat:
    """int q.du_2 dA over an interface: the part of side 2 in its opening, as above."""
    return _point_matrix(weak_form, active, lambda q, du: ufl.dot(q, du("-")))


def _point_matrix(
    weak_form: WeakForm, active: ActiveInterface, integrand: Callable[[Expr, Expr], Expr]
) -> PETSc.Mat:
    q = ufl.TestFunction(active.quadrature.space((active.quadrature.d,)))("+")
    du = ufl.TrialFunction(weak_form.space)
    form = weak_form.over_interfaces(lambda terms, pair: integrand(q, du), [active])
    form = weak_form.compile(form, "gap equation")
    matrix = fem_petsc.create_matrix(form)
    fem_petsc.assemble_matrix(matrix, form)
    matrix.assemble()
    return matrix
