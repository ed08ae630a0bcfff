"""Energy balance of a run: work of loads and dissipation, accumulated over its steps.

Stored energy depends on the state alone, but the work of loads on the path to it, so every step is
recorded. The integrals are those of :mod:`.work`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..assembly.discretization import Discretization
from ..assembly.space import at_owners
from ..base.parallel import global_any, global_sum
from ..interface.active import traction_in_frame
from ..interface.gap_work import gap_force, gap_forces, gap_work
from .loading import Loading
from .states import Energy, Pending, Snapshot, Works
from .work import chord_integral, next_increment

#: Fraction of a step for differences of the energy by the eigenstrains, of third order: rounding of
#: the energy, divided by it, is to stay below the error of Newton's method.
SMALL = 0.1

#: Fraction of the time step in which bodies whose stress depends on it hardly flow.
SUDDEN = 1e-12


class WorkInMotion(NamedTuple):
    """What motion adds to the works of a step in time."""

    # Viscous forces on owned prescribed dofs at the start and at the end [N]
    viscous: tuple[NDArray[np.float64], NDArray[np.float64]]
    inertial: float  # This rank's work of supports on the mass of their nodes [N mm]
    damped: float  # This rank's work of viscous forces [N mm]
    share: float = 0.5  # Weight of the end of the step in the other works of loads and supports


class _Forces(NamedTuple):
    """Internal forces, the derivative of the energy of bodies and interfaces."""

    residual: NDArray[np.float64]  # Forces on displacements minus loads, owned dofs [N]
    loads: NDArray[np.float64]  # Over local dofs [N]
    at_gaps: NDArray[np.float64]  # Forces -T dA on zeta (n,) [N; N/mm in plane strain]


@dataclass
class _Start:
    """Start and type of a step."""

    state: Snapshot
    loads: NDArray[np.float64]  # Over local dofs [N]
    fluids: tuple[NDArray[np.float64], NDArray[np.float64]]
    dt: float  # Time step [s]
    slowed: bool
    cycles: float
    added: float = 0.0  # Energy added by its tau_s [N mm]
    rate: float = 0.0  # Derivative of the energy by the eigenstrains [N mm]
    forces: _Forces | None = None


class Ledger:
    """Works in the steps of a problem."""

    def __init__(self, discretization: Discretization, loading: Loading):
        self.discretization, self._loading = discretization, loading
        self._comm = discretization.mesh.comm
        self.works = Works(np.zeros(3), np.zeros(2))
        self._start: _Start | None = None

    # The course of a step

    def settle(self) -> None:
        self.works = replace(self.works, pending=None)

    def begin(self, state: Snapshot, dt: float, slowed: bool, cycles: float) -> None:
        loads, fluids = self._loading.vector, self._fluids()
        self._start = _Start(state, loads, fluids, dt, slowed, cycles)

    def set_out(self, added: float, t: float) -> None:
        """Record the energy added by the tau_s of the step [N mm] and its target load factor;
        collective."""
        self._start.added = added
        self._start.rate = self._eigenstrain_rate(self._loading.t, t)

    def record_start(self) -> None:
        """Record the last residual as that at the start of the step, with its tau_s and loads."""
        now = self.discretization
        if now.bodies.hyperelastic:
            residual = now.forces.x.array[: now.owned].copy()
            self._start.forces = _Forces(residual, self._loading.vector, self._gap_forces())

    def commit(self, motion: WorkInMotion | None = None) -> None:
        """Record the step at its current state; collective."""
        for active in self.discretization.active.values():
            active.settle()
        if motion is None:
            work, charged, within = self._external_work()
            added = self._start.added + self._relaxed()
        else:
            charged = np.array([0.0, 0.0, motion.damped])
            work, within = self._work_in_motion(motion), 0.0
            added = self._start.added
        self._enter((work, added), self.dissipation() + charged)
        plastic = self.works.plastic
        if bodies := self.discretization.bodies.points:
            plastic += bodies.dissipation()
        self.works = replace(self.works, within=within, plastic=plastic)

    def complete(self, allowed: float = 0.0) -> None:
        """Compute the pending work of the last step, at its end; a curvature term that is estimated
        to be no larger than ``allowed`` stays as it is [N mm]; collective."""
        pending = self.works.pending
        if pending is None or 0 < abs(pending.entered) <= allowed:
            return
        change = self.discretization.u.x.array - pending.start.u
        if not global_any(self._comm, not np.array_equal(change, pending.change[0])):
            self._enter_curvature(self._curvature(pending) - pending.entered, pending.at_rest)
        self.settle()

    def works_beside(
        self, start: Snapshot, loads: NDArray[np.float64], before: Works, finish: bool
    ) -> Works:
        """Works of the step for the current state if it had begun in another state, with other
        works and loads, local dofs [N]; the ledger is left as it was; collective."""
        begun, works = self._start, self.works
        self._start = replace(begun, state=start, loads=loads, forces=None)
        self.works = before
        self.commit()
        if finish:
            self.complete()
        found, self._start, self.works = self.works, begun, works
        return found

    @property
    def begun(self) -> tuple[Snapshot, NDArray[np.float64]]:
        """State and loads, local dofs [N], at the start of the step."""
        return self._start.state, self._start.loads

    def energy(self, anew: bool = False) -> Energy:
        """Energies at the current state, with works as recorded; ``anew`` if what materials are
        made of may have changed since the last residual; collective."""
        bulk, interface, springs = self.discretization.stored_energy(anew)
        done = *self.works.dissipated, *self.works.external
        values = [bulk, interface, *done, springs, self.works.plastic]
        return Energy(*(float(value) for value in global_sum(self._comm, values)))

    def _enter(self, external: Sequence[float], dissipated: NDArray[np.float64]) -> None:
        works = self.works
        self.works = replace(
            works,
            dissipated=works.dissipated + dissipated,
            external=works.external + external,
        )

    def _enter_curvature(self, more: float, at_rest: bool) -> None:
        """Record the curvature term of a step, on the first rank."""
        more *= self._comm.rank == 0
        # Constant loads do no work: the viscous work is reduced by it.
        spent = np.array([0.0, 0.0, -more * at_rest])
        self._enter((more * (not at_rest), 0.0), spent)

    def dissipation(self) -> NDArray[np.float64]:
        """Damage, friction and viscous work of the step (3,), this rank's [N mm]."""
        works = [active.works() for active in self.discretization.active.values()]
        return float(self.discretization.geometry.thickness) * sum(works, start=np.zeros(3))

    # Entries other than steps

    def begin_path(self) -> None:
        self.works = replace(self.works, increment=None, pending=None)

    def change_space(self, discretization: Discretization) -> None:
        self.discretization = discretization
        self.begin_path()

    def enter_opening(self, added: float) -> None:
        """Record this rank's energy added by opened facets [N mm]."""
        self._enter((0.0, added), np.zeros(3))

    def keep_loads_constant(self, since: Snapshot) -> None:
        """Replace the work of loads since a state at this load factor by that at constant load.

        The path there passed other load factors, which a machine would not record.
        """
        now, works = self.discretization, self.works
        if since.t != self._loading.t or since.discretization is not now:
            return
        change = (now.u.x.array - since.u)[: now.owned]
        work = since.works.external[0] + at_owners(now.space, self._loading.vector) @ change
        self.works = replace(works, external=np.array([work, works.external[1]]))

    def enter_start(self, energy: float) -> None:
        """Record energy with which a run in time starts; `energy` of all ranks [N mm]."""
        self._enter((energy * (self._comm.rank == 0), 0.0), np.zeros(3))

    def release(self, energy: float) -> None:
        """Add the energy released by a jump to the viscous work; `energy` of all ranks [N mm]."""
        self._enter((0.0, 0.0), np.array([0.0, 0.0, energy * (self._comm.rank == 0)]))

    # Works of a step

    def _external_work(self) -> tuple[float, NDArray[np.float64], float]:
        """Work of prescribed displacements, dead loads and eigenstrains in the step, the excess of
        damage, friction and viscous work of its parts over the whole (3,), this rank's [N mm]; and
        ``within`` of :class:`.Works`.

        The curvature term of the step is recorded here, as predicted by two steps.
        """
        now, begun, start = self.discretization, self._start, self._start.state
        owned, prescribed = slice(now.owned), self._loading.owned_prescribed
        if self._loading.rigid:
            prescribed = np.concatenate([prescribed, self._loading.rigid.driven_dofs])
        ends = []
        for vector, forces in (
            (begun.loads, start.forces),
            (self._loading.vector, now.forces.x.array),
        ):
            ends.append(at_owners(now.space, vector))
            ends[-1][prescribed] += forces[prescribed]
        change = (now.u.x.array - start.u)[owned]
        if now.surface.fluids:
            fluids = begun.fluids, self._fluids()
            ends = [np.append(end, p) for end, (p, _) in zip(ends, fluids, strict=True)]
            change = np.append(change, fluids[1][1] - fluids[0][1])
        # With the forces -T on zeta these are the derivative of an energy, whose work is path
        # independent. That of T depends on where in the step points begin to yield. Cycles degrade
        # a bond at constant load.
        thickness = float(now.geometry.thickness)
        work, straight, more = 0.0, 0.0, np.zeros(3)
        held = begun.slowed or begun.cycles > 0 or self._loading.t == start.t
        for active in now.active.values():
            *forces, gap = gap_forces(active)
            ends = [np.append(end, thickness * f) for end, f in zip(ends, forces, strict=True)]
            change = np.append(change, gap)
            done, charged = gap_work(active, begun.dt, held)
            work += thickness * done
            more += thickness * charged
            straight -= thickness * float(sum(forces) @ gap) / 2
        # Eigenstrains act as a force on the load factor, the derivative of the energy by t.
        rates = begun.rate, self._eigenstrain_rate(self._loading.t, start.t)
        ends = [np.append(end, rate) for end, rate in zip(ends, rates, strict=True)]
        led = any(rates) and self._comm.rank == 0
        change = np.append(change, (self._loading.t - start.t) * led)
        slopes = [float(end @ change) for end in ends]
        mean = sum(slopes) / 2
        rated = any(active.law.viscosity > 0 for active in now.active.values())
        at_rest = rated and held and not begun.slowed and begun.cycles == 0
        # Surfaces that slide have other pairs, and so another energy, at the start of each step.
        kept = not now.surface.fluids and not now.slides
        if (at_rest or not held) and now.bodies.hyperelastic and kept:
            so_far, last = self.works.external[0] + mean + work, self.works.increment
            forces, lengths = ends[1] - ends[0], len(change) - 1
            increment, curved, told = next_increment(
                self._comm, last, forces, change, so_far, lengths
            )
            gap = change[now.owned : -1]
            pending = None if told else self._pending(slopes, gap, curved, at_rest)
            self.works = replace(self.works, increment=increment, pending=pending)
            self._enter_curvature(curved, at_rest)
        return mean + work, more, work - straight - float(more[1])

    def _work_in_motion(self, motion: WorkInMotion) -> float:
        """Work of loads, eigenstrains and supports in a step in time, by the trapezoidal rule, or
        of their values at its end (share=1); this rank's [N mm]."""
        now, begun, start = self.discretization, self._start, self._start.state
        prescribed, change = self._loading.owned_prescribed, now.u.x.array - start.u
        # The parts of the loads that this rank has assembled.
        share, before = motion.share, 1 - motion.share
        work = before * (begun.loads @ change) + share * (self._loading.vector @ change)
        work += motion.inertial
        if len(prescribed):
            forces = before * (start.forces[prescribed] + motion.viscous[0])
            forces += share * (now.forces.x.array[prescribed] + motion.viscous[1])
            work += forces @ change[prescribed]
        rate = before * begun.rate + share * self._eigenstrain_rate(self._loading.t, start.t)
        return float(work + rate * (self._loading.t - start.t) * (self._comm.rank == 0))

    def _pending(
        self, slopes: Sequence[float], gap: NDArray[np.float64], entered: float, at_rest: bool
    ) -> Pending:
        """Data to compute the curvature of the step: phi at start and end from the loads, this
        rank's [N mm], and d zeta, flat [mm]."""
        start, forces, t = self._start.state, self._start.forces, self._loading.t
        change = self.discretization.u.x.array - start.u, gap
        before = first = slopes[0] + 2 * self._relaxed()
        # The predictor has the forces at the start with tau_s of the step, but not for the
        # eigenstrains there.
        if forces is not None and not self._loading.strained(start.t, t):
            first = self._slope(forces, change)
        return Pending(start, change, (before, first, slopes[1]), entered, at_rest)

    def _slope(self, forces: _Forces, change: tuple[NDArray, NDArray]) -> float:
        """phi without eigenstrains, this rank's [N mm]."""
        u, gap = change
        at_gaps = float(self.discretization.geometry.thickness) * forces.at_gaps @ gap
        return float(forces.residual @ u[: self.discretization.owned] + forces.loads @ u + at_gaps)

    def _curvature(self, pending: Pending) -> float:
        """Error of the trapezoidal rule in the first integral of :mod:`.work`, the same on every
        rank [N mm]; collective."""
        now, start, t = self.discretization, pending.start, self._loading.t
        u, residual = now.u.x.array.copy(), now.forces.x.array.copy()
        values = [active.values for active in now.active.values()]
        change, span = pending.change[0], t - start.t
        strains = self._loading.strained(start.t, t)

        def between(share: float) -> float:
            here, rate = start.t + share * span, 0.0
            now.u.x.array[:] = start.u + share * change
            now.update_means()
            if strains:
                self._loading.strain(here)
            for active, begun, end in zip(
                now.active.values(), start.interfaces, values, strict=True
            ):
                active.go_between(begun.history, end, share)
            forces = _Forces(now.assemble_residual(None), np.zeros_like(change), self._gap_forces())
            if strains:
                rate = self._eigenstrain_rate(here, t) * span
            slope = self._slope(forces, pending.change) + rate * (self._comm.rank == 0)
            return float(global_sum(self._comm, slope))

        before, first, last = global_sum(self._comm, pending.slopes)
        whole = chord_integral(first, last, between, self.works.increment.work)
        now.u.x.array[:] = u
        if strains:
            self._loading.strain(t)
        for active, end in zip(now.active.values(), values, strict=True):
            active.take(end)
        now.update_means(pressure=True)
        now.forces.x.array[:] = residual
        return float(whole - (before + last) / 2)

    def _gap_forces(self) -> NDArray[np.float64]:
        """-T dA of all interfaces at the last residual, in the frames of their laws."""
        failing = (a for a in self.discretization.active.values() if a.law.inelastic)
        return _joined(gap_force(active, traction_in_frame(active.values)) for active in failing)

    def _relaxed(self) -> float:
        """Work of the unbalanced forces after facets have opened, this rank's [N mm]."""
        start, owned = self._start.state, slice(self.discretization.owned)
        forces = self._loading.balance(start.forces[owned].copy())
        return float(forces @ (self.discretization.u.x.array - start.u)[owned]) / 2

    def _fluids(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Fluid pressures times areas [N], and the volume difference :meth:`.Fluid.intrusion` [mm],
        at points."""
        forces, lost = [], []
        thickness = float(self.discretization.geometry.thickness)
        for active in self.discretization.surface.fluids:
            weights = active.quadrature.weights
            p = active.fluid.pressure.x.array[: len(weights)]
            forces.append(thickness * weights * p)
            lost.append(-active.fluid.intrusion(active.values, active.stabilization))
        return _joined(forces), _joined(lost)

    def _eigenstrain_rate(self, now: float, t: float) -> float:
        """Derivative of the stored energy by the eigenstrains at the current displacement, from
        load factor ``now``, to which they are reset, towards ``t``, or along the ray; collective [N
        mm].

        That of bodies at points from their last state on, at constant F: dW/dF_s : dF_s/dt with
        W = stored + dissipated, whose derivative is that at constant history.
        """
        loading, ray = self._loading, self._loading.ray
        t = t if ray is None else now + ray.end - ray.start
        if not loading.strained(now, t):
            return 0.0
        h, energies = SMALL * (t - now), []
        bodies = self.discretization.bodies.points
        state = bodies and bodies.state
        for factor in (now + h, now + 2 * h, now + 3 * h, now):
            loading.strain(factor)
            if bodies:
                bodies.take(bodies.strained(state, SUDDEN * self._start.dt))
            energies.append(self.discretization.stored_energy(anew=True).sum())
        if bodies:
            bodies.take(state)
        one, two, three, here = global_sum(self._comm, energies)
        return float(18 * one - 9 * two + 2 * three - 11 * here) / (6 * h)


def _joined(arrays: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.concatenate([np.zeros(0), *arrays])
