"""Whether a run in time makes energy from nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..problem.motion import moving
from ..problem.problem import Problem

#: Energy that a scheme may make, relative to the largest kinetic and stored energy so far.
ALLOWED = 1e-2

#: Reason of a step that makes more.
GAINED = "ENERGY_GAINED"


class Balance:
    """The balance of energies, and what a scheme has made since it last paid it back.

    Kinetic and stored energy E grow by no more than the work W of loads and supports, tau_s that
    changes included. With b what the scheme itself has of the energy and w what unbalanced forces
    may do, the debt d grows where E - b grows by more than W, and is paid back where it falls, but
    what a scheme dissipates is no credit for later:

        d_1 = max(d_0 + (E - W - b)_1 - (E - W - b)_0, 0) <= ALLOWED max(E) + w.

    A strict balance counts what laws and bodies dissipate as spent. Where pairs of surfaces turn
    that is not the work of their tractions, however short the step, so that it does not end a run.
    """

    def __init__(self, problem: Problem):
        self._step, self._motion = problem.step, moving(problem.step.motion)
        self._debts = np.zeros(2)
        self._last, self._largest = self._measured()

    def _measured(self) -> tuple[NDArray[np.float64], float]:
        """E - W without and with what is dissipated, and E; collective [N mm]."""
        energy = self._step.ledger.energy()
        energy = replace(energy, kinetic=self._motion.kinetic_energy())
        strict = -energy.imbalance
        here = energy.kinetic + energy.stored
        return np.array([strict - energy.dissipated, strict]), here

    def holds(self, change: float = 0.0, work: float = 0.0, strict: bool = False) -> bool:
        """Whether the current state has no more energy than it may, from which the next one is
        then judged; collective.

        Args:
            change: b_1 - b_0, the same on every rank [N mm].
            work: w, the same on every rank [N mm].
        """
        now, here = self._measured()
        debts = np.maximum(self._debts + now - self._last - change, 0.0)
        # Not of what was made.
        largest = max(self._largest, here - debts[0])
        allowed = ALLOWED * largest + work
        if not (debts[: 1 + strict] <= allowed).all():
            return False
        self._debts, self._last, self._largest = np.minimum(debts, allowed), now, largest
        return True
