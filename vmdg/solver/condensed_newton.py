"""Steps of a small-strain problem by Newton's method on the gaps at the interface points alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ..base.timers import timer
from ..problem.problem import Problem
from .condensed_solver import RTOL, CondensedSolver
from .flexibility import Flexibility, Superposition
from .gap_equation import Direction, GapEquation, Gaps
from .iteration import BACKTRACK, ENERGY, FULL, MAX_HALVINGS, Iteration, StepReport, Trace
from .predictor import ELASTIC, MAX_LEFT_BY_DAMAGE, MAX_LEFT_BY_PATH, PATH

#: Share of the reduction of |R|^2/2 by the linear model that backtracking must meet.
ARMIJO = 1e-4

#: Trials of the search for the least energy, share of the work at the start to which it reduces it,
#: and the shortest and longest step of that search.
MAX_TRIALS, ENERGY_RTOL, SHORTEST, LONGEST = 8, 0.1, 1e-12, 1e8


def backtrack(equation: GapEquation, start: Gaps, direction: Direction) -> Gaps:
    """Halve the step until |R|^2 falls by Armijo's rule; the last trial is taken anyway."""
    length = 1.0
    for _ in range(MAX_HALVINGS + 1):
        state = equation.along(start, direction, length)
        # Also with NaN the step is halved.
        if state.norm**2 <= start.norm**2 * (1 - 2 * ARMIJO * length):
            break
        length /= 2
    return state


def full_step(equation: GapEquation, start: Gaps, direction: Direction) -> Gaps:
    """The whole correction."""
    return equation.along(start, direction, 1.0)


def least_energy(equation: GapEquation, start: Gaps, direction: Direction) -> Gaps:
    """Where the residual does no work along the correction, by the secant method.

    Where the slope has the sign of a maximum of the energy it is taken with the other sign, as in
    PETSc's search for critical points.
    """
    before, after = 0.0, 1.0
    first = former = -equation.work(start, direction)
    for _ in range(MAX_TRIALS):
        state = equation.along(start, direction, after)
        now = -equation.work(state, direction)
        if abs(now) < ENERGY_RTOL * abs(first) or abs(after - before) < SHORTEST * after:
            return state
        slope = -abs((now - former) / (after - before))
        change = now / slope if slope != 0 else np.nan
        following = after - change
        if following < SHORTEST:
            following = after + change
        if not np.isfinite(following) or following > LONGEST:
            return state
        before, after, former = after, following, now
    return equation.along(start, direction, after)


SEARCHES = {BACKTRACK: backtrack, FULL: full_step, ENERGY: least_energy}

#: How often the displacement is corrected by what rounding has left of the bodies' balance.
MAX_BODY_CORRECTIONS = 3

#: Imbalance of the bodies that is left to the end of the step, relative to what may be left there.
NEGLIGIBLE = 0.1


@dataclass(frozen=True)
class _Balance:
    """The equilibrium of a step with the gaps held as they were.

    What the step before has left, B^T.rest, is balanced by gap increments of -rest: no solve.

    Attributes:
        u: Displacement without ``rest`` [mm].
        target: Prescribed displacement [mm].
        rest: Gap increments (n,) that are to be taken off those of the step [mm].
        trial: Trial traction (n,) [MPa].
        bonded: Its change by the loads of the step (n,) [MPa].
        reaction: Norm of the reactions [N].
        imbalance: Norm of what was out of balance with the prescribed displacements imposed [N].
        loads: Without them.
        moved: Whether the loads or prescribed displacements have changed.
    """

    u: NDArray[np.float64]
    target: NDArray[np.float64]
    rest: NDArray[np.float64]
    trial: NDArray[np.float64]
    bonded: NDArray[np.float64]
    reaction: float
    imbalance: float
    loads: float
    moved: bool


class CondensedNewton(Iteration):
    """Newton's method on the gap increments of a step, for bodies of constant stiffness.

    Takes the place of :class:`vmdg.solver.newton.Newton`, with the same predictors, searches and
    criteria, and ends every step with a residual of the whole problem: what it hands over has
    converged there. Bodies are neither assembled nor solved for in the iteration.

    Args:
        problem: Of small strain, on one rank, see :mod:`vmdg.solver.features`.
        relative_tolerance: Of the residual, see :class:`vmdg.solver.iteration.Criterion`.
        max_iterations: Corrections before an attempt is given up.
        negligible: Imbalance of the bodies that is left to the end of the step, relative to what
            may be left there.
    """

    def __init__(
        self,
        problem: Problem,
        relative_tolerance: float,
        max_iterations: int,
        negligible: float = NEGLIGIBLE,
    ):
        super().__init__(problem, relative_tolerance, max_iterations)
        self._interfaces = [c for c in problem.discretization.active.values() if c.law.inelastic]
        self.flexibility = Flexibility(problem)
        self._solver = CondensedSolver(self.flexibility)
        norm = self.flexibility.stiffness.norm(PETSc.NormType.NORM_INFINITY)
        self._criterion.floor = self._rounding(norm)
        self._prescribed = problem.loading.prescribed
        self._negligible = negligible
        self._forget()

    def restart(self) -> None:
        """Go on as one that is made for the state of the problem now: the dense matrices stay."""
        self.forget_path()
        self._forget()

    def _forget(self) -> None:
        self._relax = Superposition(self.flexibility.relax)
        self._rest = np.zeros(self.flexibility.size)

    @property
    def krylov(self) -> int:
        """Krylov iterations on systems of the gaps so far; 0 where they are solved directly."""
        return self._solver.iterations

    def _begin(self, start: float, end: float) -> list[NDArray[np.float64]]:
        gap = np.concatenate([active.history.gap.ravel() for active in self._interfaces])
        self._path.start(start, gap)
        self._balance = self._balance_loads()
        return [place - gap for place in self._path.ahead(end)]

    def _balance_loads(self) -> _Balance:
        """Balance the loads of the step with the gaps of its start."""
        problem, flexibility = self._problem, self.flexibility
        u, prescribed = problem.u.x.array, self._prescribed
        residual = problem.step.assemble_residual(self._dt, hold=True)
        trial = np.concatenate([c.values.traction.ravel() for c in self._interfaces])
        target = problem.loading.prescribed_values(problem.t)
        shift = target - u[prescribed]
        with timer("bonded response"):
            free = residual + flexibility.lift(shift)
            free[prescribed] = 0
            loads = free - flexibility.gap_forces(self._rest)
            du = -self._relax(loads, self._negligible * self._criterion.goal(0.0))
            du[prescribed] = shift
            bonded = flexibility.tractions(du) - flexibility.response(self._rest)
            reactions = residual[prescribed] + flexibility.reactions(du)
        return _Balance(
            u + du,
            target,
            self._rest,
            trial + bonded,
            bonded,
            float(np.linalg.norm(reactions)),
            float(np.linalg.norm(free)),
            self._free_norm(residual),
            bool(np.any(shift)) or problem.t != problem.step.start.t,
        )

    def _free_norm(self, forces: NDArray[np.float64]) -> float:
        """Norm on the free dofs [N]."""
        forces = forces.copy()
        forces[self._prescribed] = 0
        return float(np.linalg.norm(forces))

    def _attempt(self, search: str, ahead: list[NDArray[np.float64]], predictor: str) -> StepReport:
        balance, trace = self._balance, Trace(self.krylov)
        equation = self._equation(balance)
        with timer("predictor"):
            gaps = self._predict(equation, balance, ahead, predictor)
        goal = self._criterion.goal(balance.reaction)
        for _ in range(MAX_BODY_CORRECTIONS):
            gaps, failure = self._iterate(equation, gaps, search, goal, trace)
            if failure:
                return trace.report(False, failure, goal)
            trace.norms[-1], reaction = self._finish(balance, gaps)
            goal = self._criterion.goal(reaction)
            if trace.norms[-1] <= goal:
                self._criterion.update(reaction=reaction)
                self._rest = gaps.excess
                return trace.report(True, "CONVERGED_FNORM_RELATIVE", goal)
            balance = self._refined(balance, gaps)
            equation = self._equation(balance)
            gaps = equation.start(gaps.value)
        return trace.report(False, "CONDENSATION_LOST", goal)

    def _equation(self, balance: _Balance) -> GapEquation:
        return GapEquation(
            self.flexibility, self._solver, self._interfaces, balance.trial, self._dt
        )

    def _predict(
        self, equation: GapEquation, balance: _Balance, ahead: list[NDArray], predictor: str
    ) -> Gaps:
        """Where the iteration starts, as :class:`vmdg.solver.predictor.Predictor` says."""
        still = np.zeros(self.flexibility.size)
        if predictor == PATH:
            places = ahead if balance.moved else [still, *ahead]
            states = [equation.start(place) for place in places]
            limit = MAX_LEFT_BY_PATH * balance.imbalance if balance.moved else np.inf
            # A comparison that also leaves out NaN.
            states = [state for state in states if state.norm <= limit]
            if states:
                return min(states, key=lambda state: state.norm)
        self._criterion.update(balance.imbalance, balance.loads)
        elastic = equation.start(still)
        if predictor == ELASTIC or elastic.norm == 0:
            return elastic
        compliance = np.concatenate([active.values.compliance for active in self._interfaces])
        bonded = balance.bonded.reshape(len(compliance), -1)
        grown = np.einsum("pij,pj->pi", compliance, bonded).ravel()
        damaged = equation.start(equation.solve(compliance, grown).value)
        good = damaged.norm <= MAX_LEFT_BY_DAMAGE * balance.imbalance or damaged.norm < elastic.norm
        return damaged if good else elastic

    def _iterate(
        self,
        equation: GapEquation,
        gaps: Gaps,
        search: str,
        goal: float,
        trace: Trace,
    ) -> tuple[Gaps, str]:
        """Newton's method to a residual norm; norms join the trace, why it failed is returned."""
        start, seen = len(trace.norms), equation.evaluations
        for iteration in range(self._max_iterations + 1):
            trials, seen = equation.evaluations - seen, equation.evaluations
            trace.note(gaps.norm, trials, self.krylov, RTOL)
            if not np.isfinite(gaps.norm):
                return gaps, "DIVERGED_FNORM_NAN"
            if gaps.norm <= goal:
                return gaps, ""
            if failure := self._diverged(search, trace.norms[start:], trials):
                return gaps, failure
            if iteration < self._max_iterations:
                try:
                    direction = equation.correction(gaps)
                except np.linalg.LinAlgError:
                    return gaps, "DIVERGED_LINEAR_SOLVE"
                gaps = SEARCHES[search](equation, gaps, direction)
        return gaps, "DIVERGED_MAX_IT"

    def _finish(self, balance: _Balance, gaps: Gaps) -> tuple[float, float]:
        """Give the problem this state; norms of its residual and of its reactions [N]."""
        problem = self._problem
        with timer("recover displacement"):
            du = self.flexibility.relax(self.flexibility.gap_forces(gaps.value - balance.rest))
        problem.u.x.array[:] = balance.u + du
        # Without rounding, or the next step would find them moved.
        problem.u.x.array[self._prescribed] = balance.target
        problem.step.assemble_residual(self._dt)
        forces = problem.discretization.forces.x.array
        return self._free_norm(forces), float(np.linalg.norm(forces[self._prescribed]))

    def _refined(self, balance: _Balance, gaps: Gaps) -> _Balance:
        """Without what the last residual has besides that of the gaps: rounding of the bodies."""
        lost = self._problem.discretization.forces.x.array - self.flexibility.gap_forces(
            gaps.excess
        )
        du = self.flexibility.relax(-lost)
        return replace(
            balance, u=balance.u + du, trial=balance.trial + self.flexibility.tractions(du)
        )

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self._solver.destroy()
        self.flexibility.destroy()
