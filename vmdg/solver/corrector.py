"""Newton's method for a step: PETSc SNES on displacement and load factor.

The unknowns are (u, lambda), lambda the load factor, or the overstress of a jump. Beside
R(u, lambda) = 0 of (46) the step ends where the first of its limits is met, g(u, lambda) = 0 of
:mod:`vmdg.solver.limits`. The bordered system is solved by block elimination: with the tangent K
and f = -dR/dlambda, the loads,

    K.du_0 = -R,    K.du_1 = f,    du = du_0 + dlambda du_1,

takes the linearised R away for every dlambda, and g says which. Where work on bonds is limited a
correction that would break far more is drawn back along itself; return maps alone tell how far.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from ..base.parallel import global_any, global_max, global_norm, global_sum
from ..base.timers import timer
from ..compat import SNES_REASONS, UNBOUNDED_SEARCH
from ..domain.topology import box_sides
from ..interface.active import ActiveInterface
from ..laws import Mode
from ..linear.capacitance import solve_contact
from ..linear.condensation import closes_points
from ..linear.ksp import MAX_RTOL, destroy, linear_tolerance, set_options, warn_of_unused
from ..linear.system import System, make_system
from ..problem.problem import Problem
from ..problem.states import RunScales
from .attempt import Attempt, Guess
from .limits import ROUNDING, Direction, Limits, Reach
from .options import SolveOptions
from .parameter import Jump, LoadFactor, Overstress, Parameter
from .turn import turn

Array = NDArray[np.float64]

#: The kind of line search is chosen in every attempt: backtracking by halves where the load factor
#: is the only limit, else full steps, which do better where work is limited.
KIND = "snes_linesearch_type"

#: Change of the displacement for its rates, relative to the size of the body.
INCREMENT = 1e-7

_REASONS = {value: name for name, value in SNES_REASONS.items()}


class Corrector:
    """Finds the equilibrium in which a step ends, with one matrix and one SNES for all steps.

    Args:
        problem: The problem.
        options: Of the solver.

    Attributes:
        discretization: What it was made for.
    """

    def __init__(self, problem: Problem, options: SolveOptions):
        self.discretization = problem.discretization
        self._problem, self._options = problem, options
        self._system = make_system(problem, options.condensed, options.petsc)
        # lambda is the last unknown of the first rank.
        local = problem.discretization.owned + (problem.comm.rank == 0)
        self._x = PETSc.Vec().createMPI((local, None), comm=problem.comm)
        self._residual = self._x.duplicate()
        self._matrix = PETSc.Mat().create(problem.comm)
        self._matrix.setSizes(((local, None), (local, None)))
        self._matrix.setType(PETSc.Mat.Type.PYTHON)
        self._snes = PETSc.SNES().create(problem.comm)
        self._snes.getKSP().setType(PETSc.KSP.Type.PYTHON)
        self._snes.getKSP().getPC().setType(PETSc.PC.Type.NONE)
        self._own = {k: v for k, v in (options.petsc or {}).items() if k.startswith("snes_")}
        # By halves, however large or small a correction is as a number.
        least = float(np.finfo(float).tiny)
        halves = {"order": 1, "max_it": options.path.halvings, "minlambda": least}
        halves |= UNBOUNDED_SEARCH
        search = {f"snes_linesearch_{name}": value for name, value in halves.items()}
        set_options(self._snes, search | {"snes_stol": 0.0} | self._own)

    @property
    def rounding(self) -> float:
        """Of the energy that bodies store [N mm]."""
        size = float(np.linalg.norm(box_sides(self._problem.mesh)))
        return float(np.finfo(float).eps) * size**2 * self._system.norm

    def solve(self, limits: Limits, dt: float, guess: Guess, jump: Jump | None = None) -> Attempt:
        """Go to where the first of the limits is met; collective.

        Args:
            limits: Where the step ends.
            dt: Time step of the return maps [s].
            guess: How the last step went.
            jump: That the step is of; its parameter is the overstress then.
        """
        problem, krylov, scales = self._problem, self._system.iterations, self._problem.step.scales
        self._system.lags = False
        parameter = Parameter(problem) if problem.loading.ray is None else LoadFactor(problem)
        if jump is not None:
            parameter = Overstress(problem, self._system, jump.drag, limits.start)
        iteration = _Iteration(problem, self._options, self._system, limits, dt, parameter)
        with timer("predictor"):
            iteration.predict(guess)
        self._serve(iteration)
        kind = self._own.get(KIND, "bt" if limits.by_load_alone else "basic")
        PETSc.Options(self._snes.getOptionsPrefix())[KIND] = kind
        self._snes.setFromOptions()
        iteration.show(self._x)
        self._snes.solve(None, self._x)
        if self._own:
            warn_of_unused(self._snes)
        reason = self._snes.getConvergedReason()
        if reason > 0:
            reaction = iteration.reaction()
            problem.step.scales = problem.step.scales.with_forces(reaction=reaction)
        else:
            # The forces of a state that is given up say nothing about the run.
            problem.step.scales = scales
        return iteration.attempt(
            converged=reason > 0,
            reason=_REASONS.get(reason, str(reason)),
            krylov=self._system.iterations - krylov,
            unstable=self._system.unstable,
        )

    def _serve(self, iteration: _Iteration) -> None:
        """Have PETSc ask this iteration from now on."""
        self._snes.setFunction(iteration.residual, self._residual)
        self._snes.setJacobian(lambda *_: None, self._matrix)
        self._snes.setLineSearchPreCheck(iteration.draw_back)
        self._snes.setConvergenceTest(iteration.test)
        self._snes.getKSP().setPythonContext(iteration)
        self._matrix.setPythonContext(iteration)
        self._matrix.setUp()

    def free(self) -> None:
        """Free the PETSc objects; collective."""
        self._system.free()
        destroy(self._snes)
        for item in (self._x, self._residual, self._matrix):
            item.destroy()


class _Iteration:
    """The iteration of one attempt: what PETSc asks of residual, matrix and linear solver.

    Args:
        problem: In the state at which the step begins.
        options: Of the solver.
        system: K.
        limits: Where the step ends.
        dt: Time step of the return maps [s].
        parameter: What changes besides the displacement.
    """

    def __init__(
        self,
        problem: Problem,
        options: SolveOptions,
        system: System,
        limits: Limits,
        dt: float,
        parameter: Parameter,
    ):
        self._problem, self._comm, self._step = problem, problem.comm, problem.step
        self._discretization, self._loading = problem.discretization, problem.loading
        self._owned = problem.discretization.owned
        self._options, self._numbers, self._system = options, options.path, system
        self._limits, self._dt, self._parameter = limits, dt, parameter
        self._size = float(np.linalg.norm(box_sides(problem.mesh)))
        self._hangs = options.path.small * problem.step.scales.held
        self._start = self._place()
        self._along: Array | None = None  # unit tangent of the path, the way of the step
        self._elastic, self._most, self._at_onset = False, 0.0, False
        self._ends_at_target = True
        self._norms: list[float] = []
        self._goal, self._slope, self._rtol = math.nan, 0.0, MAX_RTOL
        self._mapped: Direction | None = None  # where the points were mapped back last
        self._guessed = Reach()
        self._gradients = [np.zeros_like(active.history.gap) for active in self._failing]

    @property
    def _failing(self) -> list[ActiveInterface]:
        """Interfaces that can fail."""
        return [one for one in self._discretization.active.values() if one.law.inelastic]

    def attempt(self, converged: bool, reason: str, krylov: int, unstable: bool) -> Attempt:
        """What there is to say about it."""
        return Attempt(
            converged,
            self._norms,
            reason,
            self._goal,
            krylov,
            guessed=self._guessed,
            end=self._parameter.value,
            slope=self._slope,
            onset=self._at_onset,
            unstable=unstable,
        )

    # The first guess

    def predict(self, guess: Guess) -> None:
        """Turn with the supports, go on as in the last step, or along the tangent."""
        if guess.goes_on:
            # The gradient at the end of the last step serves while zeta is held.
            self._gradients = [active.work_gradient(self._dt) for active in self._failing]
        # Facets that open on demand may bear more than their strength as they open.
        breaks = any(
            ((one.history.mode != Mode.ELASTIC) & (one.history.softening < one.law.strength)).any()
            for one in self._failing
        )
        elastic = not (breaks or self._step.activation)
        self._most, self._elastic = guess.most, not global_any(self._comm, not elastic)
        if not self._parameter.moves and turn(self._problem):
            self._step.assemble_residual(self._dt)
            self._go(self._place(), self._correct(-self._forces()), 1.0)
        elif not self._extrapolate(guess):
            self._along_tangent(guess)
        self._guessed = self._reach()._replace(way=global_norm(self._comm, self._moved()))

    def _along_tangent(self, guess: Guess) -> None:
        """Go along the tangent; where faces that touch overlap then, with closing points held."""
        step, limits = self._step, self._limits
        step.hold(self._dt, sliding=guess.ahead is None)
        free = self._forces()
        step.scales = step.scales.with_forces(global_norm(self._comm, free))
        self._go(self._start, self._correct(-free), 1.0)
        if step.close(self._dt):
            self._limits, self._mapped = limits, None
            self._visit(self._start)
            step.assemble_residual(self._dt, hold=True)
            self._go(self._start, self._correct(-self._forces(), closes=True), 1.0)

    def _extrapolate(self, guess: Guess) -> bool:
        """Go on as in the last step until a limit is met; False where none is near."""
        ahead, limits, start = guess.ahead, self._limits, self._start
        if ahead is None:
            return False
        left, longest = limits.target - limits.start, 1 / self._numbers.cut
        if ahead.t * left < 0 and guess.work == 0:
            return False
        way, lengths = global_norm(self._comm, ahead.u), [longest]
        if ahead.t * left > 0:
            lengths.append(left / ahead.t)
        if guess.work > 0:
            lengths.append(limits.work / guess.work)
        if way > 0:
            lengths.append(limits.way / way)
        if min(lengths) == longest:
            return False
        self._along = ahead.u / way if way > 0 else None
        self._go(start, ahead, min(lengths))
        return True

    # Trial states

    def show(self, x: PETSc.Vec) -> None:
        """Write displacement and load factor into a vector of PETSc."""
        x.array[: self._owned] = self._problem.u.x.array[: self._owned]
        x.array[self._owned :] = self._parameter.value

    def _place(self) -> Direction:
        """Displacement and parameter now."""
        return Direction(self._problem.u.x.array[: self._owned].copy(), self._parameter.value)

    def _move(self, place: Direction) -> None:
        """Change displacement and parameter."""
        u, loading, limits = self._problem.u.x, self._loading, self._limits
        u.array[: self._owned] = place.u
        u.scatter_forward()
        near = abs(place.t - limits.target) <= ROUNDING * limits.span
        self._parameter.move(limits.target if near else place.t)
        # A first guess need not know where supports are.
        u.array[loading.prescribed] = loading.prescribed_values(self._problem.t)
        if loading.rigid:
            u.array[: self._owned] += loading.away(self._problem.t)
            u.scatter_forward()

    def _visit(self, place: Direction) -> None:
        """Go there for a look at tractions, points as they are."""
        self._problem.u.x.array[: self._owned] = place.u
        self._problem.u.x.scatter_forward()
        self._parameter.move(place.t)
        self._discretization.update_means()

    def _map(self, place: Direction) -> None:
        """Go there and map the points back, but where they are."""
        last = self._mapped
        moves = last is None or place.t != last.t or not np.array_equal(place.u, last.u)
        if global_any(self._comm, moves):
            self._move(place)
            self._discretization.update_points(self._dt)
            self._mapped = place

    def _go(self, start: Direction, way: Direction, length: float) -> None:
        """Go along a direction, not to where far more would break than the step may."""
        self._map(_sum(start, way, self._allowed(start, way, length)))

    def _allowed(self, start: Direction, way: Direction, length: float) -> float:
        """Length of a direction at which no more than about the limit of the work is done."""
        most = self._numbers.growth * self._limits.work
        if most == math.inf:
            return length
        self._map(_sum(start, way, length))
        work = self._step.bond_work()
        if work <= most:
            return length
        self._ends_at_target = False
        if self._elastic and way.t != 0:
            self._end_at_onset()
        # As arguments: brentq's wrapper of a function refers to itself, and would keep the problem.
        return length * brentq(_excess, 0.0, 1.0, (self, start, way, length), disp=False)

    def excess(self, place: Direction) -> float:
        """Work on bonds at a place beyond the limit, in limits; no number is too much."""
        self._map(place)
        return float(np.nan_to_num(self._step.bond_work() / self._limits.work - 1, nan=1.0))

    def _end_at_onset(self) -> None:
        """From an elastic state the step ends at the onset of damage, a kink of the path."""
        if 0 < self._numbers.small * self._most < self._limits.work:
            self._limits = replace(self._limits, work=ROUNDING * self._most)
            self._at_onset = True

    def _reach(self) -> Reach:
        """How far the step has come."""
        way = 0.0
        if self._along is not None:
            way = float(global_sum(self._comm, self._moved() @ self._along))
        return Reach(self._parameter.value, self._step.bond_work(), way)

    # Corrections

    def _correct(self, forces: Array, closes: bool = False) -> Direction:
        """Correction that takes a residual of -forces away and ends at a limit; collective.

        Where the load factor is given, bodies may be taken as linear, with points that close.
        """
        loading, limits, now = self._loading, self._limits, self._reach()
        away, self._ends_at_target = loading.away(self._problem.t), True
        if not self._parameter.moves:
            return Direction(self._solve_once(forces, away, closes), 0.0)
        left = limits.target - now.t
        if limits.by_load_alone:
            if left:
                rate = self._parameter.rate(self._moved())
                forces, away = forces + left * rate.forces, away + left * rate.supports
            return Direction(self._solve_once(forces, away, closes), left)
        rate = self._parameter.rate(self._moved())
        found = self._solve([forces, rate.forces], [away, rate.supports])
        zero, one = Direction(found[0], 0.0), Direction(found[1], 1.0)
        size = global_norm(self._comm, one.u)
        if not np.isfinite(global_norm(self._comm, zero.u) + size):
            return Direction(np.full_like(zero.u, np.nan), 0.0)
        if self._along is None and size > 0:
            self._along = one.u * limits.toward / size
            now = self._reach()
        rates = [self._rates(zero), self._rates(one)]
        rates[1] = rates[1]._replace(work=rates[1].work + rate.work)
        self._slope = rates[1].work
        change, self._ends_at_target = limits.change(now, *rates)
        if not self._ends_at_target and self._elastic and self._slope:
            self._end_at_onset()
            change, self._ends_at_target = self._limits.change(now, *rates)
        change = max(change, self._parameter.least - now.t)
        return Direction(zero.u + change * one.u, change)

    def _solve(self, forces: list[Array], moved: list[Array]) -> Sequence[Array]:
        self._system.drag = max(self._parameter.drag, self._hangs)
        return self._system.solve(forces, moved, self._rtol)

    def _solve_once(self, forces: Array, moved: Array, closes: bool) -> Array:
        if closes and closes_points(self._problem, self._options.condensed, self._options.petsc):
            return solve_contact(self._problem, self._system, forces, moved, self._dt)
        return self._solve([forces], [moved])[0]

    def _rates(self, direction: Direction) -> Reach:
        """Where a direction leads, by the gradients of the laws; collective."""
        along = 0.0 if self._along is None else direction.u @ self._along
        return Reach(direction.t, *global_sum(self._comm, [self._work_along(direction), along]))

    def _work_along(self, direction: Direction) -> float:
        """Derivative of the work on this rank's bonds; collective [N mm]."""
        size = global_norm(self._comm, direction.u)
        gradients = [
            before if active.values.update is None else active.work_gradient(self._dt)
            for active, before in zip(self._failing, self._gradients, strict=True)
        ]
        largest = max((np.abs(G).max(initial=0.0) for G in gradients), default=0.0)
        if size == 0 or global_max(self._comm, float(largest)) == 0:
            return 0.0
        parts, here, work = self._discretization, self._place(), 0.0
        straight = parts.bodies.small and not self._loading.pressurised
        h = 1.0 if straight else INCREMENT * self._size / size
        with timer("rates"):
            before = [active.total_in_frame() for active in self._failing]
            self._visit(_sum(here, direction, h))
            for active, G, q in zip(self._failing, gradients, before, strict=True):
                change = np.einsum("pi,pi->p", G, active.total_in_frame() - q) / h
                work += active.quadrature.weights @ change
            self._visit(here)
        return float(parts.geometry.thickness) * work

    # Forces

    def _forces(self) -> Array:
        """Residual on owned dofs, without what supports and rigid faces take [N]."""
        forces = self._discretization.forces.x.array[: self._owned].copy()
        if self._parameter.drag:
            forces += self._parameter.drag * self._system.norm * self._moved()
        return self._loading.balance(forces)

    def _moved(self) -> Array:
        """Displacement in the step, owned dofs [mm]."""
        return self._problem.u.x.array[: self._owned] - self._start.u

    def reaction(self) -> float:
        """Norm of reactions, those of springs among them, and of forces on means [N]."""
        parts, loading = self._discretization, self._loading
        forces = parts.forces.x.array[: self._owned]
        held = forces - loading.balance(forces.copy())
        if parts.means is not None:
            dofs = parts.means.owned_dofs
            held[dofs] = forces[dofs] + loading.vector[dofs]
        return global_norm(self._comm, np.append(held, parts.surface.spring_forces()))

    # Called by PETSc

    def _read(self, x: PETSc.Vec) -> Direction:
        """A vector of PETSc, lambda on all ranks."""
        last = float(x.array_r[-1]) if self._comm.rank == 0 else None
        return Direction(x.array_r[: self._owned].copy(), self._comm.bcast(last))

    def residual(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        """R on free dofs; lambda has no equation of forces, and its place is zero."""
        place = self._read(x)
        farthest = global_max(self._comm, float(np.abs(place.u).max(initial=0.0)))
        if not self._numbers.small * farthest <= self._size:
            f.set(np.nan)
            return
        self._map(place)
        self._discretization.assemble_residual(None, False, self._loading.vector)
        f.set(0.0)
        f.array[: self._owned] = self._forces()

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """J.x = b by block elimination; PETSc subtracts x."""
        correction = self._correct(-b.array_r[: self._owned])
        x.array[: self._owned] = -correction.u
        x.array[self._owned :] = -correction.t
        ksp.setConvergedReason(PETSc.KSP.ConvergedReason.CONVERGED_ITS)

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """J.x = K.du - f dlambda on free dofs, for the slope of a line search."""
        direction = self._read(x)
        y.set(0.0)
        forces = self._system.product(direction.u)
        if direction.t != 0:
            forces = forces - direction.t * self._parameter.rate(self._moved()).forces
        y.array[: self._owned] = self._loading.balance(forces)

    def draw_back(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """Shorten a correction that would break far more than the step may."""
        start, way = self._read(x), self._read(y)
        length = self._allowed(start, Direction(-way.u, -way.t), 1.0)
        if length < 1.0:
            y.scale(length)
        return length < 1.0

    def test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        """Whether forces balance where the step ends, or the iteration leads nowhere."""
        reasons, norm, reaction = PETSc.SNES.ConvergedReason, norms[2], self.reaction()
        self._norms.append(norm)
        scales = self._step.scales
        if not np.isfinite(norm + reaction):
            return SNES_REASONS["DIVERGED_FNORM_NAN"]
        self._goal = goal = self._goal_of(scales.with_forces(reaction=reaction))
        if norm <= goal and self._met():
            return reasons.CONVERGED_FNORM_RELATIVE
        if len(self._norms) > self._options.max_iterations + 1:
            return reasons.DIVERGED_MAX_IT
        if norm > goal and self._stalls():
            return reasons.DIVERGED_LOCAL_MIN
        self._rtol = linear_tolerance(self._norms, goal)
        # By quadratic convergence a tangent leaves twice the share it has left; surely 20 times.
        before = self._norms[-2:][0]
        self._system.lags = len(self._norms) > 1 and goal < norm and 20 * norm**2 <= goal * before
        return reasons.ITERATING

    def _goal_of(self, scales: RunScales) -> float:
        """Norm of the residual on the free dofs at which the step has converged [N].

        It is small against the largest force the run has seen (reactions, loads, or the imbalance a
        step starts with), a scale that stays when the body has come apart. The imbalance of a step
        that carries a weak bond far beyond its strength may be larger by orders of magnitude than
        any force it can bear, so that the residual must also be small against forces that were
        there. No residual comes below the rounding of differences of positions, of nodes that may
        have gone far, times stiffness.
        """
        far = global_max(self._comm, float(np.abs(self._problem.u.x.array).max(initial=0.0)))
        floor = float(np.finfo(float).eps) * (self._size + far) * self._system.norm
        goal = self._options.relative_tolerance * scales.force
        return max(min(goal, self._numbers.small * scales.reaction), floor)

    def _met(self) -> bool:
        """Whether an equilibrium ends the step."""
        limits, now = self._limits, self._reach()
        if not self._parameter.moves or limits.target == limits.start:
            return True
        share = 1 - self._numbers.missed
        if self._at_onset and not self._ends_at_target:
            return now.work <= self._numbers.small * self._most
        if (now.t - limits.target) * limits.toward > 0 or now.work > (2 - share) * limits.work:
            return False
        there = now.work >= share * limits.work or now.way >= share * limits.way
        return there or now.t == limits.target

    def _stalls(self) -> bool:
        """Whether the last corrections lead nowhere."""
        patience, little = self._numbers.patience, self._numbers.rest
        before, last = self._norms[:-patience], self._norms[-patience:]
        return bool(before) and min(last) > (1 - little) * min(before)


def _sum(start: Direction, way: Direction, length: float) -> Direction:
    """A place on the way from another one."""
    return Direction(start.u + length * way.u, start.t + length * way.t)


def _excess(share: float, iteration: _Iteration, start: Direction, way: Direction, far: float):
    """Root: about the limit of the work. Between half of it and half more is near enough."""
    if share == 0.0:
        return -1.0
    more = min(iteration.excess(_sum(start, way, share * far)), 1.0)
    return 0.0 if abs(more) <= 0.5 else more
