"""Whether a run in time makes energy from nothing, or loses it where bodies meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import warn_together
from ..problem.motion import moving
from ..problem.problem import Problem

#: Energy that a scheme may make, or lose where surfaces meet or part, relative to the largest
#: kinetic and stored energy so far.
ALLOWED = 1e-2

#: Reasons of a step that makes more, and of one that loses more.
GAINED, LOST = "ENERGY_GAINED", "ENERGY_LOST"

#: Imbalance that a run may have without a word, relative to the same.
SILENT = 5e-2


class Balance:
    """The balance of energies, and what a scheme has made since it last paid it back.

    Kinetic and stored energy E grow by no more than the work W of loads and supports, tau_s that
    changes included. With b what the scheme itself has of the energy and w what unbalanced forces
    may do, the debt d grows where E - b grows by more than W, and is paid back where it falls, but
    what a scheme dissipates is no credit for later:

        d_1 = max(d_0 + (E - W - b)_1 - (E - W - b)_0, 0) <= ALLOWED max(E) + w + w_r

    with the rounding w_r of energies of bodies as stiff as they are.

    A strict balance counts what laws and bodies dissipate as spent. Where pairs of surfaces turn
    that is not the work of their tractions, however short the step, so that only the imbalance of
    the whole run ends it, what it has lost before included, if that is below -ALLOWED max(E).

    Nor may a step lose as much in which surfaces meet or part:

        (E - W - b)_0 - (E - W - b)_1 <= ALLOWED max(E) + w + w_r.

    A force that acts at one end of a step only does its work along a chord on which the surfaces
    were mostly apart: of a disc of weight N and radius R that rolls by the angle theta in a step
    N R theta^2/2 where they meet, which is given back where they part if the force is the same. So
    a step is too long for its impact; a scheme that damps waves is not looked at.

    Attributes:
        imbalance: Of the energies in the steps so far [N mm].
        largest: The largest kinetic and stored energy so far [N mm].
        rounding: w_r [N mm].
    """

    def __init__(self, problem: Problem):
        self._step, self._motion = problem.step, moving(problem.step.motion)
        self._debts, self.imbalance, self.rounding = np.zeros(2), 0.0, 0.0
        self._last, self.largest = self._measured()

    def _measured(self) -> tuple[NDArray[np.float64], float]:
        """E - W without and with what is dissipated, and E; collective [N mm]."""
        energy = self._step.ledger.energy()
        energy = replace(energy, kinetic=self._motion.kinetic_energy())
        strict = -energy.imbalance
        here = energy.kinetic + energy.stored
        return np.array([strict - energy.dissipated, strict]), here

    def fault(
        self,
        change: float = 0.0,
        work: float = 0.0,
        strict: bool | None = None,
        keeps: bool = False,
    ) -> str:
        """Why the current state cannot have the energy that it has, GAINED or LOST; empty if it
        can, and then the next one is judged from it; collective.

        Args:
            change: b_1 - b_0, the same on every rank [N mm].
            work: w, the same on every rank [N mm].
            strict: Whether dissipation is spent in each step, or in the whole run; None for not.
            keeps: Whether the step may not lose more than ALLOWED.
        """
        now, here = self._measured()
        debts = np.maximum(self._debts + now - self._last - change, 0.0)
        # Not of what was made.
        largest = max(self.largest, here - debts[0])
        allowed = ALLOWED * largest + work + self.rounding
        made = now[1] - self._last[1] - self.imbalance if strict is False else 0.0
        if not (np.append(debts[: 1 + bool(strict)], made) <= allowed).all():
            return GAINED
        if keeps and self._last[1] + change - now[1] > allowed:
            return LOST
        self.imbalance -= float(now[1] - self._last[1])
        self._debts, self._last, self.largest = np.minimum(debts, allowed), now, largest
        return ""


class Losses:
    """Warns of a run in time whose steps lose or make much energy, once."""

    def __init__(self, problem: Problem, cure: str):
        self._problem, self._cure, self._told = problem, cure, False
        self._balance: Balance | None = None
        self._earlier = 0.0

    def look(self, balance: Balance) -> None:
        """At the energies of a row, those of the steps since the last checkpoint among them;
        collective."""
        if self._balance not in (None, balance):
            self._earlier += self._balance.imbalance
        self._balance, total = balance, self._earlier + balance.imbalance
        if self._told or not abs(total) > SILENT * balance.largest + balance.rounding:
            return
        self._told, share = True, abs(total) / (balance.largest or 1.0)
        warn_together(
            self._problem.comm,
            f"solve_dynamics: up to {self._problem.t:.8g} s the steps have "
            f"{'lost' if total > 0 else 'made'} {share:.1%} of the energy in motion, the imbalance "
            f"of energies: {self._cure}",
        )
