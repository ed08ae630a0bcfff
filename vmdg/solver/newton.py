"""Newton's method for a load step: PETSc SNES on displacement and load factor.

The unknowns are (u, lambda), lambda the load factor t. With R(u, lambda) = 0 of (46) one more
equation says how far the step goes, see :mod:`vmdg.solver.control`. Block elimination: with the
tangent K and f_lambda = -dR/dlambda two systems with the same matrix,

    K.du_0 = -R,    K.du_1 = f_lambda,

give the correction du = du_0 + dlambda du_1, which keeps the linearised R zero for every dlambda.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_norm
from ..base.timers import timer
from ..domain.topology import box_sides
from ..problem.problem import Problem
from .control import Control, Direction
from .criterion import Criterion
from .linear import destroy, set_options
from .options import Petsc
from .report import StepReport, Trace
from .system import System

Array = NDArray[np.float64]

#: Relative tolerances of iterative linear solves: loosest, tightest, and that of the first one.
MAX_RTOL, MIN_RTOL, FIRST_RTOL = 1e-4, 1e-6, 1e-6

#: A backtracking line search on the residual norm, which carries the iteration over the kinks
#: where points change branch.
LINE_SEARCH = {
    "snes_linesearch_type": "basic",
    "snes_linesearch_order": 1,
    "snes_linesearch_max_it": 8,
}

#: Displacements in sizes of the body beyond which a trial state is given up as it is.
MAX_DISPLACEMENT = 1e6

#: An attempt is given up if two corrections leave more than this share of the residual.
STALLED = 0.98

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
    if not norms:
        return FIRST_RTOL
    eta = FIRST_RTOL if len(norms) < 2 else 0.9 * (norms[-1] / norms[-2]) ** 2
    needed = 0.3 * goal / norms[-1]
    return max(min(max(eta, MIN_RTOL), MAX_RTOL), min(needed, 0.1))


class Newton:
    """Newton's method on a problem, with one matrix and one solver for all steps.

    Args:
        problem: The problem.
        relative_tolerance: Of the residual, see :class:`vmdg.solver.criterion.Criterion`.
        max_iterations: Corrections before an attempt is given up.
        petsc: Options of the solver, without prefix.

    Attributes:
        discretization: What it was made for.
        owned: Number of component-wise dofs of this rank.
        residual: Of the last assembly, zero on prescribed dofs [N].
    """

    def __init__(
        self,
        problem: Problem,
        relative_tolerance: float,
        max_iterations: int,
        petsc: Petsc | None,
    ):
        self.discretization = problem.discretization
        self._problem = problem
        self._comm = problem.comm
        self._criterion = Criterion(relative_tolerance, problem.step)
        self._size = float(np.linalg.norm(box_sides(problem.mesh)))
        self.owned = problem.discretization.owned
        self._prescribed = problem.loading.owned_prescribed
        self._system = System(problem, petsc)
        local = self.owned + (problem.comm.rank == 0)
        self._x = PETSc.Vec().createMPI((local, None), comm=problem.comm)
        self.residual = self._x.duplicate()
        sizes = ((local, None), (local, None))
        self._matrix = PETSc.Mat().createPython(sizes, _Bordered(self), comm=problem.comm)
        self._matrix.setUp()
        own = {name: value for name, value in (petsc or {}).items() if name.startswith("snes_")}
        self._snes = self._make_snes({**LINE_SEARCH, **own}, max_iterations)
        self._control, self._dt = Control(0.0), 1.0
        self._trace, self._goal = Trace(0), np.nan
        self._trials, self._tolerance = 0, FIRST_RTOL

    def _make_snes(self, options: Petsc, max_iterations: int) -> PETSc.SNES:
        snes = PETSc.SNES().create(self._comm)
        snes.setFunction(self._function, self.residual)
        snes.setJacobian(lambda *_: None, self._matrix)
        ksp = snes.getKSP()
        ksp.setType(PETSc.KSP.Type.PYTHON)
        ksp.setPythonContext(_Bordered(self))
        ksp.getPC().setType(PETSc.PC.Type.NONE)
        snes.setTolerances(max_it=20 * max_iterations)
        self._max = max_iterations
        snes.setConvergenceTest(self._test)
        set_options(snes, options)
        return snes

    @property
    def krylov(self) -> int:
        """Krylov iterations of all steps so far; 0 where systems are solved directly."""
        return self._system.iterations

    def solve(self, control: Control, dt: float, ahead: Direction | None = None) -> StepReport:
        """Find the equilibrium that a control asks for; collective.

        Args:
            control: How far to go from the present state.
            dt: Time step of the return maps [s].
            ahead: Increment of the last step, if the path goes on as it was; None predicts with
                the tangent of the present state.
        """
        problem, krylov = self._problem, self.krylov
        self._control, self._dt = control, dt
        self._trace, self._trials, scales = Trace(self.krylov), 0, problem.step.scales
        self._tolerance = FIRST_RTOL
        self._since = 0
        with timer("predictor"):
            self._predict(ahead)
        self._backtracks = control.loaded
        database = PETSc.Options(self._snes.getOptionsPrefix())
        database["snes_linesearch_type"] = "bt" if control.loaded else "basic"
        self._snes.setFromOptions()
        self._x.array[: self.owned] = problem.u.x.array[: self.owned]
        self._x.array[self.owned :] = problem.t
        self._snes.solve(None, self._x)
        reason, reaction = self._snes.getConvergedReason(), self._reaction()
        converged = reason > 0 and bool(np.isfinite(reaction))
        if converged:
            self._criterion.update(reaction=reaction)
        else:
            # The forces of a state that is given up say nothing about the run.
            problem.step.scales = scales
        name = _REASONS.get(reason, str(reason))
        norms, solves = self._trace.norms, self._trace.solves
        return StepReport(converged, norms, name, solves, self._goal, self.krylov - krylov)

    def _predict(self, ahead: Direction | None) -> None:
        """Go on as in the last step, or along the tangent of the present state."""
        if ahead is not None and self._control.extrapolate(self, ahead):
            return
        self._problem.step.assemble_residual(self._dt, hold=True)
        free = self._free_forces()
        self._criterion.update(global_norm(self._comm, free))
        self.go(self.place(), self._balance(-free, FIRST_RTOL), 1.0)

    # Trial states

    def place(self) -> Direction:
        """Displacement and load factor now."""
        return Direction(self._problem.u.x.array[: self.owned].copy(), self._problem.t)

    def go(self, start: Direction, direction: Direction, length: float) -> None:
        """Change displacement and load factor."""
        u, loading = self._problem.u.x, self._problem.loading
        u.array[: self.owned] = start.u + length * direction.u
        u.scatter_forward()
        if direction.t != 0:
            loading.move(self._control.snapped(start.t + length * direction.t))

    def size(self, direction: Direction) -> float:
        return global_norm(self._comm, direction.u)

    def bond_work(self, start: Direction, direction: Direction, length: float) -> float:
        """Work on bonds in the step if it ended there; the state is moved there [N mm]."""
        self.go(start, direction, length)
        return self._problem.step.bond_work(self._dt)

    def _reaction(self) -> float:
        """Norm of the reactions of the last assembly [N]."""
        forces = self._problem.discretization.forces.x.array[: self.owned][self._prescribed]
        return global_norm(self._comm, forces)

    def _free_forces(self) -> Array:
        """Residual of the last assembly on owned dofs, zero on prescribed ones [N]."""
        forces = self._problem.discretization.forces.x.array[: self.owned].copy()
        forces[self._prescribed] = 0
        return forces

    # Called by PETSc

    def _function(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        self._trials += 1
        if x.norm(PETSc.NormType.NORM_INFINITY) > MAX_DISPLACEMENT * self._size:
            f.set(np.nan)
            return
        problem = self._problem
        u, t = problem.u.x, self._comm.bcast(x.array_r[-1] if self._comm.rank == 0 else None)
        if problem.loading.ray is not None:
            problem.loading.move(self._control.snapped(t))
        u.array[: self.owned] = x.array_r[: self.owned]
        u.scatter_forward()
        problem.step.assemble_residual(self._dt)
        f.set(0.0)
        f.array[: self.owned] = self._free_forces()

    def correct(self, right: Array) -> Direction:
        """Correction that takes the residual ``right`` away and meets the control; collective."""
        return self._balance(-right, self._tolerance)

    def _balance(self, forces: Array, rtol: float) -> Direction:
        """du and dlambda that balance forces and meet the control."""
        problem, control = self._problem, self._control
        loading, owned = problem.loading, self.owned
        t, prescribed = problem.t, loading.prescribed
        # What prescribed displacements are still away from the load factor, and their rate.
        away, rate = np.zeros_like(problem.u.x.array), np.zeros_like(problem.u.x.array)
        away[prescribed] = loading.prescribed_values(t) - problem.u.x.array[prescribed]
        ray = loading.ray
        if ray is not None:
            rate[prescribed] = ray.rate(ray.prescribed)
        balance = self._system.assemble([away[:owned], rate[:owned]])
        du = balance(forces, 0, rtol)
        start, zero = self.place(), Direction(du, 0.0)
        if ray is None or control.loaded and t == control.target:
            return zero
        loads = problem.step.load_rate()
        direction = Direction(balance(loads, 1, rtol), 1.0)
        dt = control.change(self, start, zero, direction)
        self.go(start, zero, 0.0)
        loading.move(start.t)
        return Direction(du + dt * direction.u, dt)

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        reasons, residual = PETSc.SNES.ConvergedReason, norms[2]
        trials = self._trials if iteration else 0
        self._trace.note(residual, trials, self.krylov, self._tolerance)
        self._trials = 0
        if not np.isfinite(residual):
            return reasons.DIVERGED_FNORM_NAN
        self._criterion.floor = float(np.finfo(float).eps) * self._size * self._system.norm
        self._goal = goal = self._criterion.goal(self._reaction())
        if residual <= goal:
            self._since = 0
            if self._control.met(self._problem.t, self._problem.step.bond_work()):
                return reasons.CONVERGED_FNORM_RELATIVE
        self._since += 1
        if self._since > self._max + 1:
            return reasons.DIVERGED_MAX_IT
        if getattr(self._control, "failed", False):
            return reasons.DIVERGED_DTOL
        norms = self._trace.norms
        if len(norms) > 4 and (
            abs(norms[-1] / norms[-3] - 1) < 1e-3
            or self._backtracks and norms[-1] > STALLED * norms[-3]
        ):
            return reasons.DIVERGED_LOCAL_MIN
        self._tolerance = linear_tolerance(norms, goal)
        return reasons.ITERATING

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self._system.free()
        destroy(self._snes)
        for item in (self._x, self.residual, self._matrix):
            item.destroy()


class _Bordered:
    """What PETSc asks of the matrix and the linear solver of (u, lambda)."""

    def __init__(self, newton: Newton):
        self._newton = newton

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """J.x = b by block elimination; PETSc subtracts x."""
        owned = self._newton.owned
        du, dt = self._newton.correct(b.array_r[:owned].copy())
        x.array[:owned] = -du
        x.array[owned:] = -dt
        ksp.setConvergedReason(PETSc.KSP.ConvergedReason.CONVERGED_ITS)

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """J.x; a line search asks for it for the correction, of which it is the residual."""
        self._newton.residual.copy(y)
