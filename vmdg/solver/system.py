"""Linear systems with the tangent, prescribed dofs included."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_any
from ..problem.problem import Problem
from .linear import (
    LinearSolver,
    Petsc,
    interface_zone,
    is_iterative,
    linear_options,
    set_rigid_modes,
)
from .tangent import Tangent, lags_bulk

Array = NDArray[np.float64]


class System:
    """K.du = forces with displacements prescribed, for several right-hand sides.

    Args:
        problem: The problem.
        petsc: Options of the user's, without prefix.
    """

    def __init__(self, problem: Problem, petsc: Petsc | None):
        linear = linear_options(problem, petsc)
        self._comm = problem.comm
        self._tangent = Tangent(problem, lags_bulk(problem, linear.solver))
        matrix = self._tangent.matrix
        iterative = linear.automatic and is_iterative(linear.solver)
        zone = interface_zone(problem) if iterative and problem.discretization.can_fail else None
        self._linear = LinearSolver(matrix, linear.solver, linear.fallback, zone)
        if self._linear.multigrid:
            parts = problem.discretization
            set_rigid_modes(parts.space, parts.geometry, matrix)
        self._x, self._b = matrix.createVecs()
        self._prescribed = problem.loading.owned_prescribed

    @property
    def iterations(self) -> int:
        """Krylov iterations so far."""
        return self._linear.iterations

    @property
    def norm(self) -> float:
        """Infinity norm of the first tangent [N/mm]."""
        return self._tangent.norm

    def assemble(
        self, moved: Sequence[Array], damage: bool = True
    ) -> Callable[[Array, int, float], Array]:
        """The tangent at the state of the last residual; collective.

        Args:
            moved: Displacements of owned dofs, zero but on prescribed ones [mm].
            damage: False holds zeta.

        Returns:
            Solves K.du = forces (owned dofs) with the prescribed displacement of a number, to a
            relative tolerance.
        """
        self._tangent.assemble(damage)
        lifts = [self._lift(du) for du in moved]
        self._tangent.constrain()

        def solve(forces: Array, number: int, rtol: float) -> Array:
            self._b.array[:] = forces - lifts[number]
            self._b.array[self._prescribed] = moved[number][self._prescribed]
            self._linear.solve(self._b, self._x, rtol)
            return self._x.array.copy()

        return solve

    def _lift(self, du: Array) -> Array | float:
        """Forces of a displacement of prescribed dofs."""
        if not global_any(self._comm, du.any()):
            return 0.0
        self._x.array[:] = du
        self._tangent.matrix.mult(self._x, self._b)
        return self._b.array.copy()

    def free(self) -> None:
        """Free the PETSc objects; collective."""
        self._linear.free()
        self._tangent.destroy()
        self._x.destroy()
        self._b.destroy()
