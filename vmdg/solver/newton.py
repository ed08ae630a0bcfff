"""Newton's method for a load step: PETSc SNES on displacement and load factor.

The unknowns are (u, lambda), lambda the load factor t. Beside R(u, lambda) = 0 of (46) a control
says how far the step goes, see :mod:`vmdg.solver.control`. Block elimination: with the tangent K
and the loads f_lambda = -dR/dlambda of a unit of lambda, two systems with the same matrix,

    K.du_0 = -R,    K.du_1 = f_lambda,

give the correction du = du_0 + dlambda du_1, which takes the linearised R away for every dlambda.
"""

from __future__ import annotations

from copy import copy

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_max, global_norm, global_sum
from ..base.timers import timer
from ..compat import SNES_REASONS
from ..domain.topology import box_sides
from ..linear.capacitance import solve_contact
from ..linear.condensation import closes_points
from ..linear.ksp import MAX_RTOL, destroy, linear_tolerance, set_options, warn_of_unused
from ..linear.system import make_system
from ..problem.problem import Problem
from ..problem.states import RunScales
from .control import Control, Direction
from .options import SolveOptions
from .report import StepReport
from .turn import turn

Array = NDArray[np.float64]

#: Residual relative to the largest reaction or load so far that is never small enough.
MAX_RESIDUAL = 1e-6

#: The kind of line search is chosen in every step; backtracking halves a correction, and gives up.
KIND = "snes_linesearch_type"
LINE_SEARCH = {"snes_linesearch_order": 1, "snes_linesearch_max_it": 8}

#: Displacements in sizes of the body, and residual relative to the largest force, beyond which an
#: iteration is given up.
MAX_DISPLACEMENT, DIVERGED = 1e6, 1e4

#: Least overstress that a step of a jump may try, and the increment of its derivative, in multiples
#: of H; drag on bodies that move, relative to the norm of K and to the overstress, and that which
#: holds a piece that nothing else does.
MIN_DRAG, DRAG_INCREMENT, DRAG, HELD = -0.5, 1e-6, 1e-3, 1e-7

#: An attempt by backtracking is given up if a correction leaves so much more of the residual than
#: there was, or so many of them more than this share (points may go from stick to slip one by one),
#: one by full steps if these go round in circles.
MORE, PATIENCE, STALLED, CYCLE, LENGTHS = 2.0, 4, 0.98, 1e-3, (2, 3, 4)

_REASONS = {value: name for name, value in SNES_REASONS.items()}


def residual_goal(scales: RunScales, tolerance: float, floor: float) -> float:
    """Norm of the residual on the free dofs at which a step has converged [N].

    It is small against the largest force the run has seen (reactions, loads, or the imbalance a
    step starts with), a scale that stays when the body has come apart. The imbalance of a step that
    carries a weak bond far beyond its strength may be larger by orders of magnitude than any force
    it can bear, so that the residual must also be small against forces that were there.

    Args:
        scales: Largest forces of the run.
        tolerance: Relative to the largest force.
        floor: Rounding of the internal forces, below which no residual can come [N].
    """
    return max(min(tolerance * scales.force, MAX_RESIDUAL * scales.reaction), floor)


class Newton:
    """Newton's method on a problem, with one matrix and one solver for all steps.

    Args:
        problem: The problem.
        options: Tolerance, corrections before an attempt is given up, and what chooses the linear
            systems.

    Attributes:
        discretization: What it was made for.
        owned: Number of component-wise dofs of this rank.
        residual: Of the last assembly, without what supports and rigid faces take, and a zero for
            lambda [N].
    """

    def __init__(self, problem: Problem, options: SolveOptions):
        self.discretization = problem.discretization
        self.owned = problem.discretization.owned
        self._problem = problem
        self._comm = problem.comm
        self._relative_tolerance, self._floor = options.relative_tolerance, 0.0
        self._max_iterations = options.max_iterations
        self._size = float(np.linalg.norm(box_sides(problem.mesh)))
        self._system = make_system(problem, options.condensed, options.petsc)
        self._closes = closes_points(problem, options.condensed, options.petsc)
        # lambda is the last unknown of the first rank.
        local = self.owned + (problem.comm.rank == 0)
        self._x = PETSc.Vec().createMPI((local, None), comm=problem.comm)
        self.residual = self._x.duplicate()
        bordered, sizes = _Bordered(self), ((local, None), (local, None))
        self._matrix = PETSc.Mat().createPython(sizes, bordered, comm=problem.comm)
        self._matrix.setUp()
        self._snes = snes = PETSc.SNES().create(problem.comm)
        snes.setFunction(self._function, self.residual)
        snes.setJacobian(lambda *_: None, self._matrix)
        snes.getKSP().setType(PETSc.KSP.Type.PYTHON)
        snes.getKSP().setPythonContext(bordered)
        snes.getKSP().getPC().setType(PETSc.PC.Type.NONE)
        snes.setConvergenceTest(self._test)
        self._own = {k: v for k, v in (options.petsc or {}).items() if k.startswith("snes_")}
        set_options(snes, LINE_SEARCH | self._own)

    @property
    def rounding(self) -> float:
        """Of the energy that bodies store, by that of their forces in the last step [N mm]."""
        return self._floor * self._size

    def solve(self, control: Control, dt: float, ahead: Direction | None = None) -> StepReport:
        """Find the equilibrium that a control asks for; collective.

        Args:
            control: How far to go from the present state.
            dt: Time step of the return maps [s].
            ahead: Change in the last step, where the path goes on as it was; None begins with the
                tangent of the present state.
        """
        problem, krylov, scales = self._problem, self._system.iterations, self._problem.step.scales
        self._control, self._dt, self._norms = control, dt, []
        self._goal, self._tolerance, self._unstable = np.nan, MAX_RTOL, False
        self._at_rest, self._system.lags = problem.step.start.u, False
        self._system.drag = DRAG * problem.step.drag if control.moves else HELD * scales.held
        with timer("predictor"):
            self._predict(ahead)
        # Backtracking on the residual norm carries the iteration over kinks where points change
        # branch. Where the work on bonds is given full steps do better.
        self._backtracks = self._control.loaded
        kind = self._own.get(KIND, "bt" if self._backtracks else "basic")
        PETSc.Options(self._snes.getOptionsPrefix())[KIND] = kind
        self._snes.setFromOptions()
        self._x.array[: self.owned] = problem.u.x.array[: self.owned]
        self._x.array[self.owned :] = self._parameter()
        norms, last = [], np.inf
        while True:
            self._snes.solve(None, self._x)
            if self._own:
                warn_of_unused(self._snes)
            reason = self._snes.getConvergedReason()
            pull = global_norm(self._comm, problem.loading.balance(self._pull()))
            if reason <= 0 or control.moves or not self._goal < pull <= last / 2:
                break
            # What holds a piece is to bear nothing else: again, from here (Rockafellar 1976).
            norms, self._norms, last = norms + self._norms[:-1], [], pull
            self._at_rest = problem.u.x.array.copy()
        norms += self._norms
        if reason > 0 and not control.moves:
            norms[-1] = max(norms[-1], pull)
            if pull > max(MAX_RESIDUAL * scales.reaction, self._goal):
                reason = PETSc.SNES.ConvergedReason.DIVERGED_LOCAL_MIN
        if reason > 0:
            problem.step.scales = problem.step.scales.with_forces(reaction=self._reaction())
        else:
            # The forces of a state that is given up say nothing about the run.
            problem.step.scales = scales
        return StepReport(
            reason > 0,
            norms,
            _REASONS.get(reason, str(reason)),
            self._goal,
            self._system.iterations - krylov,
            onset=self._control.onset is not None,
            arc=self._control.arc,
            gradient=self._control.gradient,
            unstable=self._unstable,
        )

    def _predict(self, ahead: Direction | None) -> None:
        """Turn with the supports, go on as in the last step, or along the tangent of the state."""
        if self._problem.loading.ray is None and turn(self._problem):
            self._problem.step.assemble_residual(self._dt)
            self.go(self.place(), self.correct(-self._free_forces()), 1.0)
            return
        goes_on = ahead is not None and self._control.extrapolate(self, ahead)
        if goes_on or self._control.brakes:
            # In a jump what has held the bonds so far is gone: they move by themselves.
            return
        step, start, control = self._problem.step, self.place(), copy(self._control)
        step.hold(self._dt, sliding=ahead is None or control.target == start.t)
        free = self._free_forces()
        step.scales = step.scales.with_forces(global_norm(self._comm, free))
        self.go(start, self.correct(-free), 1.0)
        if step.close(self._dt):
            self._control = control
            self.go(start, self.correct(-self._free_forces(), close=self._closes), 1.0)

    # Trial states, see vmdg.solver.control.Trials

    def place(self) -> Direction:
        """Displacement and load factor now."""
        return Direction(self._problem.u.x.array[: self.owned].copy(), self._parameter())

    def _parameter(self) -> float:
        """The load factor, or what takes its place."""
        return self._problem.step.drag if self._control.brakes else self._problem.t

    def _set_parameter(self, value: float) -> None:
        """Change the load factor, where a ray moves it, or what takes its place."""
        if self._control.brakes:
            self._problem.step.slow_down(max(value, MIN_DRAG))
        elif self._problem.loading.ray is not None:
            self._problem.loading.move(self._control.snapped(value))

    def go(self, start: Direction, direction: Direction, length: float) -> None:
        """Change displacement and load factor."""
        u, loading = self._problem.u.x, self._problem.loading
        u.array[: self.owned] = start.u + length * direction.u
        u.scatter_forward()
        self._set_parameter(start.t + length * direction.t)
        if loading.ray is None:
            # Not along a line: as prescribed at the end.
            u.array[loading.prescribed] = loading.prescribed_values(self._problem.t)

    def bond_work(self, start: Direction, way: Direction | None, length: float) -> float:
        """Work on bonds if the step ended there, where the state is moved; None: here [N mm]."""
        if way is not None:
            self.go(start, way, length)
        return self._problem.step.bond_work(None if way is None else self._dt)

    def size(self, direction: Direction) -> float:
        """Norm of the displacement [mm]."""
        return global_norm(self._comm, direction.u)

    def product(self, one: Direction, other: Direction) -> float:
        """Inner product of two displacements [mm^2]."""
        return float(global_sum(self._comm, one.u @ other.u))

    def correct(self, forces: Array, close: bool = False) -> Direction:
        """Correction that takes a residual of -forces away and follows the control; collective.

        Where the load factor is given, bodies may be taken as linear, with points that close.
        """
        problem, control = self._problem, self._control
        loading, start = problem.loading, self.place()
        away = loading.away(problem.t)
        if loading.ray is None and not control.brakes:
            return Direction(self._solve([forces], [away], close)[0], 0.0)
        load, rate = self._rates()
        if control.loaded:
            dt = control.target - start.t
            return Direction(self._solve([forces + dt * load], [away + dt * rate], close)[0], dt)
        found = self._solve([forces, load], [away, rate])
        zero, one = Direction(found[0], 0.0), Direction(found[1], 1.0)
        if not np.isfinite(self.size(zero) + self.size(one)):
            return Direction(np.full_like(zero.u, np.nan), 0.0)
        dt = control.change(self, start, zero, one)
        self.go(start, zero, 0.0)
        return Direction(zero.u + dt * one.u, dt)

    def _solve(self, forces: list[Array], moved: list[Array], close: bool = False) -> list[Array]:
        if close:
            return [solve_contact(self._problem, self._system, forces[0], moved[0], self._dt)]
        found = self._system.solve(forces, moved, self._tolerance)
        self._unstable = self._system.unstable
        return list(found)

    def _rates(self) -> tuple[Array, Array]:
        """Change of forces [N] and prescribed displacements [mm] with the parameter."""
        step, residuals = self._problem.step, []
        if not self._control.brakes:
            return step.load_rate(), self._problem.loading.rate()
        for drag in (step.drag + DRAG_INCREMENT, step.drag):
            step.slow_down(drag)
            step.assemble_residual(self._dt)
            residuals.append(self._free_forces())
        return (residuals[1] - residuals[0]) / DRAG_INCREMENT, np.zeros(self.owned)

    def _reaction(self) -> float:
        """Norm of reactions, those of springs among them, and of forces on means [N]."""
        parts, loading = self._problem.discretization, self._problem.loading
        forces = parts.forces.x.array[: self.owned]
        held = forces - loading.balance(forces.copy())
        if parts.means is not None:
            dofs = parts.means.owned_dofs
            held[dofs] = forces[dofs] + loading.vector[dofs]
        return global_norm(self._comm, np.append(held, parts.surface.spring_forces()))

    def _free_forces(self) -> Array:
        """Residual on owned dofs, without what supports and rigid faces take [N]."""
        forces = self._problem.discretization.forces.x.array[: self.owned].copy()
        return self._problem.loading.balance(forces + self._pull())

    def _pull(self) -> Array:
        """Forces of the drag on owned dofs [N]."""
        moved = (self._problem.u.x.array - self._at_rest)[: self.owned]
        return self._system.drag * self._system.norm * moved

    # Called by PETSc

    def _function(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        if not x.norm(PETSc.NormType.NORM_INFINITY) <= MAX_DISPLACEMENT * self._size:
            f.set(np.nan)
            return
        problem, u = self._problem, self._problem.u.x
        self._set_parameter(self._comm.bcast(float(x.array_r[-1]) if not self._comm.rank else None))
        u.array[: self.owned] = x.array_r[: self.owned]
        u.scatter_forward()
        problem.step.assemble_residual(self._dt)
        f.set(0.0)
        f.array[: self.owned] = self._free_forces()

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        reasons, residual, reaction = PETSc.SNES.ConvergedReason, norms[2], self._reaction()
        self._norms.append(residual)
        most = DIVERGED * max(self._norms[0], self._problem.step.scales.force)
        if not np.isfinite(residual + reaction) or residual > most:
            return SNES_REASONS["DIVERGED_FNORM_NAN"]
        # Differences of positions x + u, of nodes that may have gone far, times stiffness.
        far = global_max(self._comm, float(np.abs(self._problem.u.x.array).max(initial=0.0)))
        self._floor = float(np.finfo(float).eps) * (self._size + far) * self._system.norm
        control, step = self._control, self._problem.step
        scales = step.scales.with_forces(reaction=reaction)
        self._goal = goal = residual_goal(scales, self._relative_tolerance, self._floor)
        # At an equilibrium, which may be one on the way.
        if residual <= goal and control.met(self._parameter(), step.bond_work()):
            return reasons.CONVERGED_FNORM_RELATIVE
        if len(self._norms) > self._max_iterations + 1:
            return reasons.DIVERGED_MAX_IT
        if self._stalled():
            return reasons.DIVERGED_LOCAL_MIN
        self._tolerance = linear_tolerance(self._norms, goal)
        # By quadratic convergence a tangent leaves twice the share it has left; surely 20 times.
        self._system.lags = goal < residual and 20 * residual**2 <= goal * self._norms[-2:][0]
        return reasons.ITERATING

    def _stalled(self) -> bool:
        """Whether the last corrections lead nowhere."""
        norms, patient = self._norms, len(self._norms) <= PATIENCE
        # At an equilibrium on the way residuals are rounding, alike or not.
        if norms[-1] <= self._goal:
            return False
        if not self._backtracks:
            circles = (abs(norms[-1] - norms[-1 - n]) < CYCLE * norms[-1] for n in LENGTHS)
            return not patient and any(circles)
        # The first correction comes from a first guess that may be far off.
        grows = len(norms) > 2 and norms[-1] > MORE * norms[-2]
        return grows or (not patient and norms[-1] > STALLED * norms[-1 - PATIENCE])

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self._system.free()
        destroy(self._snes)
        for item in (self._x, self.residual, self._matrix):
            item.destroy()


class _Bordered:
    """What PETSc asks of the matrix and of the linear solver of (u, lambda)."""

    def __init__(self, newton: Newton):
        self._newton = newton

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """J.x = b; PETSc subtracts x."""
        owned = self._newton.owned
        du, dt = self._newton.correct(-b.array_r[:owned])
        x.array[:owned] = -du
        x.array[owned:] = -dt
        ksp.setConvergedReason(PETSc.KSP.ConvergedReason.CONVERGED_ITS)

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """J.x, which a line search asks for the x that takes the residual away: the residual."""
        self._newton.residual.copy(y)
