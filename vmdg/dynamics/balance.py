"""Whether a run in time makes energy from nothing."""

from __future__ import annotations

from dataclasses import replace

from ..problem.motion import moving
from ..problem.problem import Problem

#: Energy that a scheme may make, relative to the largest kinetic and stored energy so far.
ALLOWED = 1e-2

#: Reason of a step that makes more.
GAINED = "ENERGY_GAINED"


class Balance:
    """The balance of energies, and what a scheme has made since it last paid it back.

    Kinetic and stored energy grow by no more than the work of loads and supports less what is
    dissipated: with I the imbalance (external + discretization - stored - dissipated - kinetic), no
    step may lower I + b, b what the scheme itself has of the energy. The debt d grows where it
    falls, and is paid back where it rises, but what a scheme dissipates is no credit for later:

        d_1 = max(d_0 + I_0 + b_0 - I_1 - b_1, 0) <= ALLOWED max(kinetic + stored) + w.

    Args:
        problem: The problem, at the start of the run.
    """

    def __init__(self, problem: Problem):
        self._step, self._motion = problem.step, moving(problem.step.motion)
        self._debt = 0.0
        self._last, self._largest = self._measured()

    def _measured(self) -> tuple[float, float]:
        """Imbalance, and kinetic and stored energy; collective [N mm]."""
        energy = self._step.ledger.energy()
        energy = replace(energy, kinetic=self._motion.kinetic_energy())
        return energy.imbalance, energy.kinetic + energy.stored

    def holds(self, change: float = 0.0, work: float = 0.0) -> bool:
        """Whether the current state has no more energy than it may, from which the next one is
        then judged; collective.

        Args:
            change: b_1 - b_0, the same on every rank [N mm].
            work: w, what unbalanced forces may have done, the same on every rank [N mm].
        """
        imbalance, here = self._measured()
        debt = max(self._debt + self._last - imbalance - change, 0.0)
        # Not of what was made.
        largest = max(self._largest, here - debt)
        if not debt <= ALLOWED * largest + work:
            return False
        self._debt, self._last, self._largest = debt, imbalance, largest
        return True
