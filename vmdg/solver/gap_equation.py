"""The equations of a step condensed to the interface points: the gap increments there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base.timers import timer
from ..interface.active import ActiveInterface
from .condensed_solver import CondensedSolver
from .flexibility import Flexibility

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Gaps:
    """Gap increments of a step and what follows from them.

    Attributes:
        value: Gap increments dzeta (n,) [mm].
        response: Change of the trial traction by them (n,) [MPa].
        excess: dzeta less what the return maps make of that trial traction (n,) [mm].
        forces: The residual (27) of the bodies, B^T.excess on the dofs at the interfaces [N].
        norm: Its norm [N].
        compliance: d zeta/dT of the return maps (number of points, d, d) [mm3/N].
    """

    value: Array
    response: Array
    excess: Array
    forces: Array
    norm: float
    compliance: Array


@dataclass(frozen=True)
class Direction:
    """A change of the gap increments and of what they cause."""

    value: Array
    response: Array


class GapEquation:
    """dzeta = Z(T_0 + W^-1.S.dzeta): the gap increments that the return maps confirm.

    T_0 is the trial traction with the gaps held at the start of the step, Z the return maps. With
    u = u_0 + K^-1.B^T.dzeta, everything but the interfaces is in equilibrium (see
    :class:`vmdg.solver.flexibility.Flexibility`) and the residual (27) is

        R = B^T.(dzeta - Z(T)).

    Newton's method on it, (I - C.W^-1.S).ddzeta = Z(T) - dzeta with C = dZ/dT, takes the same steps
    in u as on (27): static condensation. Points without damage in the step have no row.

    Args:
        flexibility: Gives S.
        solver: Solves Newton's equations.
        interfaces: Interfaces that can fail, in the order of the points.
        trial: T_0 (n,) [MPa].
        dt: Time step of the return maps [s].

    Attributes:
        evaluations: How often the return maps were asked.
    """

    def __init__(
        self,
        flexibility: Flexibility,
        solver: CondensedSolver,
        interfaces: Sequence[ActiveInterface],
        trial: Array,
        dt: float,
    ):
        self._flexibility = flexibility
        self._solver = solver
        self._interfaces = interfaces
        self._trial = trial
        self._dt = dt
        self.evaluations = 0
        counts = [len(active.quadrature.weights) for active in interfaces]
        self._ends = np.cumsum(counts)[:-1]

    def start(self, value: Array) -> Gaps:
        """The state with these gap increments."""
        return self.evaluate(value, self._flexibility.response(value))

    def evaluate(self, value: Array, response: Array) -> Gaps:
        """Return maps on the trial traction that ``response`` leads to."""
        self.evaluations += 1
        with timer("return map"):
            trial = (self._trial + response).reshape(-1, self._interfaces[0].quadrature.d)
            updates = [
                active.map_back(part, self._dt)
                for active, part in zip(self._interfaces, np.split(trial, self._ends), strict=True)
            ]
            grown = [
                (update.gap - active.history.gap).ravel()
                for active, update in zip(self._interfaces, updates, strict=True)
            ]
        excess = value - np.concatenate(grown)
        forces = self._flexibility.unbalanced(excess)
        tangent = np.concatenate([update.tangent for update in updates])
        norm = float(np.sqrt(forces @ forces))
        return Gaps(value, response, excess, forces, norm, tangent)

    def along(self, gaps: Gaps, direction: Direction, length: float) -> Gaps:
        """The state ``length`` times ``direction`` further; the response is linear."""
        value = gaps.value + length * direction.value
        return self.evaluate(value, gaps.response + length * direction.response)

    def work(self, gaps: Gaps, direction: Direction) -> float:
        """Work R.du of the residual along a direction [N mm]; B.du is its response times W."""
        return float(gaps.excess @ (self._flexibility.areas * direction.response))

    def correction(self, gaps: Gaps) -> Direction:
        """Newton's correction."""
        return self.solve(gaps.compliance, -gaps.excess)

    def solve(self, compliance: Array, right: Array) -> Direction:
        """x with (I - C.W^-1.S).x = right.

        Args:
            compliance: C (number of points, d, d) [mm3/N].
            right: (n,) [mm].

        Raises:
            np.linalg.LinAlgError: the matrix is singular.
        """
        with timer("condensed solve"):
            return Direction(*self._solver.solve(compliance, right))
