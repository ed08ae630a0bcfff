"""The iterate of a step: displacement and parameter, return maps there, forces and works.

A step that limits the damage work moves no farther along a direction than about to that work, and
ends at the onset of damage in a sound piece of the interfaces, see :mod:`vmdg.solver.onset`; return
maps alone find both.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import power_of_two
from ..base.parallel import global_any, global_max, global_norm, global_sum
from ..base.timers import timer
from ..interface.active import last_total, total_in_frame
from ..linear.system import System
from ..problem.problem import Problem
from .limits import ROUNDING, Direction, Limits, Reach
from .onset import Names, Pieces, Points, Sound
from .options import PathOptions
from .parameter import parameter_of

Array = NDArray[np.float64]

#: Finite-difference step of the displacement, relative to the size of the body.
INCREMENT = 1e-7

#: Rate of the damage work that counts as rounding, relative to that of points whose trial traction
#: changes by r times the largest displacement.
NEGLIGIBLE_RATE = 1e-8


class Iterate:
    """The iterate of an attempt, the state of the problem; all methods are collective.

    Attributes:
        limits: As given, or those of a step that ends at the onset of damage.
        along: Unit tangent of the path there; None while unknown.
        passed: Force on the supports at an onset that the step passes [N]; -inf for none.
    """

    def __init__(
        self,
        problem: Problem,
        system: System,
        pieces: Pieces,
        numbers: PathOptions,
        size: float,
        limits: Limits,
        dt: float,
        continues: bool,
    ):
        self._problem, self._comm, self._step = problem, problem.comm, problem.step
        self._discretization, self._loading = problem.discretization, problem.loading
        self._owned = problem.discretization.owned
        self._system, self._pieces, self._numbers, self._size = system, pieces, numbers, size
        self.limits, self._dt, self.parameter = limits, dt, parameter_of(problem, system, limits)
        self.start = self.place()
        self.along: Array | None = None
        self.passed = -math.inf
        # Facets that open on demand may carry more than their strength when they open.
        watched = limits.onset > 0 and not problem.step.activation
        self.sound = pieces.sound(numbers.small) if watched else Sound()
        # Used as long as zeta is fixed.
        self._gradients = [
            active.work_gradient(dt) if continues else np.zeros_like(active.history.gap)
            for active in pieces.interfaces
        ]
        self._mapped: Direction | None = None  # state of the last return map
        active = self._discretization.active.values()
        self._branching = [one for one in active if one.law.inelastic]
        self._noted: list[Array] = []  # their C in the last correction

    # Moves

    def place(self) -> Direction:
        return Direction(self._problem.u.x.array[: self._owned].copy(), self.parameter.value)

    def visit(self, place: Direction) -> None:
        """Move there to evaluate tractions, with points unchanged."""
        self._problem.u.x.array[: self._owned] = place.u
        self._problem.u.x.scatter_forward()
        self.parameter.move(place.t)
        self._discretization.update_means()

    def restart(self, limits: Limits) -> None:
        self.limits, self._mapped = limits, None
        self.visit(self.start)
        self._step.assemble_residual(self._dt, hold=True)

    def map(self, place: Direction) -> None:
        """Move there, with its prescribed displacements, and do the return maps if it is a new
        state."""
        last = self._mapped
        moves = last is None or place.t != last.t or not np.array_equal(place.u, last.u)
        if not global_any(self._comm, moves):
            return
        u, loading, limits = self._problem.u.x, self._loading, self.limits
        u.array[: self._owned] = place.u
        u.scatter_forward()
        near = abs(place.t - limits.target) <= ROUNDING * limits.span
        self.parameter.move(limits.target if near else place.t)
        # A predictor need not satisfy prescribed displacements.
        u.array[loading.prescribed] = loading.prescribed_values(self._problem.t)
        if loading.rigid:
            u.array[: self._owned] += loading.away(self._problem.t)
            u.scatter_forward()
        self._discretization.update_points(self._dt)
        self._mapped = place

    def go(self, start: Direction, way: Direction, length: float) -> float:
        """Move along a direction as far as the damage work allows; return how far."""
        length = self.allowed(start, way, length)
        self.map(start.plus(way, length))
        return length

    def allowed(self, start: Direction, way: Direction, length: float) -> float:
        """Length along a direction at which the damage work is about at its limit, or the full
        length."""
        length, limits, sound = self._shorter(start, way, length), self.limits, self.sound
        # At a given load no step can end at an onset.
        if not (sound.points and self.parameter.moves and way.t) or limits.at_onset:
            return length
        self.map(start.plus(way, length))
        if not self._pieces.work(sound.points) > limits.onset:
            return length
        begun = self._begun(start, way, length)
        self.limits = limits.ending_at_onset()
        onset = self._shorter(start, way, length)
        bodies = self._discretization.bodies
        by_load = limits.work == math.inf and not limits.kinks
        if sound.elastic and by_load and bodies.points is None:
            # Load control passes the onset if no piece begins before another; a bond may begin
            # before bodies flow that would spare it.
            beyond = onset + self._numbers.small * (length - onset)
            if np.array_equal(self._begun(start, way, beyond), begun):
                self.limits = limits
                self._pass(start.plus(way, onset))
                return length
        return onset

    def _pass(self, place: Direction) -> None:
        """Note the force at the first onset that a step passes, where it is elastic so far."""
        if self.passed == -math.inf and self._loading.ray is not None:
            self.map(place)
            self._problem.discretization.assemble_residual(None, False, self._loading.vector)
            self.passed = force_of(self._problem)

    def _begun(self, start: Direction, way: Direction, length: float) -> Names:
        self.map(start.plus(way, length))
        return self._pieces.begun(self.sound.points)

    def _shorter(self, start: Direction, way: Direction, length: float) -> float:
        """The same for the current limit of the damage work, or for that at the start if it is
        larger."""
        if self.limits.work == math.inf:
            return length
        excess, growth = self._excess(start, way, length), self._numbers.growth
        most = 1.0 if excess <= growth else max(self._excess(start, way, 0.0), 1.0)
        if excess <= growth * most:
            return length
        low, high = 0.0, length
        while low < (middle := (low + high) / 2) < high:
            excess = self._excess(start, way, middle) / most
            # Between 0.5 and 1.5 times the limit is close enough.
            if abs(excess - 1) <= 0.5:
                return middle
            low, high = (low, middle) if excess > 1 else (middle, high)
        return low

    def _excess(self, start: Direction, way: Direction, length: float) -> float:
        self.map(start.plus(way, length))
        return float(np.nan_to_num(self._work() / self.limits.work, nan=math.inf))

    def _work(self) -> float:
        return self._pieces.work(self._limited) if self._limited else self._step.bond_work()

    @property
    def _limited(self) -> Points:
        return self.sound.points if self.limits.at_onset else self.sound.counted

    # Quantities

    def moved(self) -> Array:
        """Displacement in the step, owned dofs [mm]."""
        return self._problem.u.x.array[: self._owned] - self.start.u

    def reach(self) -> Reach:
        way = 0.0
        if self.along is not None:
            way = float(global_sum(self._comm, self.moved() @ self.along))
        return Reach(self.parameter.value, self._work(), way)

    def rates(self, direction: Direction, work: float = 0.0) -> Reach:
        along = 0.0 if self.along is None else direction.u @ self.along
        done, size_of_rate, along = global_sum(self._comm, [*self._work_along(direction), along])
        # Where the last bonds have come off, its sign would be chance, and with it the direction.
        done = done if abs(done) > NEGLIGIBLE_RATE * size_of_rate else 0.0
        return Reach(direction.t, done + work, along)

    def _work_along(self, direction: Direction) -> tuple[float, float]:
        """Derivative of the damage work along a direction, from the gradients of the laws, and what
        it would be if trial tractions changed by r times the largest displacement."""
        size = global_norm(self._comm, direction.u)
        gradients = [
            (before if active.values.update is None else active.work_gradient(self._dt))[
                active.quadrature.kept
            ]
            for active, before in zip(self._pieces.interfaces, self._gradients, strict=True)
        ]
        if limited := self._limited:
            known = zip(gradients, limited, strict=True)
            gradients = [G * points[:, None] for G, points in known]
        largest = max((np.abs(G).max(initial=0.0) for G in gradients), default=0.0)
        if size == 0 or global_max(self._comm, float(largest)) == 0:
            return 0.0, 0.0
        discretization, here, work, size_of_rate = self._discretization, self.place(), 0.0, 0.0
        farthest = global_max(self._comm, float(np.abs(direction.u).max(initial=0.0)))
        straight = discretization.bodies.linear and not self._loading.pressurised
        # If it is exact for any h, a direction is added at the size of the mesh: then rounding
        # depends neither on its length nor on the unit of the load factor.
        h = float(power_of_two(self._size / size)) if straight else INCREMENT * self._size / size
        with timer("rates"):
            interfaces = self._pieces.interfaces
            before = [last_total(active) for active in interfaces]
            self.visit(here.plus(direction, h))
            if bodies := discretization.bodies.points:
                bodies.extrapolate(bodies.deformation(self._problem.u))
            for active, G, q in zip(interfaces, gradients, before, strict=True):
                kept = active.quadrature.kept
                change = np.einsum("pi,pi->p", G, (total_in_frame(active) - q)[kept]) / h
                weights = active.quadrature.weights[kept]
                r = active.stabilization.norm[active.quadrature.facet[kept]]
                work += weights @ change
                size_of_rate += (weights * r) @ np.linalg.norm(G, axis=1) * farthest
            self.visit(here)
            if bodies:
                bodies.take(bodies.state)
        thickness = float(discretization.geometry.thickness)
        return thickness * work, thickness * size_of_rate

    def note_branches(self) -> None:
        """Note on which branches of their return maps points are."""
        self._noted = [active.values.compliance for active in self._branching]

    def branched(self, missed: float) -> bool:
        """Whether points have changed their branch since: r C of one by more than ``missed``."""
        changes = False
        for active, last in zip(self._branching, self._noted, strict=True):
            C, r = active.values.compliance, active.stabilization.norm[active.quadrature.facet]
            # Surfaces that slide may meet at other points.
            same = C.shape == last.shape
            changes |= not same or bool((np.abs(C - last) * r[:, None, None] > missed).any())
        return global_any(self._comm, changes)

    def forces(self) -> Array:
        """Residual on owned dofs, without reactions of supports and rigid faces [N]."""
        forces = self._discretization.forces.x.array[: self._owned].copy()
        if self.parameter.drag:
            forces += self.parameter.drag * self._system.norm * self.moved()
        return self._loading.balance(forces)

    def reaction(self) -> float:
        """Norm of reactions, including those of springs, and of forces on means [N]."""
        discretization, loading = self._discretization, self._loading
        forces = discretization.forces.x.array[: self._owned]
        held = forces - loading.balance(forces.copy())
        if discretization.means is not None:
            dofs = discretization.means.owned_dofs
            held[dofs] = forces[dofs] + loading.vector[dofs]
        return global_norm(self._comm, np.append(held, discretization.surface.spring_forces()))


def force_of(problem: Problem) -> float:
    """Power of the supports by load factor, relative to the norm of their displacement by it, in
    the present state of a ray; 0 where they do not move; collective [N]."""
    loading, comm = problem.loading, problem.comm
    rate = loading.rate()
    size = global_norm(comm, rate)
    forces = problem.discretization.forces.x.array[: len(rate)]
    return float(global_sum(comm, forces @ rate)) / size if size > 0 else 0.0
