"""The protocol of a load step: what solvers and checkpoints do with a problem."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..assembly.discretization import Discretization
from ..assembly.means import lattice_of
from ..assembly.space import at_owners
from ..base.parallel import global_any, global_max, global_sum, warn_together
from ..interface.activation import Activation, Utilization
from ..interface.active import ActiveInterface
from ..interface.gap_work import gap_force, gap_forces, gap_work
from ..interface.guess import (
    hold_points,
    hold_sliding_points,
    open_free_points,
    pressed_points,
    touching_points,
)
from ..interface.sliding import sliding
from .loading import Loading
from .states import RunScales, Snapshot
from .work import Arc, chord_integral, next_arc

#: Change of the load factor for the derivative of the residual, relative to its ray.
INCREMENT = 1e-7

#: Share of a step over which the change of the energy with the eigenstrains is taken.
SMALL = 1e-2

#: How often a step is done again with the tau_s of its end before it is cut.
MOST_REPEATS = 3

#: Slip relative to the facet above which a point faces another facet than its partner's.
SLID = 0.5


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


def _joined(arrays: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """One array after the other; there may be none."""
    return np.concatenate([np.zeros(0), *arrays])


class Step:
    """Load steps of a problem: a step begins, is iterated on, and is committed or cancelled.

    Args:
        discretization: Of the facets that are open.
        activation: Which facets are open.
        loading: Loads and prescribed displacements.

    Attributes:
        discretization: Of the facets that are open now; another one after some have opened.
        activation: Facets of the interfaces, and which of them are open.
        scales: Sizes of the run so far, which the solver updates.
        start: State in which the last step began.
        dissipated: Damage, friction and viscous work so far (3,), this rank's [N mm].
        external: Work of loads, prescribed displacements and eigenstrains so far, and what the
            discretization has added (2,), this rank's [N mm].
        within: Work of loads that the last step has beyond that of the mean of its ends by points
            that begin to yield, part or close in it, this rank's [N mm]. It is that of equilibria
            between both ends, which a snap does not go through.
        arc: The last step along the path; None where the next one does not go on from there.
        sliding: Largest slip of points in contact so far, relative to the size of their facets.
        rests_on_contact: Whether contact alone holds a body. Else points without bond and pressure
            start every step open; the body would be loose.
    """

    def __init__(self, discretization: Discretization, activation: Activation, loading: Loading):
        self.discretization = discretization
        self.activation = activation
        self._loading = loading
        self._comm = discretization.mesh.comm
        self.scales = RunScales()
        self.sliding = 0.0
        self.dissipated = np.zeros(3)
        self.external = np.zeros(2)
        self.within = 0.0
        self.arc: Arc | None = None
        self._cycles, self._slowed = 0.0, False
        # How often the present step has been done again with a larger tau_s.
        self._repeats = 0
        self.rests_on_contact = False
        activation.follow(discretization.u)
        loading.move(0.0)
        discretization.update_stabilization()
        self._rate_at_start, self._dt, self._added = 0.0, 1.0, 0.0
        # At the start of the step, with its tau_s and its loads.
        self._begun: _Forces | None = None
        self._remember_start()

    def _remember_start(self) -> None:
        """The converged state from which a step sets out, and what its work is measured from."""
        self.start, self._loads_at_start = self.snapshot(), self._loading.vector
        self._fluids_at_start = self._fluids()

    # The course of a step

    def begin(self, t: float, dt: float, overstress: float = 0.0, cycles: float = 0.0) -> None:
        """Remember the converged state, then set loads and stabilization for a step to ``t``.

        Args:
            t: Load factor.
            dt: Time step [s].
            overstress: At the start of a step in a jump, see :meth:`slow_down`.
            cycles: Of the load that the step stands for, for laws of fatigue.

        Raises:
            ValueError: r <= H on a facet; the converged state is kept.
        """
        self._dt, self._begun, self._slowed = dt, None, overstress > 0
        self._remember_start()
        self._loading.spread()
        self.slow_down(overstress, cycles)
        try:
            self._added = self.discretization.update_stabilization()
        except ValueError:
            self.cancel()
            raise
        if not self.rests_on_contact:
            for active in self._failing():
                open_free_points(active)
        self._rate_at_start = self._eigenstrain_rate(self._loading.t, t)
        self._loading.move(t)

    def slow_down(self, overstress: float, cycles: float = 0.0) -> None:
        """Choose the overstress of the step and the cycles it stands for.

        Args:
            overstress: Drag on the gap of bonded points in multiples of the softening modulus H.
            cycles: As in :meth:`begin`.
        """
        self._cycles = cycles
        for active in self.discretization.active.values():
            active.slow_down(overstress, cycles)

    def assemble_residual(self, dt: float = 1.0, hold: bool = False) -> NDArray[np.float64]:
        """Return maps, then internal minus external forces at the current displacement.

        Args:
            dt: Time step of the return maps [s].
            hold: Keep zeta at its converged value instead of mapping back.

        Returns:
            Owned dofs, nothing removed at prescribed ones [N].
        """
        return self.discretization.assemble_residual(dt, hold, self._loading.vector)

    def hold(self, dt: float, sliding: bool) -> None:
        """The residual that a first guess takes away: with zeta at its converged value.

        Args:
            dt: Time step of the return maps [s].
            sliding: Whether points that have slid are held in the tangent.
        """
        if sliding:
            for active in self._failing():
                hold_sliding_points(active)
        self.assemble_residual(dt, hold=True)
        if not self.discretization.bodies.small:
            forces = self.discretization.forces.x.array[: self.discretization.owned].copy()
            self._begun = _Forces(forces, self._loading.vector, self._gap_forces())

    def close(self, dt: float) -> bool:
        """Whether a first guess makes lips that touch overlap: it is to be made again; collective.

        Whether they are open or closed is said by the step alone. The guess has taken them for
        open. Those that overlap are then taken for held.

        Args:
            dt: Time step of the return maps [s].
        """
        failing = self._failing()
        touching = [touching_points(active) for active in failing]
        if self.rests_on_contact or not self._any(touching):
            return False
        begun = [active.values for active in failing]
        self.discretization.update_points(dt)
        for active, values, points in zip(failing, begun, touching, strict=True):
            points &= pressed_points(active)
            hold_points(active, values, points)
        return self._any(touching)

    def _any(self, points: Sequence[NDArray[np.bool_]]) -> bool:
        """Whether there is any of some points on any rank; collective."""
        return global_any(self._comm, any(rows.any() for rows in points))

    def _failing(self) -> list[ActiveInterface]:
        """Interfaces that can fail."""
        parts = self.discretization.active.values()
        return [active for active in parts if active.law.inelastic]

    def bond_work(self, dt: float | None = None) -> float:
        """Work on bonds of the step so far; collective [N mm].

        Args:
            dt: Time step of the return maps, which are asked again at the current displacement;
                None where the last residual has done that [s].
        """
        if dt is not None:
            self.discretization.update_points(dt)
        return float(global_sum(self._comm, self._dissipation()[0]))

    def lost(self) -> float:
        """Largest share of its strength that a point loses in the step so far; collective."""
        lost = [0.0]
        for active in self._failing():
            change = active.values.update.softening - active.history.softening
            lost.append(np.max(change / active.law.strength, initial=0.0))
        return float(global_max(self._comm, max(lost)))

    def load_rate(self) -> NDArray[np.float64]:
        """Minus the change of the residual with the load factor along the present ray, u held.

        Of dead loads that is their rate. A fluid between crack faces changes the return maps
        besides, and eigenstrains change stresses: there an increment of the load factor tells. The
        residual is left as it was.

        Returns:
            Owned dofs [N].
        """
        ray = self._loading.ray
        if self._loading.pressurised or self._loading.strained(ray.start, ray.end):
            t, change = self._loading.t, INCREMENT * (ray.end - ray.start)
            return self._residual_rate(self._loading.move, t, change)[0]
        return self._loading.balance(at_owners(self.discretization.space, ray.rate(ray.vectors)))

    def overstress_rate(self, overstress: float) -> tuple[NDArray[np.float64], float]:
        """Minus the change of the residual with the overstress, u held, and that of the work.

        Args:
            overstress: What it is, in multiples of H.

        Returns:
            Owned dofs [N]; of the work on bonds [N mm].
        """
        return self._residual_rate(self.slow_down, overstress, INCREMENT * (1 + overstress))

    def _residual_rate(
        self, move: Callable[[float], None], value: float, change: float
    ) -> tuple[NDArray[np.float64], float]:
        """Minus the derivative of the residual by a number, by a change of it, and of the work."""
        now = self.discretization
        points = [active.snapshot() for active in now.active.values()]
        forces = now.forces.x.array.copy()
        mapped = all(active.values.update is not None for active in self._failing())
        rate = (forces[: now.owned] if mapped else self.assemble_residual(self._dt)).copy()
        work = self.bond_work()
        move(value + change)
        rate -= self.assemble_residual(self._dt)
        work -= self.bond_work()
        move(value)
        for active, state in zip(now.active.values(), points, strict=True):
            active.return_to(state)
        now.update_means()
        now.forces.x.array[:] = forces
        return self._loading.balance(rate / change), -work / change

    def inverted(self) -> bool:
        """Whether cells are turned inside out, det F <= 0; collective."""
        return global_any(self._comm, self.discretization.inverted())

    def stabilization_suffices(self) -> bool:
        """Whether the step has ended where its tau_s is enough for coercivity; collective."""
        return not global_any(self._comm, not self.discretization.stabilization_suffices())

    def raise_stabilization(self) -> bool:
        """Cancel the step, to begin again with the r that its end asks for; collective.

        Cutting a step need not help: it may be the strain of its end, however it is reached, that
        asks for more than its start.

        Returns:
            False where that has been done often enough, and nothing is changed.
        """
        if self._repeats == MOST_REPEATS:
            return False
        needed = self.discretization.needed_penalties()
        repeats = self._repeats + 1
        self.cancel()
        for active, r in zip(self.discretization.active.values(), needed, strict=True):
            active.floor = r
        self._repeats = repeats
        return True

    def commit(self) -> None:
        """Take the current state as converged: history, dissipation and external work."""
        work, charged = self._external_work()
        self.external += work, self._added + self._relaxed()
        self.dissipated += self._dissipation() + charged
        for active in self.discretization.active.values():
            active.commit()
        self._repeats = 0

    def watch_sliding(self) -> float:
        """Largest slip of points in contact now, relative to the size of their facets; collective.

        Warns once where contact slides so far that most points face another facet by then.

        Returns:
            A ratio; 0 where nothing is pressed or has slipped.
        """
        here = [(sliding(active), active) for active in self.discretization.active.values()]
        if not here:
            return 0.0
        largest, active = max(here, key=lambda found: found[0].ratio)
        before, now = self.sliding, global_max(self._comm, largest.ratio)
        self.sliding, message = max(before, now), None
        if before > SLID or now <= SLID:
            return now
        if largest.ratio == now:
            message = (
                f"{active.interface}: at facet {largest.facet} at "
                f"{largest.point.round(6).tolist()} the slip {largest.slip:.3g} mm is "
                f"{largest.ratio:.0%} of the size of the facet, {largest.size:.3g} mm. Points keep "
                "the partner that they had in the reference configuration, so contact stays where "
                "it was: end the run before, or take facets that are larger along the slip than "
                "all of it (problem.step.sliding has the largest ratio so far)"
            )
        warn_together(self._comm, message)
        return now

    def cancel(self) -> None:
        """Return to the state before :meth:`begin`: a failed step leaves no trace."""
        self.return_to(self.start)
        self._repeats = 0

    def hold_loads(self, since: Snapshot) -> None:
        """Count the work of loads since a state of this load factor as that of loads that are held.

        The way there led over other load factors, which a machine does not record.
        """
        now = self.discretization
        if since.t != self._loading.t or since.discretization is not now:
            return
        change = (now.u.x.array - since.u)[: now.owned]
        self.external[0] = since.external[0] + at_owners(now.space, self._loading.vector) @ change

    def release(self, energy: float) -> None:
        """Count what a jump has released with the viscous work; `energy` of all ranks [N mm]."""
        self.dissipated[2] += energy * (self._comm.rank == 0)

    # Energies of a step

    def _dissipation(self) -> NDArray[np.float64]:
        """Damage, friction and viscous work of the step (3,), this rank's [N mm]."""
        works = [active.works() for active in self.discretization.active.values()]
        return float(self.discretization.geometry.thickness) * sum(works, start=np.zeros(3))

    def _external_work(self) -> tuple[float, NDArray[np.float64]]:
        """Work of prescribed displacements, dead loads and eigenstrains in the step, and what its
        parts charge to damage, friction and viscosity more than the whole (3,), this rank's [N mm].

        What the curvature of a step adds is on the first rank.
        """
        now, start = self.discretization, self.start
        owned, prescribed = slice(now.owned), self._loading.owned_prescribed
        if self._loading.rigid:
            prescribed = np.concatenate([prescribed, self._loading.rigid.led_dofs])
        ends = []
        for vector, forces in (
            (self._loads_at_start, start.forces),
            (self._loading.vector, now.forces.x.array),
        ):
            ends.append(at_owners(now.space, vector))
            ends[-1][prescribed] += forces[prescribed]
        change = (now.u.x.array - start.u)[owned]
        if now.surface.fluids:
            fluids = self._fluids_at_start, self._fluids()
            ends = [np.append(end, p) for end, (p, _) in zip(ends, fluids, strict=True)]
            change = np.append(change, fluids[1][1] - fluids[0][1])
        # With the points' forces -T on zeta these are the derivative of an energy, whose work does
        # not depend on the path. That of T does, on where in the step points begin to yield. Cycles
        # wear a bond while the load stays.
        thickness = float(now.geometry.thickness)
        work, straight, more = 0.0, 0.0, np.zeros(3)
        held = self._slowed or self._cycles > 0 or self._loading.t == start.t
        for active in now.active.values():
            *forces, gap = gap_forces(active)
            ends = [np.append(end, thickness * f) for end, f in zip(ends, forces, strict=True)]
            change = np.append(change, gap)
            done, charged = gap_work(active, self._dt, held)
            work += thickness * done
            more += thickness * charged
            straight -= thickness * float(sum(forces) @ gap) / 2
        # Eigenstrains are as a force, the change of the energy with t, on the load factor.
        rates = self._rate_at_start, self._eigenstrain_rate(self._loading.t, start.t)
        ends = [np.append(end, rate) for end, rate in zip(ends, rates, strict=True)]
        led = any(rates) and self._comm.rank == 0
        change = np.append(change, (self._loading.t - start.t) * led)
        slopes = [float(end @ change) for end in ends]
        mean = sum(slopes) / 2
        rated = any(active.law.viscosity > 0 for active in now.active.values())
        at_rest = rated and held and not self._slowed and self._cycles == 0
        if (at_rest or not held) and not (now.bodies.small or now.surface.fluids):
            so_far = self.external[0] + mean + work
            self.arc, curved = next_arc(self._comm, self.arc, ends[1] - ends[0], change, so_far)
            if curved is None:
                curved = self._curvature(slopes, change[now.owned : -1])
            curved *= self._comm.rank == 0
            # loads at rest do no work: what a rate lets go is less by it
            if at_rest:
                more[2] -= curved
            else:
                mean += curved
        self.within = work - straight
        return mean + work, more

    def _curvature(self, slopes: Sequence[float], gap: NDArray[np.float64]) -> float:
        """What the trapezoidal rule misses of the first integral of :mod:`.work`; collective.

        [N mm], the same on every rank.

        Args:
            slopes: phi at start and end by the loads, this rank's [N mm].
            gap: d zeta, flat [mm].
        """
        now, start, t = self.discretization, self.start, self._loading.t
        u, residual = now.u.x.array.copy(), now.forces.x.array.copy()
        values = [active.values for active in now.active.values()]
        thickness = float(now.geometry.thickness)
        change, span = u - start.u, t - start.t
        strains = self._loading.strained(start.t, t)

        def slope(forces: _Forces, rate: float = 0.0) -> float:
            at_nodes = forces.residual @ change[: now.owned] + forces.loads @ change
            at_gaps = thickness * forces.at_gaps @ gap
            return float(at_nodes + at_gaps) + rate * span * (self._comm.rank == 0)

        def between(share: float) -> float:
            here, rate = start.t + share * span, 0.0
            now.u.x.array[:] = start.u + share * change
            now.update_means()
            if strains:
                self._loading.strain(here)
            for active, end in zip(now.active.values(), values, strict=True):
                active.go_between(end, share)
            forces = _Forces(now.assemble_residual(None), np.zeros_like(change), self._gap_forces())
            if strains:
                rate = self._eigenstrain_rate(here, t)
            return float(global_sum(self._comm, slope(forces, rate)))

        # The first guess of the step knows the forces at its start with its tau_s, but not with the
        # eigenstrains there.
        before = slopes[0] + 2 * self._relaxed()
        first = before if strains or self._begun is None else slope(self._begun)
        before, first, last = global_sum(self._comm, [before, first, slopes[1]])
        whole = chord_integral(first, last, between, self.arc.work)
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
        return _joined(gap_force(active, active.traction_in_frame()) for active in self._failing())

    def _relaxed(self) -> float:
        """Work of the forces that facets which have opened left out of balance, this rank's
        [N mm]."""
        start, owned = self.start, slice(self.discretization.owned)
        forces = self._loading.balance(start.forces[owned].copy())
        return float(forces @ (self.discretization.u.x.array - start.u)[owned]) / 2

    def _fluids(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pressures in fluids times areas [N], and what they lose of their gaps [mm], at points."""
        forces, lost = [np.zeros(0)], [np.zeros(0)]
        thickness = float(self.discretization.geometry.thickness)
        for active in self.discretization.surface.fluids:
            weights = active.quadrature.weights
            p = active.fluid.pressure.x.array[: len(weights)]
            forces.append(thickness * weights * p)
            lost.append(-active.fluid.intrusion(active.values, active.stabilization))
        return np.concatenate(forces), np.concatenate(lost)

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

    # States

    def snapshot(self) -> Snapshot:
        """The converged state as it can be returned to later."""
        now = self.discretization
        return Snapshot(
            self._loading.t,
            now,
            now.u.x.array.copy(),
            now.forces.x.array.copy(),
            [active.snapshot() for active in now.active.values()],
            list(self.activation.open),
            self.dissipated.copy(),
            self.external.copy(),
            self.arc,
        )

    def return_to(self, snapshot: Snapshot) -> None:
        """Go back to a converged state, to its set of open facets too.

        Args:
            snapshot: From :meth:`snapshot`.
        """
        if snapshot.discretization is not self.discretization:
            self.activation.open = list(snapshot.open)
            self._follow(snapshot.discretization)
        now = self.discretization
        now.u.x.array[:] = snapshot.u
        now.forces.x.array[:] = snapshot.forces
        self.dissipated = snapshot.dissipated.copy()
        self.external, self.arc = snapshot.external.copy(), snapshot.arc
        for active, interface in zip(now.active.values(), snapshot.interfaces, strict=True):
            active.return_to(interface)
        self._loading.move(snapshot.t)

    # Facets that open on demand

    def discretization_of(self, marks: Sequence[NDArray[np.bool_]]) -> Discretization:
        """The discretization with these open facets: the present one where it has them.

        Args:
            marks: For every interface, a mark on all local facets of the mesh.
        """
        now = self.discretization
        same = all(map(np.array_equal, marks, self.activation.open))
        if not global_any(self._comm, not same):
            return now
        facets = self.activation.facets_among(marks)
        interfaces = self.activation.interfaces
        lattice = lattice_of(now.means)
        return Discretization(now.mesh, now.bodies, interfaces, facets, now.degree, lattice)

    def open_facets(self, utilization: Utilization) -> bool:
        """Open the closed facets whose utilization is high enough; collective.

        The state is carried over exactly: the new facets start bonded, with no opening.

        Args:
            utilization: Of the activation.

        Returns:
            Whether there were any.
        """
        marks = self.activation.marks_to_open(utilization)
        before, after = self.discretization, self.discretization_of(marks)
        if after is before:
            return False
        stored = before.stored_energy().sum()
        self.activation.open = marks
        self._follow(after)
        after.continue_from(before)
        self._loading.move(self._loading.t)
        after.update_stabilization()
        # The force on a node is now shared by its duplicates.
        self.assemble_residual(hold=True)
        for active in after.active.values():
            active.take_traction()
        # Facets of one cell share its energy, so that tau_s changes next to those that open.
        self.external[1] += after.stored_energy().sum() - stored
        return True

    def _follow(self, discretization: Discretization) -> None:
        """Work with another discretization from now on."""
        self.discretization, self.arc = discretization, None
        self.activation.follow(discretization.u)
        self._loading.follow(discretization)
