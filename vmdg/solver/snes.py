"""PETSc SNES for equations that solve their own linear systems, and when its iteration ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from ..base.parallel import global_max
from ..compat import SNES_REASONS, UNBOUNDED_SEARCH
from ..linear.ksp import destroy, set_options, warn_of_unused
from ..problem.problem import Problem
from .options import SolveOptions

#: The line search: backtracking by halves, or full steps.
KIND = "snes_linesearch_type"

_REASONS = {value: name for name, value in SNES_REASONS.items()}


class Equations(Protocol):
    """Callbacks of PETSc for residual, linear solver, matrix and convergence test."""

    def residual(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None: ...

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None: ...

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None: ...

    def test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int: ...


class Snes:
    """One SNES for the equations of all steps.

    Args:
        comm: Communicator.
        local: Number of unknowns of this rank.
        options: Options of the solver.

    Attributes:
        x: The unknowns.
        snes: PETSc's object.
    """

    def __init__(self, comm: MPI.Comm, local: int, options: SolveOptions):
        self.x = PETSc.Vec().createMPI((local, None), comm=comm)
        self._residual = self.x.duplicate()
        self._matrix = PETSc.Mat().create(comm)
        self._matrix.setSizes(((local, None), (local, None)))
        self._matrix.setType(PETSc.Mat.Type.PYTHON)
        self.snes = PETSc.SNES().create(comm)
        self.snes.getKSP().setType(PETSc.KSP.Type.PYTHON)
        self.snes.getKSP().getPC().setType(PETSc.PC.Type.NONE)
        self._own = {k: v for k, v in (options.petsc or {}).items() if k.startswith("snes_")}
        self._kind = ""  # of the line search so far
        # By halves, independently of the norm of the correction.
        least = float(np.finfo(float).tiny)
        halves = {"order": 1, "max_it": options.path.halvings, "minlambda": least}
        halves |= UNBOUNDED_SEARCH
        search = {f"snes_linesearch_{name}": value for name, value in halves.items()}
        set_options(self.snes, search | {"snes_stol": 0.0} | self._own)

    def solve(self, equations: Equations, searches: bool) -> tuple[bool, str]:
        """Solve from :attr:`x` on; collective.

        Args:
            equations: Callbacks.
            searches: Whether corrections are halved that do not reduce the residual.

        Returns:
            Whether it has converged, and PETSc's reason.
        """
        self.snes.setFunction(equations.residual, self._residual)
        self.snes.setJacobian(lambda *_: None, self._matrix)
        self.snes.setConvergenceTest(equations.test)
        self.snes.getKSP().setPythonContext(equations)
        self._matrix.setPythonContext(equations)
        self._matrix.setUp()
        kind = self._own.get(KIND, "bt" if searches else "basic")
        if kind != self._kind:
            PETSc.Options(self.snes.getOptionsPrefix())[KIND] = self._kind = kind
            self.snes.setFromOptions()
        self.snes.solve(None, self.x)
        if self._own:
            warn_of_unused(self.snes)
        reason = self.snes.getConvergedReason()
        return reason > 0, _REASONS.get(reason, str(reason))

    def free(self) -> None:
        """Free the PETSc objects; collective."""
        destroy(self.snes)
        for item in (self.x, self._residual, self._matrix):
            item.destroy()


def verdict(norms: Sequence[float], goal: float, met: bool, options: SolveOptions) -> int:
    """PETSc's reason to end an iteration, or to continue it.

    Args:
        norms: Norms of the residual so far [N].
        goal: Norm at which it has converged [N].
        met: Whether the other conditions hold.
        options: Options of the solver.
    """
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
    """Rounding error of nodal positions, for nodes that may have moved far, times stiffness;
    collective [N].

    Args:
        problem: The problem.
        size: Of the body [mm].
        stiffness: Norm of the tangent [N/mm].
    """
    far = global_max(problem.comm, float(np.abs(problem.u.x.array).max(initial=0.0)))
    return float(np.finfo(float).eps) * (size + far) * stiffness
