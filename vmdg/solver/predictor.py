"""Where the iteration of a step starts."""

from __future__ import annotations

from typing import NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_any, global_max, global_norm
from ..problem.problem import Problem
from .tangent import Tangent

#: States of a path, and the longest step relative to the last one that is extrapolated.
MAX_STATES, MAX_REACH = 3, 4.0


class EquilibriumPath:
    """The states at which the last steps started, as long as they follow each other.

    A step that is cut and tried again starts where it started before. One that starts elsewhere at
    the same parameter has passed an unstable stage: what was before it says nothing of what
    follows.

    Args:
        comm: Ranks that share the displacement.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        self._comm = comm
        self._states: list[tuple[float, NDArray[np.float64]]] = []

    def start(self, t: float, u: NDArray[np.float64]) -> None:
        """A step starts from displacement ``u`` at the path parameter ``t``; collective."""
        if self._states and self._states[-1][0] == t:
            if global_any(self._comm, not np.array_equal(self._states[-1][1], u)):
                self._states = [(t, u.copy())]
            return
        self._states = [*self._states, (t, u.copy())][-MAX_STATES:]

    def ahead(self, t: float) -> list[NDArray[np.float64]]:
        """Displacement at parameter ``t`` by the polynomials through two and three states.

        By Lagrange's formula; none where the path turns back or the step is much longer.
        """
        times = [state[0] for state in self._states]
        if len(times) < 2 or not 0 < (t - times[-1]) / (times[-1] - times[-2]) <= MAX_REACH:
            return []
        steps = np.diff(times)
        most = len(times) if (steps * steps[-1] > 0).all() else 2
        return [self._polynomial(t, count) for count in range(2, most + 1)]

    def _polynomial(self, t: float, count: int) -> NDArray[np.float64]:
        states = self._states[-count:]
        result = np.zeros_like(states[0][1])
        for i, (ti, u) in enumerate(states):
            others = [tj for j, (tj, _) in enumerate(states) if j != i]
            result += np.prod([(t - tj) / (ti - tj) for tj in others]) * u
        return result


#: Along the path of the last states, by the tangent with the damage of the last state, or by the
#: tangent with zeta held.
PATH, TANGENT, ELASTIC = "path", "tangent", "elastic"
PREDICTORS = (PATH, TANGENT, ELASTIC)

#: A tangent with damage that leaves more than this share of the imbalance is compared with one that
#: holds zeta, and a path that leaves more than this is not followed.
MAX_LEFT_BY_DAMAGE, MAX_LEFT_BY_PATH = 1e-2, 0.1

#: Relative tolerance of iterative linear solves, since the predictor is not exact anyway.
PREDICTOR_RTOL = 1e-3


class Norms(NamedTuple):
    """What a predictor found out of balance, norms on the free dofs [N].

    Attributes:
        imbalance: Loads and what prescribed displacements would cause.
        loads: Without the prescribed displacements.
    """

    imbalance: float
    loads: float


class Predictor:
    """Carries the displacement to the loads of a step, as near to equilibrium as is cheap.

    Args:
        problem: The problem.
        tangent: Assembled where a predictor needs it.
        ksp: Solves with it.
    """

    def __init__(
        self,
        problem: Problem,
        tangent: Tangent,
        ksp: PETSc.KSP,
    ):
        self._problem = problem
        self._tangent = tangent
        self._ksp = ksp
        self._x, self._f = tangent.matrix.createVecs()
        self._owned = self._x.getLocalSize()
        self._prescribed = problem.loading.owned_prescribed
        self._dt = 1.0

    def __call__(self, predictor: str, ahead: list[NDArray[np.float64]], dt: float) -> Norms:
        """Change the displacement of the problem; collective.

        The first predictor in the order of :data:`PREDICTORS` that is not poor is taken, or the
        better of the last two.

        Args:
            predictor: The first one to try.
            ahead: Displacements where the path may lead.
            dt: Time step of the return maps [s].

        Returns:
            What was out of balance before, 0 where it was not needed.
        """
        self._dt = dt
        if predictor == PATH and self._follow(ahead):
            return Norms(0.0, 0.0)
        if predictor == ELASTIC or not self._problem.discretization.can_fail:
            return self._solve(damage=False)
        u = self._problem.u.x.array
        start = u.copy()
        norms = self._solve(damage=True)
        left = self._residual_norm()
        # A comparison that also catches NaN.
        if not left <= MAX_LEFT_BY_DAMAGE * norms.imbalance:
            best = u.copy()
            u[:] = start
            self._solve(damage=False)
            if left < self._residual_norm():
                u[:] = best
        return norms

    def _follow(self, ahead: list[NDArray[np.float64]]) -> bool:
        """Go where the path leads, or stay if nothing has moved; without a solve.

        Returns:
            False, and nothing has changed, if this leaves too much of the imbalance.
        """
        problem = self._problem
        u, prescribed = problem.u.x.array, problem.loading.prescribed
        start, target = u.copy(), problem.loading.prescribed_values(problem.t)
        shift = global_max(problem.comm, np.abs(target - u[prescribed]).max(initial=0.0))
        moved = shift > 0 or problem.t != problem.step.start.t
        candidates = ahead if moved else [start, *ahead]
        if not candidates:
            return False
        u[prescribed] = target
        limit = MAX_LEFT_BY_PATH * self._residual_norm(hold=True) if moved else np.finfo(float).max
        left = []
        for candidate in candidates:
            u[:] = candidate
            u[prescribed] = target
            left.append(self._residual_norm())
        best = np.argmin(np.nan_to_num(left, nan=np.inf))
        if not left[best] <= limit:
            u[:] = start
            return False
        u[:] = candidates[best]
        u[prescribed] = target
        return True

    def _residual_norm(self, hold: bool = False) -> float:
        """Norm of the residual on the free dofs at the current displacement [N]."""
        residual = self._problem.step.assemble_residual(self._dt, hold).copy()
        residual[self._prescribed] = 0
        return global_norm(self._problem.comm, residual)

    def _solve(self, damage: bool) -> Norms:
        """u += du with K du = -R, du prescribed where the displacement is."""
        problem, tangent = self._problem, self._tangent
        loads = self._residual_norm(hold=True)
        residual = problem.discretization.forces.x.array[: self._owned]
        tangent.assemble(damage)
        increment = np.zeros(self._owned)
        target = problem.loading.prescribed_values(problem.t)[
            problem.loading.prescribed < self._owned
        ]
        increment[self._prescribed] = target - problem.u.x.array[: self._owned][self._prescribed]
        self._x.array[:] = increment
        tangent.matrix.mult(self._x, self._f)
        self._f.array[:] = -residual - self._f.array_r
        self._f.array[self._prescribed] = 0
        imbalance = self._f.norm()
        self._f.array[self._prescribed] = increment[self._prescribed]
        tangent.constrain()
        self._ksp.setOperators(tangent.matrix)
        self._ksp.setTolerances(rtol=PREDICTOR_RTOL)
        self._ksp.solve(self._f, self._x)
        problem.u.x.array[: self._owned] += self._x.array_r
        problem.u.x.array[: self._owned][self._prescribed] = target
        problem.u.x.scatter_forward()
        return Norms(imbalance, loads)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self._x.destroy()
        self._f.destroy()
