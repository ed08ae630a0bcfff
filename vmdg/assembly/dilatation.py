"""The dilatation of the cells and its elimination from the equations, for mean dilatation.

The forms know the displacement and, as an independent field constant in every cell, the dilatation
theta (:mod:`forms.dilatation`). With Pi(u, theta) the energy of bodies and interfaces,
theta(u) = 1/V int_K J dV and D = dtheta/du, q -> 1/V int_K dJ/dF : GRAD du dV,

    R = dPi/du + D^T.dPi/dtheta,
    K = d2Pi/du2 + p d2J/du2 + d2Pi/dudtheta.D + D^T.(d2Pi/dthetadu + d2Pi/dtheta2.D)

with p = (dPi/dtheta)/V in every cell: D^T.dPi/dtheta is int p dJ/dF : GRAD eta dV, which the
residual form assembles as it is. The same holds with the damage term of (84) for the second
derivatives. Cells next to an interface add to p what the flux terms there have of theta.

Neither K nor the vectors are larger than without theta, and K has the same pattern: an interface
joins all nodes of its two cells, which is as far as the products reach.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from petsc4py import PETSc

import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx.la import InsertMode

from ..base.timers import timer

if TYPE_CHECKING:
    from .discretization import Discretization

SUBSET = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN


class Dilatation:
    """theta and p of a discretization, and the products of K with D.

    Args:
        discretization: Gives the forms; its geometry holds theta and p.
    """

    def __init__(self, discretization: Discretization):
        self._forms = discretization
        self._geometry = discretization.geometry
        self._theta, self._pressure = self._geometry.theta, self._geometry.pressure
        self._space = self._theta.function_space
        self._test = ufl.TestFunction(self._space)
        self._volume = fem.Function(self._space)
        self._vectors: tuple[fem.Form, fem.Form] | None = None
        self._matrices: _Products | None = None

    def compile_residual(self) -> None:
        """Compile what theta and p need, or load it from the cache; collective."""
        if self._vectors is not None:
            return
        forms, q = self._forms, self._test
        ratio = forms.bulk(lambda body, F: q * body.volume_ratio(F))
        integrands = ratio, forms.residual_ufl(q)
        self._vectors = tuple(forms.compile_form(form, "dilatation") for form in integrands)
        volume = forms.compile_form(forms.bulk(lambda body, F: q), "dilatation")
        fem.assemble_vector(self._volume.x.array, volume)
        self._volume.x.scatter_forward()

    def compile_tangent(self) -> None:
        """Compile the blocks of the tangent, or load them from the cache; collective."""
        if self._matrices is None:
            self.compile_residual()
            self._matrices = _Products(self._forms, self._space, self._volume)

    def update_dilatation(self) -> None:
        """theta = 1/V int_K J dV at the current displacement; collective."""
        self.compile_residual()
        self._average(self._theta, self._vectors[0])

    def update_pressure(self) -> None:
        """p = 1/V dPi/dtheta at the current displacement, dilatation and gap; collective."""
        self._average(self._pressure, self._vectors[1])

    def _average(self, function: fem.Function, form: fem.Form) -> None:
        values = function.x
        values.array[:] = 0
        fem.assemble_vector(values.array, form)
        values.scatter_reverse(InsertMode.add)
        values.array[:] /= self._volume.x.array
        values.scatter_forward()

    def add_to(self, matrix: PETSc.Mat) -> None:
        """Add the terms with D to d2Pi/du2 + p d2J/du2; collective."""
        self.compile_tangent()
        with timer("eliminate dilatation"):
            self._matrices.add_to(matrix)


class _Products:
    """D, the blocks of the two-field tangent that have theta, and their products."""

    def __init__(self, forms: Discretization, space: fem.FunctionSpace, volume: fem.Function):
        q, p = ufl.TestFunction(space), ufl.TrialFunction(space)
        eta, du = ufl.TestFunction(forms.space), ufl.TrialFunction(forms.space)
        gradient = forms.geometry.gradient(du)
        ratio = forms.bulk(
            lambda body, F: q * ufl.inner(ufl.diff(body.volume_ratio(F), F), gradient)
        )
        blocks = (
            ratio,
            forms.tangent_ufl(eta, p),
            forms.tangent_ufl(q, du),
            forms.tangent_ufl(q, p),
        )
        self._forms = [forms.compile_form(block, "dilatation") for block in blocks]
        self._matrices = [fem_petsc.create_matrix(form) for form in self._forms]
        self._inverse_volume = self._matrices[0].createVecLeft()
        self._inverse_volume.array[:] = 1 / volume.x.array[: self._inverse_volume.getLocalSize()]
        self._products: list[PETSc.Mat | None] = [None, None, None]

    def add_to(self, matrix: PETSc.Mat) -> None:
        """Add A_ut.D + D^T.(A_tu + A_tt.D)."""
        for form, block in zip(self._forms, self._matrices, strict=True):
            block.zeroEntries()
            fem_petsc.assemble_matrix(block, form)
            block.assemble()
        D, A_ut, A_tu, A_tt = self._matrices
        D.diagonalScale(L=self._inverse_volume)
        first, inner, second = self._products
        first = A_ut.matMult(D, result=first)
        inner = A_tt.matMult(D, result=inner)
        total = inner.copy()
        total.axpy(1.0, A_tu, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        second = D.transposeMatMult(total, result=second)
        total.destroy()
        self._products = [first, inner, second]
        for product in (first, second):
            matrix.axpy(1.0, product, SUBSET)
