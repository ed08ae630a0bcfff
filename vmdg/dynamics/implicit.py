"""Implicit steps in time: PETSc SNES on the displacement."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_any, global_norm, global_sum
from ..domain.topology import box_sides
from ..interface.active import meets_or_parts
from ..interface.stabilization import SoftensTooFast
from ..linear.ksp import (
    MAX_RTOL,
    Petsc,
    destroy,
    linear_options,
    linear_tolerance,
    matrix_kind,
    set_options,
)
from ..linear.system import System
from ..problem.ledger import WorkInMotion
from ..problem.motion import moving
from ..problem.problem import Problem
from ..problem.step import cause, forces_at_start
from ..solver.attempt import Attempt
from ..solver.limits import ROUNDING
from ..solver.options import SolveOptions
from ..solver.snes import Snes, rounding_of_forces, verdict
from .balance import GAINED, Balance
from .schemes import AtEnd, GeneralizedAlpha, Newmark
from .supports import SupportMotion, support_work

Array = NDArray[np.float64]

#: Reason to repeat a step by a shorter one.
_INACCURATE = "INACCURATE"

#: Of the step that would just have the given error.
_AIM = 0.9


class ImplicitSteps:
    """Steps of the generalized alpha method, see :class:`.GeneralizedAlpha`.

    Attributes:
        balance: Of the energies; None before the first step.
        taken: Number of steps so far.
    """

    cure = "take shorter steps, by more times or by tolerance=, or rho_inf closer to 1"

    def __init__(
        self,
        problem: Problem,
        scheme: GeneralizedAlpha,
        options: SolveOptions,
        supports: SupportMotion,
    ):
        self._problem, self._scheme, self._options = problem, scheme, options
        self._motion, self._supports, self._comm = (
            moving(problem.step.motion),
            supports,
            problem.comm,
        )
        self._owned, self._motion.lumped = problem.discretization.owned, None
        self._system = System(problem, options.petsc)
        kind = matrix_kind(linear_options(problem, options.petsc).solver)
        self._mass = self._motion.matrix(kind)
        damping, alpha = self._motion.damping, self._motion.damping.rayleigh.alpha
        self._damping: PETSc.Mat | None = None
        if damping.dashpots or alpha:
            self._damping = damping.matrix(kind)
            anything = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
            self._damping.axpy(alpha, self._mass, anything)
        self._rate: PETSc.Mat | None = None
        if damping.rayleigh.beta:
            self._rate = problem.discretization.create_matrix(kind)
        self._size = float(np.linalg.norm(box_sides(problem.mesh)))
        self._snes = Snes(problem.comm, self._owned, options)
        self._forces = 0.0  # the largest at the end of a step so far
        self._norms: list[float] = []
        self._goal, self._rtol, self._dt = 0.0, MAX_RTOL, 0.0
        # With a tolerance: the next step, and the largest change of the displacement.
        self._longest, self._moved = math.inf, 0.0
        self._first = problem.u.x.array[: self._owned].copy()
        self.balance: Balance | None = None
        self.taken = 0

    @property
    def krylov(self) -> int:
        """Krylov iterations so far."""
        return self._system.iterations

    def accelerate(self) -> None:
        """Acceleration of a body that is let go in its current state: M.a = -R; collective."""
        problem, motion, held = self._problem, self._motion, self._problem.loading.owned_prescribed
        problem.step.assemble_residual(hold=True)
        v = motion.velocity.x.array[: self._owned]
        forces = -problem.discretization.forces.x.array[: self._owned] - self._drag(v)
        if problem.discretization.means is not None:
            held = np.union1d(held, problem.discretization.means.owned_rows).astype(np.int32)
        forces[held] = 0
        mass = motion.matrix()
        x, b = mass.createVecs()
        mass.zeroRowsColumnsLocal(held, 1.0)
        ksp = PETSc.KSP().create(problem.comm)
        # A mass matrix is well conditioned.
        options: Petsc = {
            "ksp_type": "cg",
            "pc_type": "jacobi",
            "ksp_rtol": 1e-14,
            "ksp_max_it": 500,
        }
        set_options(ksp, options)
        ksp.setOperators(mass)
        b.array[:] = forces
        ksp.solve(b, x)
        motion.acceleration = x.array.copy()
        destroy(ksp)
        for item in (mass, x, b):
            item.destroy()

    def advance(self, t: float) -> Iterator[Attempt]:
        """Attempts of steps to a time, halved where one fails, until that fails; collective."""
        problem, span = self._problem, t - self._problem.t
        longest, shortest = span, (1 - ROUNDING) * span / 2**self._options.max_cuts
        if self.balance is None:
            self.balance = Balance(problem)
        while problem.t < t and longest >= shortest:
            left = t - problem.t
            # Equal steps rather than a short last one.
            equal = math.ceil((1 - ROUNDING) * left / min(self._longest, left))
            h = min(longest, left / equal)
            end = t if problem.t + (1 + ROUNDING) * h >= t else problem.t + h
            found = self._step(end, h / 2 >= shortest)
            if found.reason == _INACCURATE:
                continue
            self.taken += found.converged
            yield found
            longest = min(2 * longest, span) if found.converged else h / 2

    def _step(self, t: float, shortens: bool) -> Attempt:
        """A step of the scheme, or where that makes energy one with the forces of its end. Only the
        shortest may lose much where surfaces meet or part, and with those forces make what is
        dissipated, up to what the whole run may; collective."""
        found = self._attempt(t, self._scheme, True, shortens)
        return self._attempt(t, AtEnd(), shortens, shortens) if found.reason == GAINED else found

    def _attempt(self, t: float, scheme: Newmark, strict: bool, keeps: bool) -> Attempt:
        """An attempt, committed if it converges and cancelled if not; collective."""
        problem, motion = self._problem, self._motion
        step, owned, held = problem.step, self._owned, problem.loading.owned_prescribed
        h, beta, gamma = t - problem.t, scheme.beta, scheme.gamma
        v0, a0 = motion.velocity.x.array[:owned].copy(), motion.acceleration
        problem.loading.check_finite(t)
        try:
            step.begin(t, h)
        except SoftensTooFast as error:
            return Attempt(False, reason=str(error))
        u0, R0 = step.start.u[:owned], forces_at_start(step)
        self._dt, self._norms = h, []
        # a_1 = (u_1 - away)/(beta h^2), and the equation is divided by 1 - alpha_f. Powers by the
        # library of C are rounded otherwise in another unit of time, products are not.
        self._away = u0 + h * v0 + h * h * (0.5 - beta) * a0
        self._per_length, self._per_speed = 1 / (beta * (h * h)), gamma * h
        self._share = share = 1 - scheme.alpha_f
        self._inertia = (1 - scheme.alpha_m) / share
        drag0 = self._drag(v0)
        forces0 = scheme.alpha_f * (R0 + drag0)
        self._known = (forces0 + scheme.alpha_m * motion.of(a0)) / share
        self._free_speed = v0 + h * (1 - gamma) * a0
        self._system.inertia = [(self._mass, self._inertia * self._per_length)]
        if self._damping is not None:
            self._system.inertia.append((self._damping, self._per_speed * self._per_length))
        if self._rate is not None:
            self._system.inertia.append((self._rate, 1 / share))
        self._moves = self._supports.at(t - h, t, t + h)
        start = u0 + h * v0 + h * h * a0 / 2
        converged, reason = self._snes.solve(self, start)
        word = step.invalid() if converged else cause(step.discretization, reason)
        if not word and not step.stabilization_suffices():
            word = "STABILIZATION_OUTGROWN"
        found = Attempt(not word, self._norms, word, self._goal)
        if word:
            step.cancel()
            return found
        a1 = self._acceleration()
        tolerance = self._scheme.tolerance
        if tolerance is not None and not self._accurate(h, a1 - a0, tolerance):
            step.cancel()
            return replace(found, converged=False, reason=_INACCURATE)
        v1 = self._velocity(a1)
        drag1, rate = self._drag(v1), motion.damping.resist(step.start.u, h)
        weight, change = scheme.work_at_end, (problem.u.x.array - step.start.u)[:owned]
        damped = ((1 - weight) * drag0 + weight * drag1 + rate) @ change
        inertia = motion.of(a1)
        mean = (1 - weight) * motion.of(a0) + weight * inertia
        jump = v1 - v0 - h * ((1 - weight) * a0 + weight * a1)
        works = support_work(held, mean, h * (v0 + v1) / 2, jump, motion.of((v0 + v1) / 2))
        viscous = (drag0 + rate)[held], (drag1 + rate)[held]
        keeps = keeps and global_any(self._comm, self._meets_or_parts())
        step.commit(WorkInMotion(viscous, works, float(damped), weight))
        carried = np.zeros(owned)
        if motion.damping.dashpots:
            carried -= drag1 - motion.damping.rayleigh.alpha * motion.of(v1)
        carried[held] += inertia[held] + viscous[1]
        motion.move(v1, a1, carried)
        work = self._goal * global_norm(self._comm, change)  # of unbalanced forces
        area = self._size * self._size
        self.balance.rounding = float(np.finfo(float).eps) * area * self._system.norm
        if reason := self.balance.fault(0.0, work, strict, keeps):
            step.cancel()
            return found.failed(reason)
        self._forces = max(self._forces, self._loads)
        return found

    def _meets_or_parts(self) -> bool:
        """Whether surfaces meet or part in the step, on this rank."""
        every = self._problem.discretization.active.values()
        return any([meets_or_parts(one) for one in every if one.law.inelastic])

    def _accurate(self, h: float, change: Array, tolerance: float) -> bool:
        """Whether the error of a step is within the tolerance, and the length of the next one;
        collective.
        """
        mass, moved = self._motion.row_sums, self._problem.u.x.array[: self._owned] - self._first
        sums = global_sum(self._comm, [mass @ change**2, mass @ moved**2])
        error, here = np.sqrt(sums)
        self._moved = max(self._moved, float(here))
        # Below the forces that may be left unbalanced at both ends it is rounding.
        told = global_norm(self._comm, self._motion.of(change)) > 2 * self._goal
        error *= abs(self._scheme.beta - 1 / 6) * h * h * told
        ratio = error / (tolerance * self._moved) if self._moved > 0 else 0.0
        # Of third order.
        self._longest = h * min(max(_AIM * ratio ** (-1 / 3) if ratio else np.inf, 0.2), 2.0)
        return bool(ratio <= 1)

    def _acceleration(self) -> Array:
        """a_1 of the iterate, by Newmark's relation; of supports as given."""
        u = self._problem.u.x.array[: self._owned]
        a = (u - self._away) * self._per_length
        a[self._problem.loading.owned_prescribed] = self._moves[1]
        return a

    def _velocity(self, a1: Array) -> Array:
        """v_1 by Newmark's relation; of supports as given."""
        v1 = self._free_speed + self._per_speed * a1
        v1[self._problem.loading.owned_prescribed] = self._moves[0]
        return v1

    def _drag(self, v: Array) -> Array:
        """alpha M.v and forces of dashpots, of owned dofs; collective [N]."""
        if self._damping is None:
            return np.zeros_like(v)
        x, y = self._damping.createVecs()
        x.array[:] = v
        self._damping.mult(x, y)
        return y.array.copy()

    # Called by PETSc, see :class:`.Equations`

    def residual(self, x: Array) -> Array:
        """The equilibrium of mean forces, divided by 1 - alpha_f, on free dofs."""
        problem, u = self._problem, self._problem.u.x
        u.array[: self._owned] = x
        u.scatter_forward()
        u.array[problem.loading.prescribed] = problem.loading.prescribed_values(problem.t)
        R = problem.step.assemble_residual(self._dt)
        a1 = self._acceleration()
        forces = R + self._known + self._inertia * self._motion.of(a1)
        forces += self._drag(self._velocity(a1))
        if self._rate is not None:
            start = self._problem.step.start.u
            # In the middle of the step, so that it is no part of the mean of its ends.
            rate = self._motion.damping.resist(start, self._dt)
            forces += rate / self._share
        self._loads = global_norm(self._comm, R)
        return problem.loading.balance(forces)

    def correction(self, residual: Array) -> Array:
        """By the tangent with inertia and damping."""
        if self._rate is not None:
            self._motion.damping.tangent(self._rate)
        return self._system.solve([residual], [np.zeros_like(residual)], self._rtol)[0]

    def longest(self, start: Array, way: Array) -> tuple[float, bool]:
        return 1.0, True

    def test(self, norm: float) -> int:
        """Converged where forces balance to the tolerance, or to rounding."""
        self._norms.append(norm)
        floor = rounding_of_forces(self._problem, self._size, self._system.norm)
        # Not of trial states that may be far away.
        forces = max(self._forces, self._loads)
        self._goal = max(self._options.relative_tolerance * forces, floor)
        self._rtol = linear_tolerance(self._norms, self._goal)
        return verdict(self._norms, self._goal, True, self._options)

    def free(self) -> None:
        self._system.free()
        self._snes.free()
        for matrix in (self._mass, self._damping, self._rate):
            if matrix is not None:
                matrix.destroy()
