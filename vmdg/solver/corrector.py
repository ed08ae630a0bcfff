"""Newton's method for a step: PETSc SNES on displacement and load factor.

The unknowns are (u, lambda), lambda the load factor, or the overstress of a jump. In addition to
R(u, lambda) = 0 of (46) the step ends where the first of its limits is met, g(u, lambda) = 0 of
:mod:`vmdg.solver.limits`. The bordered system is solved by block elimination: with the tangent K
and f = -dR/dlambda, the loads,

    K.du_0 = -R,    K.du_1 = f,    du = du_0 + dlambda du_1,

eliminates the linearised R for every dlambda, which follows from g. If the damage work is limited,
a correction that would exceed the limit by far is shortened; return maps alone determine the
length.
"""

from __future__ import annotations

import math
from dataclasses import replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ..assembly.space import facet_pieces
from ..base.parallel import global_any, global_max, global_norm, global_sum, warn_together
from ..base.timers import timer
from ..base.units import power_of_two
from ..compat import SNES_REASONS, UNBOUNDED_SEARCH
from ..domain.topology import box_sides
from ..interface.active import damage_work
from ..laws import Mode
from ..linear.capacitance import solve_contact
from ..linear.condensation import closes_points
from ..linear.ksp import MAX_RTOL, destroy, linear_tolerance, set_options, warn_of_unused
from ..linear.system import System, make_system
from ..problem.problem import Problem
from ..problem.states import RunScales
from .attempt import Attempt
from .limits import ROUNDING, Direction, Limits, Reach
from .options import SolveOptions
from .parameter import Rate, parameter_of
from .turn import turn

Array = NDArray[np.float64]

#: The line search is chosen in every attempt: backtracking by halves if the load factor is the only
#: limit, otherwise full steps, which perform better with limited work.
KIND = "snes_linesearch_type"

#: Finite-difference step of the displacement, relative to the size of the body.
INCREMENT = 1e-7

_REASONS = {value: name for name, value in SNES_REASONS.items()}


class Corrector:
    """Finds the equilibrium in which a step ends, with one matrix and one SNES for all steps.

    Args:
        problem: The problem.
        options: Options of the solver.

    Attributes:
        discretization: The discretization for which it was created.
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
        self._kind = ""  # of the line search so far
        self._size = float(np.linalg.norm(box_sides(problem.mesh)))
        self._rounds, self._softest = False, 0.0
        space, active = problem.discretization.space, problem.discretization.active.values()
        self._names: list[NDArray[np.int64]] = []
        if failing := [one for one in active if one.law.inelastic]:
            pieces = facet_pieces(space, [one.facets for one in failing])
            self._names = [
                piece[one.quadrature.facet] for one, piece in zip(failing, pieces, strict=True)
            ]
        # By halves, independently of the norm of the correction.
        least = float(np.finfo(float).tiny)
        halves = {"order": 1, "max_it": options.path.halvings, "minlambda": least}
        halves |= UNBOUNDED_SEARCH
        search = {f"snes_linesearch_{name}": value for name, value in halves.items()}
        set_options(self._snes, search | {"snes_stol": 0.0} | self._own)

    @property
    def rounding(self) -> float:
        """Rounding error of the stored energy of the bodies [N mm]."""
        return float(np.finfo(float).eps) * self._size**2 * self._system.norm

    def solve(self, limits: Limits, dt: float, last: Attempt | None) -> Attempt:
        """Find the equilibrium at which the first of the limits is met; collective.

        Args:
            limits: Where the step ends.
            dt: Time step of the return maps [s].
            last: The previous step, as in :meth:`.Steps.attempt`.
        """
        problem, krylov, scales = self._problem, self._system.iterations, self._problem.step.scales
        self._system.lags = False
        given = problem, self._options, self._system, self._size, limits, dt
        iteration = _Iteration(*given, self._names)
        with timer("predictor"):
            iteration.predict(last)
        self._snes.setFunction(iteration.residual, self._residual)
        self._snes.setJacobian(lambda *_: None, self._matrix)
        self._snes.setLineSearchPreCheck(iteration.draw_back)
        self._snes.setConvergenceTest(iteration.test)
        self._snes.getKSP().setPythonContext(iteration)
        self._matrix.setPythonContext(iteration)
        self._matrix.setUp()
        kind = self._own.get(KIND, "bt" if limits.by_load_alone else "basic")
        if kind != self._kind:
            PETSc.Options(self._snes.getOptionsPrefix())[KIND] = self._kind = kind
            self._snes.setFromOptions()
        iteration.show(self._x)
        self._snes.solve(None, self._x)
        if self._own:
            warn_of_unused(self._snes)
        reason = self._snes.getConvergedReason()
        found = iteration.attempt()
        # The forces of a failed attempt do not count for the run.
        if reason > 0:
            scales = problem.step.scales.with_forces(reaction=iteration.reaction())
            self._warn_of_rounding(found.norms[-1], scales.reaction)
        problem.step.scales = scales
        return replace(
            found,
            converged=reason > 0,
            reason=_REASONS.get(reason, str(reason)),
            krylov=self._system.iterations - krylov,
            unstable=self._system.unstable,
        )

    def _warn_of_rounding(self, norm: float, reaction: float) -> None:
        """Warn once if the rounding of a stiff body is large relative to the forces of softer
        ones."""
        numbers = self._options.path
        if self._rounds or norm <= numbers.small / numbers.missed * reaction:
            return
        self._softest = self._softest or self._least_stiffness()
        # Otherwise there is no strain, and all forces are rounding.
        self._rounds = reaction > numbers.small * self._softest * self._size
        if self._rounds:
            warn_together(
                self._problem.comm,
                f"forces balance only to {norm:.2g} N, of {reaction:.3g} N: this is the rounding "
                "error of the stiffest body. Use a smaller modulus for it (1e4 to 1e6 times that "
                "of the others is practically rigid), or prescribe its displacement and omit it",
            )

    def _least_stiffness(self) -> float:
        """Least stiffness of a dof of the bodies; collective [N/mm]."""
        matrix = self.discretization.create_matrix(PETSc.Mat.Type.AIJ)
        self.discretization.assemble_tangent(matrix, failing=False)
        diagonal = matrix.getDiagonal().array
        # Means are excluded.
        softest = diagonal.min(initial=math.inf, where=diagonal > 0)
        matrix.destroy()
        return -global_max(self._problem.comm, -float(softest))

    def free(self) -> None:
        """Free the PETSc objects; collective."""
        self._system.free()
        destroy(self._snes)
        for item in (self._x, self._residual, self._matrix):
            item.destroy()


class _Iteration:
    """The iteration of one attempt: callbacks of PETSc for residual, matrix and linear solver."""

    def __init__(
        self,
        problem: Problem,
        options: SolveOptions,
        system: System,
        size: float,
        limits: Limits,
        dt: float,
        names: list[NDArray[np.int64]],
    ):
        self._problem, self._comm, self._step = problem, problem.comm, problem.step
        self._discretization, self._loading = problem.discretization, problem.loading
        self._owned = problem.discretization.owned
        self._failing = [a for a in self._discretization.active.values() if a.law.inelastic]
        self._options, self._numbers, self._system = options, options.path, system
        self._limits, self._dt = limits, dt
        self._parameter = parameter_of(problem, system, limits)
        self._size = size
        self._start = self._place()
        self._along: Array | None = None  # unit tangent of the path
        # Work at the last return map, or of the last step while zeta is fixed.
        self._gradients = [np.zeros_like(active.history.gap) for active in self._failing]
        self._elastic = self._at_onset = False
        # Names of the connected pieces of interfaces at their points, which of them are on pieces
        # without damage, and those whose work is limited if not all.
        self._names = names
        self._sound: list[NDArray[np.bool_]] = []
        self._counted: list[NDArray[np.bool_]] = []
        self._ends_at_target = True
        self._norms: list[float] = []
        # Forces that the predictor balanced, if it is a whole correction.
        self._balanced = 0.0
        self._goal, self._slope, self._rtol = math.nan, 0.0, MAX_RTOL
        self._mapped: Direction | None = None  # state of the last return map
        self._guessed = Reach()
        self._rate: Rate | None = None  # derivative by the parameter, at the last correction

    def attempt(self) -> Attempt:
        """The outcome of the attempt."""
        return Attempt(
            norms=self._norms,
            goal=self._goal,
            guessed=self._guessed,
            end=self._parameter.value,
            slope=self._slope,
            onset=self._at_onset,
        )

    # Predictor

    def predict(self, last: Attempt | None) -> None:
        """Predict by rotation with the supports, by extrapolation, or along the tangent."""
        if last is not None:
            self._gradients = [active.work_gradient(self._dt) for active in self._failing]
        self._find_sound()
        if not self._parameter.moves and turn(self._problem, self._numbers.missed):
            self._step.assemble_residual(self._dt)
            self._follow(self._place(), self._correct(-self._forces()))
        elif last is None or last.ahead is None or not self._extrapolate(last):
            self._along_tangent(anew=last is None or last.ahead is None)
        self._guessed = self._reach()._replace(way=global_norm(self._comm, self._moved()))

    def _find_sound(self) -> None:
        """Mark the points of connected pieces of interfaces that are sound, and of those that begin
        to fail where others have before; collective.

        What begins to fail may unload all others, so its work limits the step. Facets that open on
        demand may carry more than their strength when they open.
        """
        fails, grown = [], []
        for one in self._failing:
            Q, strength = one.history.softening, one.law.strength
            fails.append((one.history.mode != Mode.ELASTIC) & (Q < strength))
            grown.append(fails[-1] & (Q > self._numbers.small * strength))
        comm, on_demand = self._comm, bool(self._step.activation)
        self._elastic = not (on_demand or global_any(comm, any(one.any() for one in fails)))
        if on_demand or not self._limits.onset:
            return
        broken, old = (
            _everywhere(comm, [name[mark] for name, mark in zip(self._names, marks, strict=True)])
            for marks in (fails, grown)
        )
        begun = np.setdiff1d(broken, old)
        if begun.size and old.size:
            self._counted = [np.isin(name, begun) for name in self._names]
        sound = [~np.isin(name, broken) for name in self._names]
        if global_any(comm, any(one.any() for one in sound)):
            self._sound = sound

    def _along_tangent(self, anew: bool) -> None:
        """Predict along the tangent; if crack faces overlap then, with closing points sticking."""
        step, limits = self._step, self._limits
        step.hold(self._dt, anew)
        free = self._forces()
        step.scales = step.scales.with_forces(global_norm(self._comm, free))
        self._follow(self._start, self._correct(-free))
        if step.close(self._dt):
            self._limits, self._mapped = limits, None
            self._at_onset, self._balanced = False, 0.0
            self._visit(self._start)
            step.assemble_residual(self._dt, hold=True)
            self._go(self._start, self._correct(-self._forces(), closes=True), 1.0)

    def _extrapolate(self, last: Attempt) -> bool:
        """Extrapolate the last step until a limit is met; False if none is near."""
        ahead, limits, way = last.ahead, self._limits, global_norm(self._comm, last.ahead.u)
        left = limits.target - limits.start
        if ahead.t * left < 0 and last.work == 0:
            return False
        ratios = ((left, ahead.t), (limits.work, last.work), (limits.way, way))
        length = min((x / done for x, done in ratios if x * done > 0), default=math.inf)
        if length >= 1 / self._numbers.cut:
            return False
        self._along = ahead.u / way if way > 0 else None
        self._go(self._start, ahead, length)
        return True

    # Trial states

    def show(self, x: PETSc.Vec) -> None:
        """Write displacement and load factor into a vector of PETSc."""
        x.array[: self._owned] = self._problem.u.x.array[: self._owned]
        x.array[self._owned :] = self._parameter.value

    def _place(self) -> Direction:
        """Current displacement and parameter."""
        return Direction(self._problem.u.x.array[: self._owned].copy(), self._parameter.value)

    def _visit(self, place: Direction) -> None:
        """Move there to evaluate tractions, with points unchanged."""
        self._problem.u.x.array[: self._owned] = place.u
        self._problem.u.x.scatter_forward()
        self._parameter.move(place.t)
        self._discretization.update_means()

    def _map(self, place: Direction) -> None:
        """Move there, with its prescribed displacements, and do the return maps if it is a new
        state."""
        last = self._mapped
        moves = last is None or place.t != last.t or not np.array_equal(place.u, last.u)
        if not global_any(self._comm, moves):
            return
        u, loading, limits = self._problem.u.x, self._loading, self._limits
        u.array[: self._owned] = place.u
        u.scatter_forward()
        near = abs(place.t - limits.target) <= ROUNDING * limits.span
        self._parameter.move(limits.target if near else place.t)
        # A predictor need not satisfy prescribed displacements.
        u.array[loading.prescribed] = loading.prescribed_values(self._problem.t)
        if loading.rigid:
            u.array[: self._owned] += loading.away(self._problem.t)
            u.scatter_forward()
        self._discretization.update_points(self._dt)
        self._mapped = place

    def _go(self, start: Direction, way: Direction, length: float) -> float:
        """Move along a direction, limited by the damage work of the step; return how far."""
        length = self._allowed(start, way, length)
        self._map(_sum(start, way, length))
        return length

    def _follow(self, start: Direction, way: Direction) -> None:
        """Move along a correction; if along all of it, it is a first one of Newton's method.

        Along a path the tangent near the end of the step is to tell whether it is stable, and is
        not that of the start.
        """
        if self._go(start, way, 1.0) == 1.0 and not self._parameter.moves:
            free = way.u.copy()
            free[self._loading.owned_prescribed] = 0
            forces = self._loading.balance(self._system.product(free))
            self._balanced = global_norm(self._comm, forces)

    def _allowed(self, start: Direction, way: Direction, length: float) -> float:
        """Length along a direction at which the damage work is about at its limit, or the full
        length.

        The onset of damage in a sound piece is a kink of the path: the step ends there. Otherwise
        pieces that are next to fail would soften together, below their strength. Load control may
        pass it if nothing fails yet and no piece begins before another.
        """
        ends = self._sound and not self._at_onset and way.t != 0
        if not (ends and self._elastic):
            length = self._shorter(start, way, length)
        if not ends:
            return length
        self._map(_sum(start, way, length))
        if not self._work_on(self._sound) > self._limits.onset:
            return length
        limits, begun = self._limits, self._begun(start, way, length)
        passes = self._elastic and limits.work == math.inf
        # A bond may begin before bodies flow that would spare it.
        passes &= self._discretization.bodies.points is None
        if passes and begun.size == 1:
            return length
        self._end_at_onset()
        onset = self._shorter(start, way, length)
        beyond = onset + self._numbers.small * (length - onset)
        if passes and np.array_equal(self._begun(start, way, beyond), begun):
            self._limits, self._at_onset, self._ends_at_target = limits, False, True
            return length
        return onset

    def _begun(self, start: Direction, way: Direction, length: float) -> NDArray[np.int64]:
        """Names of the sound pieces in which damage has begun at a state; collective."""
        self._map(_sum(start, way, length))
        begun = [
            name[sound & (active.values.update.damage_work > 0)]
            for active, name, sound in zip(self._failing, self._names, self._sound, strict=True)
        ]
        return _everywhere(self._comm, begun)

    def _shorter(self, start: Direction, way: Direction, length: float) -> float:
        """The same for the current limit of the damage work."""
        if (
            self._limits.work == math.inf
            or self._excess(start, way, length) <= self._numbers.growth
        ):
            return length
        self._ends_at_target = False
        low, high = 0.0, length
        while low < (middle := (low + high) / 2) < high:
            excess = self._excess(start, way, middle)
            # Between 0.5 and 1.5 times the limit is close enough.
            if abs(excess - 1) <= 0.5:
                return middle
            low, high = (low, middle) if excess > 1 else (middle, high)
        return low

    def _excess(self, start: Direction, way: Direction, length: float) -> float:
        """Damage work at a state, relative to its limit."""
        self._map(_sum(start, way, length))
        return float(np.nan_to_num(self._work() / self._limits.work, nan=math.inf))

    def _work(self) -> float:
        """The damage work in the step that is limited; collective [N mm]."""
        counted = self._sound if self._at_onset else self._counted
        return self._work_on(counted) if counted else self._step.bond_work()

    def _work_on(self, counted: list[NDArray[np.bool_]]) -> float:
        """Damage work in the step on some points; collective [N mm]."""
        work = sum(map(damage_work, self._failing, counted))
        return float(self._discretization.geometry.thickness * global_sum(self._comm, work))

    def _end_at_onset(self) -> None:
        """End the step at the onset of damage in a sound piece, a kink of the path."""
        if 0 < self._limits.onset < self._limits.work:
            work = ROUNDING * self._limits.onset / self._numbers.small
            self._limits, self._at_onset = replace(self._limits, work=work), True

    def _reach(self) -> Reach:
        """How far the step has come."""
        way = 0.0
        if self._along is not None:
            way = float(global_sum(self._comm, self._moved() @ self._along))
        return Reach(self._parameter.value, self._work(), way)

    # Corrections

    def _correct(self, forces: Array, closes: bool = False) -> Direction:
        """Correction for a residual of -forces that ends at a limit; collective.

        For a given load factor, bodies may be treated as linear, with closing points.
        """
        limits, now, parameter = self._limits, self._reach(), self._parameter
        away, self._ends_at_target = self._loading.away(self._problem.t), True
        left = limits.target - now.t if parameter.moves else 0.0
        alone = limits.by_load_alone or not parameter.moves
        self._rate = rate = parameter.rate(self._moved()) if left or not alone else None
        self._system.drag = max(parameter.drag, self._numbers.small * self._step.scales.held)
        if alone:
            if left:
                forces, away = forces + left * rate.forces, away + left * rate.supports
            problem, options = self._problem, self._options
            if closes and closes_points(problem, options.condensed, options.petsc):
                found = solve_contact(problem, self._system, forces, away, self._dt)
            else:
                found = self._system.solve([forces], [away], self._rtol)[0]
            return Direction(found, left)
        found = self._system.solve([forces, rate.forces], [away, rate.supports], self._rtol)
        zero, one = Direction(found[0], 0.0), Direction(found[1], 1.0)
        size = global_norm(self._comm, one.u)
        if not np.isfinite(global_norm(self._comm, zero.u) + size):
            return Direction(np.full_like(zero.u, np.nan), 0.0)
        if self._along is None and size > 0:
            self._along = one.u * limits.toward / size
            now = self._reach()
        rates = [self._rates(zero), self._rates(one, rate.work)]
        self._slope = rates[1].work
        change, self._ends_at_target = limits.change(now, *rates)
        if not self._ends_at_target and self._elastic and self._slope:
            self._end_at_onset()
            change, self._ends_at_target = self._limits.change(now, *rates)
        change = max(change, parameter.least - now.t)
        return _sum(zero, one, change)

    def _rates(self, direction: Direction, work: float = 0.0) -> Reach:
        """Rates of the limits along a direction, with additional work; collective."""
        along = 0.0 if self._along is None else direction.u @ self._along
        done, along = global_sum(self._comm, [self._work_along(direction), along])
        return Reach(direction.t, done + work, along)

    def _work_along(self, direction: Direction) -> float:
        """Derivative of the damage work along a direction, from the gradients of the laws;
        collective."""
        size = global_norm(self._comm, direction.u)
        gradients = [
            before if active.values.update is None else active.work_gradient(self._dt)
            for active, before in zip(self._failing, self._gradients, strict=True)
        ]
        if counted := self._sound if self._at_onset else self._counted:
            known = zip(gradients, counted, strict=True)
            gradients = [G * points[:, None] for G, points in known]
        largest = max((np.abs(G).max(initial=0.0) for G in gradients), default=0.0)
        if size == 0 or global_max(self._comm, float(largest)) == 0:
            return 0.0
        parts, here, work = self._discretization, self._place(), 0.0
        straight = parts.bodies.linear and not self._loading.pressurised
        # If it is exact for any h, a direction is added at the size of the mesh: then rounding
        # depends neither on its length nor on the unit of the load factor.
        h = float(power_of_two(self._size / size)) if straight else INCREMENT * self._size / size
        with timer("rates"):
            before = [active.total_in_frame() for active in self._failing]
            self._visit(_sum(here, direction, h))
            if bodies := parts.bodies.points:
                bodies.extrapolate(bodies.deformation(self._problem.u))
            for active, G, q in zip(self._failing, gradients, before, strict=True):
                change = np.einsum("pi,pi->p", G, active.total_in_frame() - q) / h
                work += active.quadrature.weights @ change
            self._visit(here)
            if bodies:
                bodies.return_to(bodies.state)
        return float(parts.geometry.thickness) * work

    # Forces

    def _forces(self) -> Array:
        """Residual on owned dofs, without reactions of supports and rigid faces [N]."""
        forces = self._discretization.forces.x.array[: self._owned].copy()
        if self._parameter.drag:
            forces += self._parameter.drag * self._system.norm * self._moved()
        return self._loading.balance(forces)

    def _moved(self) -> Array:
        """Displacement in the step, owned dofs [mm]."""
        return self._problem.u.x.array[: self._owned] - self._start.u

    def reaction(self) -> float:
        """Norm of reactions, including those of springs, and of forces on means [N]."""
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
        """R on free dofs; the entry of lambda is zero."""
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
        if self._rate is not None:
            forces = forces - direction.t * self._rate.forces
        y.array[: self._owned] = self._loading.balance(forces)

    def draw_back(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """Shorten a correction that would exceed the damage work of the step by far."""
        start, way = self._read(x), self._read(y)
        length = self._allowed(start, Direction(-way.u, -way.t), 1.0)
        if length < 1.0:
            y.scale(length)
        return length < 1.0

    def test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        """Test for convergence at the end of the step, or for stagnation."""
        reasons, norm, reaction = PETSc.SNES.ConvergedReason, norms[2], self.reaction()
        self._norms.append(norm)
        if not np.isfinite(norm + reaction):
            return SNES_REASONS["DIVERGED_FNORM_NAN"]
        self._goal = goal = self._goal_of(self._step.scales.with_forces(reaction=reaction))
        if norm <= goal and self._met():
            return reasons.CONVERGED_FNORM_RELATIVE
        if len(self._norms) > self._options.max_iterations + 1:
            return reasons.DIVERGED_MAX_IT
        patience, little = self._numbers.patience, self._numbers.rest
        before, last = self._norms[:-patience], self._norms[-patience:]
        if norm > goal and before and min(last) > (1 - little) * min(before):
            return reasons.DIVERGED_LOCAL_MIN
        self._rtol = linear_tolerance(self._norms, goal)
        # Reusing the last tangent multiplies the residual by about twice the ratio of the last two,
        # since convergence is quadratic; it is reused if that ends far below the goal.
        first = self._norms[-2] if len(self._norms) > 1 else self._balanced
        surely = self._numbers.missed * goal
        self._system.lags = goal < norm and 2 * norm**2 <= surely * first
        return reasons.ITERATING

    def _goal_of(self, scales: RunScales) -> float:
        """Norm of the residual on the free dofs at which the step has converged [N].

        It is small against the largest force the run has seen (reactions, loads, or the imbalance a
        step starts with), a scale that remains when the body has separated. The imbalance of a step
        that loads a weak bond far beyond its strength may exceed any force that it can carry by
        orders of magnitude, so the residual must also be small relative to actual forces. It cannot
        fall below the rounding error of nodal positions, for nodes that may have moved far, times
        stiffness.
        """
        far = global_max(self._comm, float(np.abs(self._problem.u.x.array).max(initial=0.0)))
        floor = float(np.finfo(float).eps) * (self._size + far) * self._system.norm
        goal = self._options.relative_tolerance * scales.force
        return max(min(goal, self._numbers.small * scales.reaction), floor)

    def _met(self) -> bool:
        """Whether an equilibrium is at the end of the step."""
        limits, now, missed = self._limits, self._reach(), self._numbers.missed
        if not self._parameter.moves or limits.target == limits.start:
            return True
        if self._at_onset and not self._ends_at_target:
            return now.work <= limits.onset
        if (now.t - limits.target) * limits.toward > 0 or now.work > (1 + missed) * limits.work:
            return False
        there = now.work >= (1 - missed) * limits.work or now.way >= (1 - missed) * limits.way
        return there or now.t == limits.target


def _everywhere(comm: MPI.Comm, names: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Names of pieces on any rank; collective."""
    here = np.unique(np.concatenate(names)) if names else np.zeros(0, dtype=np.int64)
    return np.unique(np.concatenate(comm.allgather(here)))


def _sum(start: Direction, way: Direction, length: float) -> Direction:
    """A state along a direction from another one."""
    return Direction(start.u + length * way.u, start.t + length * way.t)
