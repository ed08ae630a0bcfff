"""Newton's method on the whole problem: a predictor that carries the load, then PETSc SNES."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_norm
from ..base.timers import timer
from ..problem.problem import Problem
from .iteration import BACKTRACK, ENERGY, FULL, MAX_HALVINGS, Iteration, StepReport, Trace
from .linear import (
    LinearSolver,
    Options,
    destroy,
    interface_zone,
    is_iterative,
    linear_options,
    set_options,
    set_rigid_modes,
)
from .predictor import PREDICTOR_RTOL, Predictor
from .tangent import Tangent, lags_bulk

#: Relative tolerances of iterative linear solves in the iteration: loosest and tightest.
MAX_RTOL, MIN_RTOL = 1e-2, 1e-4

#: A backtracking line search on the residual norm, which carries the iteration over the kinks
#: where points change branch.
LINE_SEARCH = {
    "snes_linesearch_type": "bt",
    "snes_linesearch_order": 1,
    "snes_linesearch_max_it": MAX_HALVINGS,
}
#: The second attempt in a jump looks for the least energy along a correction, where its work falls
#: to zero. A bond whose overstress exceeds its softening makes the energy of a step convex: this
#: leads to its minimum, while the residual norm has a minimum of its own at many a kink.
LEAST_ENERGY = {
    "snes_linesearch_type": "cp",
    "snes_linesearch_order": 1,
    "snes_linesearch_max_it": 8,
    "snes_linesearch_rtol": 0.1,
    "snes_linesearch_atol": 0.0,  # or it calls a small F.Y convergence
}
#: Else the second attempt takes full steps.
FULL_STEPS = {"snes_linesearch_type": "basic"}

#: Displacements in sizes of the body beyond which a trial state is given up as it is. The secant of
#: a line search may lead anywhere, also to where products of numbers are no numbers any more.
MAX_DISPLACEMENT = 1e6

_REASONS = {
    value: name
    for name, value in vars(PETSc.SNES.ConvergedReason).items()
    if isinstance(value, int) and name.isupper()
}


def linear_tolerance(norms: list[float], goal: float) -> float:
    """Relative tolerance of the next linear solve, as exact as its correction can be.

    Choice 2 of Eisenstat and Walker (1996), .9 (|R_k| / |R_k-1|)^2 within bounds, and no more than
    the step still needs to end well below its goal (Kelley 1995).

    Args:
        norms: Residual norms of the step so far.
        goal: Residual norm at which the step has converged.
    """
    eta = PREDICTOR_RTOL if len(norms) < 2 else 0.9 * (norms[-1] / norms[-2]) ** 2
    needed = 0.3 * goal / norms[-1]
    return max(min(max(eta, MIN_RTOL), MAX_RTOL), min(needed, 0.1))


class Newton(Iteration):
    """Newton's method on a problem, with one matrix and one solver for all steps.

    Args:
        problem: The problem.
        relative_tolerance: Of the residual, see :class:`vmdg.solver.iteration.Criterion`.
        max_iterations: Corrections before an attempt is given up.
        petsc: Options of the solver, without prefix.
    """

    def __init__(
        self,
        problem: Problem,
        relative_tolerance: float,
        max_iterations: int,
        petsc: Options | None,
    ):
        super().__init__(problem, relative_tolerance, max_iterations)
        linear = linear_options(problem, petsc)
        self._tangent = Tangent(problem, lags_bulk(problem, linear.solver))
        matrix = self._tangent.matrix
        self._x, self._f = matrix.createVecs()
        self._owned = self._x.getLocalSize()
        self._prescribed = problem.loading.owned_prescribed
        self._searches = BACKTRACK

        iterative = linear.automatic and is_iterative(linear.solver)
        zone = interface_zone(problem) if iterative and problem.discretization.can_fail else None
        self.linear = LinearSolver(matrix, linear.solver, linear.fallback, zone)
        if self.linear.multigrid:
            parts = problem.discretization
            set_rigid_modes(parts.space, parts.geometry, matrix)
        own = {name: value for name, value in (petsc or {}).items() if name.startswith("snes_")}
        self._snes = {
            BACKTRACK: self._make_snes({**LINE_SEARCH, **own}),
            FULL: self._make_snes({**own, **FULL_STEPS}),
            ENERGY: self._make_snes({**own, **LEAST_ENERGY}),
        }
        ksp = self._snes[BACKTRACK].getKSP()
        self._predictor = Predictor(problem, self._tangent, ksp)
        self._begin_trace()

    def _begin_trace(self) -> None:
        self._trace = Trace(self.krylov)
        self._trials, self._tolerance, self._goal = 0, PREDICTOR_RTOL, np.nan

    def _make_snes(self, options: Options) -> PETSc.SNES:
        snes = PETSc.SNES().create(self._problem.comm)
        snes.setFunction(self._function, self._f)
        snes.setJacobian(self._jacobian, self._tangent.matrix)
        ksp = snes.getKSP()
        ksp.setType(PETSc.KSP.Type.PYTHON)
        ksp.setPythonContext(self.linear)
        ksp.getPC().setType(PETSc.PC.Type.NONE)
        snes.setTolerances(max_it=self._max_iterations)
        snes.setConvergenceTest(self._test)
        set_options(snes, options)
        return snes

    @property
    def krylov(self) -> int:
        """Krylov iterations of all steps so far; 0 where systems are solved directly."""
        return self.linear.iterations

    def _begin(self, start: float, end: float) -> list[NDArray[np.float64]]:
        self._path.start(start, self._problem.step.start.u)
        return self._path.ahead(end)

    def _attempt(self, search: str, ahead: list[NDArray[np.float64]], predictor: str) -> StepReport:
        snes = self._snes[search]
        self._searches = search
        self._begin_trace()
        with timer("predictor"):
            imbalance, loads = self._predictor(predictor, ahead, self._dt)
        self._criterion.update(imbalance, loads)
        self._x.array[:] = self._problem.u.x.array[: self._owned]
        snes.solve(None, self._x)
        reason = snes.getConvergedReason()
        reaction = self._reaction()
        if reason > 0 and np.isfinite(reaction):
            self._criterion.update(reaction=reaction)
        return self._trace.report(reason > 0, _REASONS.get(reason, str(reason)), self._goal)

    def _reaction(self) -> float:
        """Norm of the reactions of the last assembly [N]."""
        forces = self._problem.discretization.forces.x.array[: self._owned][self._prescribed]
        return global_norm(self._problem.comm, forces)

    def _function(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        self._trials += 1
        if x.norm(PETSc.NormType.NORM_INFINITY) > MAX_DISPLACEMENT * self._size:
            f.set(np.nan)
            return
        u = self._problem.u.x
        u.array[: self._owned] = x.array_r
        u.scatter_forward()
        self._problem.step.assemble_residual(self._dt)
        f.array[:] = self._problem.discretization.forces.x.array[: self._owned]
        f.array[self._prescribed] = 0

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self._tangent.assemble()
        self._tangent.constrain()

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        residual = norms[2]
        trials = self._trials if iteration else 0
        self._trace.note(residual, trials, self.krylov, self._tolerance)
        self._trials = 0
        if not np.isfinite(residual):
            return PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN
        self._criterion.floor = self._rounding(self._tangent.norm)
        self._goal = goal = self._criterion.goal(self._reaction())
        if residual <= goal:
            return PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE
        if failure := self._diverged(self._searches, self._trace.norms, trials):
            return getattr(PETSc.SNES.ConvergedReason, failure)
        self._tolerance = linear_tolerance(self._trace.norms, goal)
        snes.getKSP().setTolerances(rtol=self._tolerance)
        return PETSc.SNES.ConvergedReason.ITERATING

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.linear.free()
        self._predictor.destroy()
        self._tangent.destroy()
        for snes in self._snes.values():
            destroy(snes)
        for item in (self._x, self._f):
            item.destroy()
