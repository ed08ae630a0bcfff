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

from ..base.parallel import global_any, global_max, global_norm, global_sum
from ..compat import SNES_REASONS
from ..linear.ksp import destroy, set_options, warn_of_unused
from ..problem.problem import Problem
from .options import SolveOptions

Array = NDArray[np.float64]

#: PETSc's own line search. By default it makes the correction, which has been shortened before.
SEARCH = "snes_linesearch_type"

#: Work of the residual along a correction at its end, relative to that at its start, that ends a
#: search.
SLACK = 0.5

_REASONS = {value: name for name, value in SNES_REASONS.items()}


class Equations(Protocol):
    """R(x) = 0 with the tangent J, over the unknowns of this rank; all methods are collective."""

    def residual(self, x: Array) -> Array:
        """R at a state."""

    def correction(self, residual: Array) -> Array:
        """J^-1.R, which is subtracted from the state of the last residual."""

    def longest(self, start: Array, way: Array) -> tuple[float, bool]:
        """Which part of a correction from a state may be made, and whether to search on it."""

    def test(self, norm: float) -> int:
        """PETSc's reason to end the iteration at a norm of R, or to continue it."""


class _Linear:
    """The context of PETSc for the linear solver."""

    def __init__(self, equations: Equations):
        self._equations = equations

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        x.array[:] = self._equations.correction(b.array_r)
        ksp.setConvergedReason(PETSc.KSP.ConvergedReason.CONVERGED_ITS)


class Snes:
    """One SNES for the equations of all steps."""

    def __init__(self, comm: MPI.Comm, local: int, options: SolveOptions):
        self._x = PETSc.Vec().createMPI((local, None), comm=comm)
        self._residual = self._x.duplicate()
        # PETSc asks for a matrix of this size, which nothing uses.
        sizes = ((local, None), (local, None))
        self._matrix = PETSc.Mat().createConstantDiagonal(sizes, 1.0, comm=comm)
        self._snes = PETSc.SNES().create(comm)
        self._snes.getKSP().setType(PETSc.KSP.Type.PYTHON)
        self._snes.getKSP().getPC().setType(PETSc.PC.Type.NONE)
        self._own = {k: v for k, v in (options.petsc or {}).items() if k.startswith("snes_")}
        self._comm, self._most = comm, options.path.halvings
        set_options(self._snes, {SEARCH: "basic", "snes_stol": 0.0} | self._own)

    def solve(self, equations: Equations, start: Array) -> tuple[bool, str]:
        """Solve from a state on; collective.

        Returns:
            Whether it has converged, and PETSc's reason.
        """

        last: list[Array] = []  # The last state and its residual

        def at(x: Array) -> Array:
            if global_any(self._comm, not last or not np.array_equal(x, last[0])):
                finite = np.isfinite(global_norm(self._comm, x))
                last[:] = x.copy(), equations.residual(x) if finite else np.full_like(x, np.nan)
            return last[1]

        def residual(_: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
            f.array[:] = at(x.array_r)

        def shorten(x: PETSc.Vec, y: PETSc.Vec) -> bool:
            start, way = x.array_r.copy(), -y.array_r
            length, searches = equations.longest(start, way)
            searches &= SEARCH not in self._own
            if searches and np.isfinite(global_norm(self._comm, way)):
                length = self._searched(at, start, length * way) * length
            y.scale(length)
            return length < 1.0

        self._x.array[:] = start
        linear = _Linear(equations)
        self._snes.setFunction(residual, self._residual)
        self._snes.setJacobian(lambda *_: None, self._matrix)
        self._snes.setConvergenceTest(lambda _, __, norms: equations.test(norms[2]))
        self._snes.setLineSearchPreCheck(shorten)
        self._snes.getKSP().setPythonContext(linear)
        self._snes.solve(None, self._x)
        if self._own:
            warn_of_unused(self._snes)
        reason = self._snes.getConvergedReason()
        return reason > 0, _REASONS.get(reason, str(reason))

    def _searched(self, residual: Callable[[Array], Array], start: Array, way: Array) -> float:
        """Length at which the work R.du of the residual along a correction has about vanished.

        At a constant load it is the derivative of the energy. Where several bonds soften the
        tangent is almost singular, and the whole correction would break them and others: which of
        them do break is found by residuals alone, before the next tangent.

        Sources: Matthies and Strang 1979; Crisfield 1983.
        """

        def work(length: float) -> float:
            return float(global_sum(self._comm, residual(start + length * way) @ way))

        first, low, high, length = work(0.0), 0.0, 1.0, 1.0
        below, above = first, work(length)
        if np.isfinite(above) and (first >= 0 or above <= SLACK * -first):
            return length
        for i in range(self._most):
            # By the secant and by halves, in turn; by halves from where nothing is finite.
            share = 0.5 if i % 2 or not np.isfinite(above) else below / (below - above)
            length = low + share * (high - low)
            found = work(length)
            if np.isfinite(found) and (first >= 0 or abs(found) <= SLACK * -first):
                break
            if found < 0:
                low, below = length, found
            else:
                high, above = length, found
        return length

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
