"""The ledger of a run: what loads have done and what was spent, written beside its steps.

What is stored is a matter of a state; what loads have done is one of the way to it, so that every
step is entered. The integrals are those of :mod:`.work`.
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
from ..interface.gap_work import gap_force, gap_forces, gap_work
from .loading import Loading
from .states import Energy, Pending, Snapshot, Works
from .work import chord_integral, next_arc

#: Share of a step over which the change of the energy with the eigenstrains is taken.
SMALL = 1e-2


class _Forces(NamedTuple):
    """Internal forces, the derivative of the energy of bodies and interfaces.

    Attributes:
        residual: On displacements, less the loads, owned dofs [N].
        loads: Over local dofs [N].
        at_gaps: -T dA, on zeta (n,) [N; N/mm in plane strain].
    """

    residual: NDArray[np.float64]
    loads: NDArray[np.float64]
    at_gaps: NDArray[np.float64]


@dataclass
class _Start:
    """Where a step has begun, and how it goes.

    Attributes:
        state: The converged state.
        loads: Over local dofs [N].
        fluids: Pressures and gaps, see :meth:`Ledger._fluids`.
        dt: Time step [s].
        slowed: Whether by an overstress.
        cycles: Of the load.
        added: Energy by its tau_s [N mm].
        rate: Of the energy with the eigenstrains [N mm].
        forces: With its tau_s and its loads, where they are known.
    """

    state: Snapshot
    loads: NDArray[np.float64]
    fluids: tuple[NDArray[np.float64], NDArray[np.float64]]
    dt: float
    slowed: bool
    cycles: float
    added: float = 0.0
    rate: float = 0.0
    forces: _Forces | None = None


class Ledger:
    """Works of the steps of a problem.

    Args:
        discretization: Of the facets that are open.
        loading: Loads and prescribed displacements.

    Attributes:
        discretization: As above.
        works: So far.
    """

    def __init__(self, discretization: Discretization, loading: Loading):
        self.discretization, self._loading = discretization, loading
        self._comm = discretization.mesh.comm
        self.works = Works(np.zeros(3), np.zeros(2))
        self._start: _Start | None = None

    # The course of a step

    def settle(self) -> None:
        """What is pending stays as it is entered."""
        self.works = replace(self.works, pending=None)

    def begin(self, state: Snapshot, dt: float, slowed: bool, cycles: float) -> None:
        """A step sets out from a converged state."""
        loads, fluids = self._loading.vector, self._fluids()
        self._start = _Start(state, loads, fluids, dt, slowed, cycles)

    def set_out(self, added: float, t: float) -> None:
        """It has taken its tau_s, which has added an energy [N mm], and is to go to a load factor;
        collective."""
        self._start.added = added
        self._start.rate = self._eigenstrain_rate(self._loading.t, t)

    def hold(self) -> None:
        """The last residual is that at its start, with its tau_s and its loads."""
        now = self.discretization
        if not now.bodies.small:
            residual = now.forces.x.array[: now.owned].copy()
            self._start.forces = _Forces(residual, self._loading.vector, self._gap_forces())

    def commit(self) -> None:
        """Enter the step as it is now; collective."""
        work, charged, within = self._external_work()
        done = work, self._start.added + self._relaxed()
        self._enter(done, self.dissipation() + charged)
        self.works = replace(self.works, within=within)

    def complete(self) -> None:
        """Find what is pending of the last step, at whose end the problem is; collective."""
        pending = self.works.pending
        if pending is None:
            return
        change = self.discretization.u.x.array - pending.start.u
        if not global_any(self._comm, not np.array_equal(change, pending.change[0])):
            self._enter_curvature(self._curvature(pending) - pending.entered, pending.at_rest)
        self.settle()

    def energy(self) -> Energy:
        """Energies at the current state, with works as they are entered; collective."""
        bulk, interface, springs = self.discretization.stored_energy()
        done = *self.works.dissipated, *self.works.external
        values = [bulk, interface, *done, springs]
        return Energy(*(float(value) for value in global_sum(self._comm, values)))

    def _enter(self, external: Sequence[float], dissipated: NDArray[np.float64]) -> None:
        """Enter works, this rank's."""
        works = self.works
        self.works = replace(
            works,
            dissipated=works.dissipated + dissipated,
            external=works.external + external,
        )

    def _enter_curvature(self, more: float, at_rest: bool) -> None:
        """Enter what the curvature of a step adds, on the first rank."""
        more *= self._comm.rank == 0
        # Loads at rest do no work: what a rate lets go is less by it.
        spent = np.array([0.0, 0.0, -more * at_rest])
        self._enter((more * (not at_rest), 0.0), spent)

    def dissipation(self) -> NDArray[np.float64]:
        """Damage, friction and viscous work of the step (3,), this rank's [N mm]."""
        works = [active.works() for active in self.discretization.active.values()]
        return float(self.discretization.geometry.thickness) * sum(works, start=np.zeros(3))

    # Entries besides those of steps

    def begin_arc(self) -> None:
        """The next step does not go on from the last one."""
        self.works = replace(self.works, arc=None, pending=None)

    def follow(self, discretization: Discretization) -> None:
        """Go on with another discretization."""
        self.discretization = discretization
        self.begin_arc()

    def enter_opening(self, added: float) -> None:
        """Facets that have opened have added an energy, this rank's [N mm]."""
        self._enter((0.0, added), np.zeros(3))

    def hold_loads(self, since: Snapshot) -> None:
        """Count the work of loads since a state of this load factor as that of loads that are held.

        The way there led over other load factors, which a machine does not record.
        """
        now, works = self.discretization, self.works
        if since.t != self._loading.t or since.discretization is not now:
            return
        change = (now.u.x.array - since.u)[: now.owned]
        work = since.works.external[0] + at_owners(now.space, self._loading.vector) @ change
        self.works = replace(works, external=np.array([work, works.external[1]]))

    def release(self, energy: float) -> None:
        """Count what a jump has released with the viscous work; `energy` of all ranks [N mm]."""
        self._enter((0.0, 0.0), np.array([0.0, 0.0, energy * (self._comm.rank == 0)]))

    # Works of a step

    def _external_work(self) -> tuple[float, NDArray[np.float64], float]:
        """Work of prescribed displacements, dead loads and eigenstrains in the step, and what its
        parts charge to damage, friction and viscosity more than the whole (3,), this rank's [N mm];
        ``within`` of :class:`.Works`.

        What the curvature of the step adds is entered here, as far as two steps foretell it.
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
        # With the points' forces -T on zeta these are the derivative of an energy, whose work does
        # not depend on the path. That of T does, on where in the step points begin to yield. Cycles
        # wear a bond while the load stays.
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
        # Eigenstrains are as a force, the change of the energy with t, on the load factor.
        rates = begun.rate, self._eigenstrain_rate(self._loading.t, start.t)
        ends = [np.append(end, rate) for end, rate in zip(ends, rates, strict=True)]
        led = any(rates) and self._comm.rank == 0
        change = np.append(change, (self._loading.t - start.t) * led)
        slopes = [float(end @ change) for end in ends]
        mean = sum(slopes) / 2
        rated = any(active.law.viscosity > 0 for active in now.active.values())
        at_rest = rated and held and not begun.slowed and begun.cycles == 0
        if (at_rest or not held) and not (now.bodies.small or now.surface.fluids):
            so_far, last = self.works.external[0] + mean + work, self.works.arc
            forces, lengths = ends[1] - ends[0], len(change) - 1
            arc, curved, told = next_arc(self._comm, last, forces, change, so_far, lengths)
            gap = change[now.owned : -1]
            pending = None if told else self._pending(slopes, gap, curved, at_rest)
            self.works = replace(self.works, arc=arc, pending=pending)
            self._enter_curvature(curved, at_rest)
        return mean + work, more, work - straight

    def _pending(
        self, slopes: Sequence[float], gap: NDArray[np.float64], entered: float, at_rest: bool
    ) -> Pending:
        """What it takes to find the curvature of the step.

        Args:
            slopes: phi at start and end by the loads, this rank's [N mm].
            gap: d zeta, flat [mm].
            entered, at_rest: As of :class:`.Pending`.
        """
        start, forces, t = self._start.state, self._start.forces, self._loading.t
        change = self.discretization.u.x.array - start.u, gap
        before = first = slopes[0] + 2 * self._relaxed()
        # The first guess of the step knows the forces at its start with its tau_s, but not with the
        # eigenstrains there.
        if forces is not None and not self._loading.strained(start.t, t):
            first = self._slope(forces, change)
        return Pending(start, change, (before, first, slopes[1]), entered, at_rest)

    def _slope(self, forces: _Forces, change: tuple[NDArray, NDArray]) -> float:
        """phi of forces but eigenstrains, this rank's [N mm]."""
        u, gap = change
        at_gaps = float(self.discretization.geometry.thickness) * forces.at_gaps @ gap
        return float(forces.residual @ u[: self.discretization.owned] + forces.loads @ u + at_gaps)

    def _curvature(self, pending: Pending) -> float:
        """What the trapezoidal rule misses of the first integral of :mod:`.work`; collective.

        [N mm], the same on every rank.
        """
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
        whole = chord_integral(first, last, between, self.works.arc.work)
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
        return _joined(gap_force(active, active.traction_in_frame()) for active in failing)

    def _relaxed(self) -> float:
        """Work of the forces that facets which have opened left out of balance, this rank's
        [N mm]."""
        start, owned = self._start.state, slice(self.discretization.owned)
        forces = self._loading.balance(start.forces[owned].copy())
        return float(forces @ (self.discretization.u.x.array - start.u)[owned]) / 2

    def _fluids(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pressures in fluids times areas [N], and what they lose of their gaps [mm], at points."""
        forces, lost = [], []
        thickness = float(self.discretization.geometry.thickness)
        for active in self.discretization.surface.fluids:
            weights = active.quadrature.weights
            p = active.fluid.pressure.x.array[: len(weights)]
            forces.append(thickness * weights * p)
            lost.append(-active.fluid.intrusion(active.values, active.stabilization))
        return _joined(forces), _joined(lost)

    def _eigenstrain_rate(self, now: float, t: float) -> float:
        """Change of the stored energy with the eigenstrains at the present displacement, as they
        change from load factor ``now``, at which they are left, towards ``t``, or along the ray;
        collective [N mm].
        """
        loading, ray = self._loading, self._loading.ray
        t = t if ray is None else now + ray.end - ray.start
        if not loading.strained(now, t):
            return 0.0
        h, energies = SMALL * (t - now), []
        for factor in (now + h, now + 2 * h, now):
            loading.strain(factor)
            energies.append(self.discretization.stored_energy().sum())
        one, two, here = global_sum(self._comm, energies)
        return float(4 * one - two - 3 * here) / (2 * h)


def _joined(arrays: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """One array after the other; there may be none."""
    return np.concatenate([np.zeros(0), *arrays])
