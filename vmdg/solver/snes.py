"""PETSc SNES for equations that solve their own linear systems, and when its iteration ends.

What PETSc calls passes arrays in and out, so that equations know no vectors of PETSc.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_max
from ..compat import SNES_REASONS, UNBOUNDED_SEARCH
from ..linear.ksp import destroy, set_options, warn_of_unused
from ..problem.problem import Problem
from .options import SolveOptions

Array = NDArray[np.float64]

#: The line search: backtracking by halves, or full steps.
KIND = "snes_linesearch_type"

_REASONS = {value: name for name, value in SNES_REASONS.items()}


class Equations(Protocol):
    """R(x) = 0 with the tangent J, over the unknowns of this rank; all methods are collective."""

    def residual(self, x: Array) -> Array:
        """R at a state."""

    def correction(self, residual: Array) -> Array:
        """J^-1.R, which is subtracted from the state of the last residual."""

    def product(self, way: Array) -> Array:
        """J along a direction, for the slope of a line search."""

    def test(self, norm: float) -> int:
        """PETSc's reason to end the iteration at a norm of R, or to continue it."""


class _Linear:
    """The contexts of PETSc for the linear solver and the matrix."""

    def __init__(self, equations: Equations):
        self._equations = equations

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        x.array[:] = self._equations.correction(b.array_r)
        ksp.setConvergedReason(PETSc.KSP.ConvergedReason.CONVERGED_ITS)

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        y.array[:] = self._equations.product(x.array_r)


class Snes:
    """One SNES for the equations of all steps."""

    def __init__(self, comm: MPI.Comm, local: int, options: SolveOptions):
        self._x = PETSc.Vec().createMPI((local, None), comm=comm)
        self._residual = self._x.duplicate()
        self._matrix = PETSc.Mat().create(comm)
        self._matrix.setSizes(((local, None), (local, None)))
        self._matrix.setType(PETSc.Mat.Type.PYTHON)
        self._snes = PETSc.SNES().create(comm)
        self._snes.getKSP().setType(PETSc.KSP.Type.PYTHON)
        self._snes.getKSP().getPC().setType(PETSc.PC.Type.NONE)
        self._own = {k: v for k, v in (options.petsc or {}).items() if k.startswith("snes_")}
        self._kind = ""  # of the line search so far
        # By halves, independently of the norm of the correction.
        least = float(np.finfo(float).tiny)
        halves = {"order": 1, "max_it": options.path.halvings, "minlambda": least}
        halves |= UNBOUNDED_SEARCH
        search = {f"snes_linesearch_{name}": value for name, value in halves.items()}
        set_options(self._snes, search | {"snes_stol": 0.0} | self._own)

    def solve(
        self,
        equations: Equations,
        start: Array,
        searches: bool,
        longest: Callable[[Array, Array], float] | None = None,
    ) -> tuple[bool, str]:
        """Solve from a state on; collective.

        Args:
            searches: Whether corrections are halved that do not reduce the residual.
            longest: Which part of a correction may be made at most, from the state and the
                correction; None for all of it.

        Returns:
            Whether it has converged, and PETSc's reason.
        """

        def residual(_: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
            f.array[:] = equations.residual(x.array_r)

        def shorten(x: PETSc.Vec, y: PETSc.Vec) -> bool:
            length = longest(x.array_r, y.array_r) if longest else 1.0
            y.scale(length)
            return length < 1.0

        self._x.array[:] = start
        linear = _Linear(equations)
        self._snes.setFunction(residual, self._residual)
        self._snes.setJacobian(lambda *_: None, self._matrix)
        self._snes.setConvergenceTest(lambda _, __, norms: equations.test(norms[2]))
        self._snes.setLineSearchPreCheck(shorten)
        self._snes.getKSP().setPythonContext(linear)
        self._matrix.setPythonContext(linear)
        self._matrix.setUp()
        kind = self._own.get(KIND, "bt" if searches else "basic")
        if kind != self._kind:
            PETSc.Options(self._snes.getOptionsPrefix())[KIND] = self._kind = kind
            self._snes.setFromOptions()
        self._snes.solve(None, self._x)
        if self._own:
            warn_of_unused(self._snes)
        reason = self._snes.getConvergedReason()
        return reason > 0, _REASONS.get(reason, str(reason))

    def free(self) -> None:
        destroy(self._snes)
        for item in (self._x, self._residual, self._matrix):
            item.destroy()


def verdict(norms: Sequence[float], goal: float, met: bool, options: SolveOptions) -> int:
    reasons, norm, numbers = PETSc.SNES.ConvergedReason, norms[-1], options.path
    if not np.isfinite(norm + goal):
        return SNES_REASONS["DIVERGED_FNORM_NAN"]
    if norm <= goal and met:
        return reasons.CONVERGED_FNORM_RELATIVE
    if len(norms) > options.max_iterations + 1:
        return reasons.DIVERGED_MAX_IT
    before, last = norms[: -numbers.patience], norms[-numbers.patience :]
    # Equilibria may lie beyond the target only.
    if before and max(min(last), goal) > (1 - numbers.rest) * max(min(before), goal):
        return reasons.DIVERGED_LOCAL_MIN
    return reasons.ITERATING


def rounding_of_forces(problem: Problem, size: float, stiffness: float) -> float:
    """Rounding error of the residual, for nodes that may have moved far; collective [N].

    A displacement is known to eps |u|/sqrt(12), at random; times a row of the tangent, whose
    Euclidean norm is a quarter of the sum of its entries or so, and over n dofs, the norm is some
    eps |u| |K| sqrt(n)/14. A fourfold of this is asked for, and no less than the rounding of the
    positions of nodes times the stiffness.

    Args:
        stiffness: Norm of the tangent, the largest sum of a row [N/mm].
    """
    far = global_max(problem.comm, float(np.abs(problem.u.x.array).max(initial=0.0)))
    dofmap = problem.space.dofmap
    count = dofmap.index_map.size_global * dofmap.index_map_bs
    return float(np.finfo(float).eps) * stiffness * (size + far * max(1.0, count**0.5 * 4 / 14))
