"""The cell dilatation and its elimination from the equations, for mean dilatation.

The forms depend on the displacement and, as an independent cell-wise constant field, on the
dilatation theta (:mod:`forms.dilatation`). With Pi(u, theta) the energy of bodies and interfaces,
theta(u) = 1/V int_K J dV and D = dtheta/du, q -> 1/V int_K dJ/dF : GRAD du dV,

    R = dPi/du + D^T.dPi/dtheta,
    K = d2Pi/du2 + p d2J/du2 + d2Pi/dudtheta.D + D^T.(d2Pi/dthetadu + d2Pi/dtheta2.D)

with p = (dPi/dtheta)/V in every cell: D^T.dPi/dtheta is int p dJ/dF : GRAD eta dV, which the
residual form assembles directly. The same holds with the damage term of (84) for the second
derivatives. In cells next to an interface the flux terms contribute to p.

K and the vectors have the same size as without theta, and K has the same sparsity pattern: an
interface couples all nodes of its two cells, which covers the products.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx.la import InsertMode
from numpy.typing import NDArray

from ..base.timers import timer
from ..interface.active import ActiveInterface, interface_flux
from ..interface.point_flux import FluxChange
from ..points.jets import FacetJets
from .point_matrices import add_couplings, add_fields, create_matrix, sparsity
from .weak_form import WeakForm

Array = NDArray[np.float64]


class Dilatation:
    """theta and p of a displacement, and the products of K with D."""

    def __init__(self, weak_form: WeakForm):
        self._weak_form = weak_form
        geometry = weak_form.geometry
        self._theta, self._pressure = geometry.theta, geometry.pressure
        self._test = ufl.TestFunction(self._theta.function_space)
        self._products: list[PETSc.Mat | None] = [None, None, None]

    def compile(self) -> None:
        _ = self._ratio, self._pressures, self._volume, self._forms

    def couple(self) -> None:
        """Make the products again where surfaces that slide have pairs which they lack;
        collective."""
        for matrix in (*self.__dict__.pop("_blocks", ()), *self._products):
            if matrix is not None:
                matrix.destroy()
        self._products = [None, None, None]

    @cached_property
    def _ratio(self) -> fem.Form:
        weak, q = self._weak_form, self._test
        ratio = weak.over_bodies(lambda body, F: q * body.volume_ratio(F))
        return weak.compile(ratio, "dilatation")

    @cached_property
    def _pressures(self) -> fem.Form:
        return self._weak_form.compile(self._weak_form.bulk_residual(self._test), "dilatation")

    @cached_property
    def _volume(self) -> fem.Function:
        weak, result = self._weak_form, fem.Function(self._theta.function_space)
        form = weak.compile(weak.over_bodies(lambda body, F: self._test), "dilatation")
        fem.assemble_vector(result.x.array, form)
        result.x.scatter_forward()
        return result

    @cached_property
    def _forms(self) -> list[fem.Form]:
        """V D and the blocks of the two-field tangent that involve theta."""
        weak, q = self._weak_form, self._test
        p = ufl.TrialFunction(self._theta.function_space)
        eta, du = ufl.TestFunction(weak.space), ufl.TrialFunction(weak.space)
        gradient = weak.geometry.gradient(du)
        ratio = weak.over_bodies(
            lambda body, F: q * ufl.inner(ufl.diff(body.volume_ratio(F), F), gradient)
        )
        fields = (q, du), (eta, p), (q, du), (q, p)
        forms = [ratio, *(weak.bulk_tangent(*pair) for pair in fields[1:])]
        return [weak.compile(form, "dilatation") for form in forms]

    @cached_property
    def _blocks(self) -> list[PETSc.Mat]:
        weak, theta = self._weak_form, self._theta.function_space
        u = weak.space
        pairs = (theta, u), (u, theta), (theta, u), (theta, theta)
        return [create_matrix(u.mesh.comm, sparsity(*pair, weak.active)) for pair in pairs]

    def update_dilatation(self) -> None:
        """theta = 1/V int_K J dV at the current displacement; collective."""
        self._average(self._theta, self._ratio)

    def update_pressure(self) -> None:
        """p = 1/V dPi/dtheta at the current displacement, dilatation and gap; collective."""
        of_pairs = np.zeros_like(self._pressure.x.array)
        dofs = self._pressure.function_space.dofmap.list[:, 0]
        for active in self._weak_form.active:
            if active.stabilization is not None:
                cells = active.facets.cells[active.quadrature.facet]
                forces = active.point_tangent.jets.on_dilatation(interface_flux(active))
                np.add.at(of_pairs, dofs[cells], forces)
        self._average(self._pressure, self._pressures, of_pairs)

    def _average(self, function: fem.Function, form: fem.Form, more: Array | float = 0.0) -> None:
        values = function.x
        values.array[:] = more
        fem.assemble_vector(values.array, form)
        values.scatter_reverse(InsertMode.add)
        values.array[:] /= self._volume.x.array
        values.scatter_forward()

    def add_to(
        self,
        matrix: PETSc.Mat,
        parts: Sequence[tuple[ActiveInterface, Array, FluxChange | None]],
    ) -> None:
        """Add A_ut.D + D^T.(A_tu + A_tt.D) to d2Pi/du2 + p d2J/du2; collective."""
        u, theta = FacetJets.displacement, FacetJets.dilatation
        fields = None, (u, theta), (theta, u), (theta, theta)
        blocks = self._blocks
        with timer("eliminate dilatation"):
            for form, block, pair in zip(self._forms, blocks, fields, strict=True):
                fresh = not block.assembled
                block.zeroEntries()
                fem_petsc.assemble_matrix(block, form)
                if pair:
                    for active, values, change in parts:
                        add_fields(block, active, values, *pair, change)
                        if fresh:
                            add_couplings(block, active, *pair)
                block.assemble()
            D, A_ut, A_tu, A_tt = blocks
            inverse_volume = D.createVecLeft()
            inverse_volume.array[:] = 1 / self._volume.x.array[: inverse_volume.getLocalSize()]
            D.diagonalScale(L=inverse_volume)
            inverse_volume.destroy()
            first, inner, second = self._products
            first = A_ut.matMult(D, result=first)
            inner = A_tt.matMult(D, result=inner)
            total = inner.copy()
            total.axpy(1.0, A_tu, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            second = D.transposeMatMult(total, result=second)
            total.destroy()
            self._products = [first, inner, second]
            for product in (first, second):
                matrix.axpy(1.0, product, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
