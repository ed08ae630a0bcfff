"""The matrix of Newton's method, assembled where the state asks for another one."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_norm
from ..base.timers import timer
from ..problem.problem import Problem
from .linear import Petsc, is_iterative

#: Error of the forces that an older tangent foresees, relative to the forces of the correction: the
#: factor by which the next correction can reduce the residual.
MAX_LAG_ERROR = 3e-3


def lags_bulk(problem: Problem, linear: Petsc) -> bool:
    """Whether a run with this linear solver lags the bodies' part of the tangent.

    A direct solver factorizes every tangent, which costs more than assembling it; where nothing
    fails a step has few tangents; the mean dilatation couples the bodies' part to the rest.
    """
    mean_dilatation = problem.discretization.bodies.mean_dilatation
    return is_iterative(linear) and problem.discretization.can_fail and not mean_dilatation


class LaggedBulk:
    """Assembles the tangent with a part of the bodies that may be older.

    While interfaces fail, the bodies between them hardly strain from one iteration to the next:
    12,000 hexahedra are assembled again for nothing. Between the states u_1 and u_2 of two tangents
    the forces of the bodies have changed by R(u_2) - R(u_1), of which the older part K_b foresees
    K_b.(u_2 - u_1). It serves as long as the difference is below ``MAX_LAG_ERROR`` times
    |K.(u_2 - u_1)|, the residual that the correction was to remove: Newton's method then loses no
    more than one iteration in many.

    Args:
        problem: The problem.
        matrix: For the tangent; its pattern is that of the problem.
    """

    def __init__(self, problem: Problem, matrix: PETSc.Mat):
        self._problem = problem
        self._matrix = matrix
        self._bulk: PETSc.Mat | None = None
        self._u: NDArray[np.float64] | None = None
        self._forces: NDArray[np.float64] | None = None
        self._du, self._product = matrix.createVecs()
        self._prescribed = problem.loading.owned_prescribed
        self._owned = problem.discretization.owned

    def assemble(self, damage: bool = True) -> None:
        """Tangent at the state of the last residual, prescribed rows included; collective.

        Args:
            damage: False holds zeta: the damage part of (84) is left out.
        """
        forces = self._problem.discretization.bulk_forces()
        u = self._problem.u.x.array[: self._owned].copy()
        if self._bulk is None or self._stale(u, forces):
            self._renew(damage)
        else:
            self._bulk.copy(self._matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            self._problem.discretization.add_interface_tangent(self._matrix, damage)
        self._u, self._forces = u, forces

    def _stale(self, u: NDArray[np.float64], forces: NDArray[np.float64]) -> bool:
        """Whether the forces have changed otherwise than the older tangent foresees."""
        with timer("check bulk tangent"):
            du = u - self._u
            du[self._prescribed] = 0
            return self._size(forces - self._forces - self._times(self._bulk, u - self._u)) > (
                MAX_LAG_ERROR * self._size(self._times(self._matrix, du))
            )

    def _times(self, matrix: PETSc.Mat, du: NDArray[np.float64]) -> NDArray[np.float64]:
        self._du.array[:] = du
        matrix.mult(self._du, self._product)
        return self._product.array.copy()

    def _size(self, forces: NDArray[np.float64]) -> float:
        """Norm on the free dofs."""
        forces[self._prescribed] = 0
        return global_norm(self._problem.comm, forces)

    def _renew(self, damage: bool) -> None:
        self._problem.discretization.assemble_tangent(self._matrix, damage)
        if self._bulk is None:
            self._bulk = self._matrix.duplicate()
        self._bulk.zeroEntries()
        self._problem.discretization.add_interface_tangent(self._bulk, damage)
        self._bulk.aypx(-1.0, self._matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for item in (self._du, self._product, self._bulk):
            if item is not None:
                item.destroy()


class Tangent:
    """The tangent of a problem, of which the bodies' part may be older than the state.

    Args:
        problem: The problem.
        lags_bulk: Whether the bodies' part may be older, see :class:`LaggedBulk`.

    Attributes:
        matrix: K.
        norm: Infinity norm of the first one, prescribed rows included [N/mm].
    """

    def __init__(self, problem: Problem, lags_bulk: bool):
        self.matrix = problem.discretization.create_matrix()
        self.matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self.norm = 0.0
        self.bulk = LaggedBulk(problem, self.matrix) if lags_bulk else None
        self._problem = problem

    def assemble(self, damage: bool = True) -> None:
        """Tangent at the state of the last residual, prescribed rows included; collective.

        Args:
            damage: False holds zeta: the damage part of (84) is left out.
        """
        if self.bulk is None:
            self._problem.discretization.assemble_tangent(self.matrix, damage)
        else:
            self.bulk.assemble(damage)
        if self.norm == 0.0:
            self.norm = self.matrix.norm(PETSc.NormType.NORM_INFINITY)

    def constrain(self) -> None:
        """Rows and columns of prescribed dofs become those of the identity; collective."""
        self.matrix.zeroRowsColumnsLocal(self._problem.loading.owned_prescribed, 1.0)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for item in (self.bulk, self.matrix):
            if item is not None:
                item.destroy()
