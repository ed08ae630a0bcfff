"""The protocol of a load step: what solvers and checkpoints do with a problem."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..assembly.discretization import Discretization
from ..assembly.means import lattice_of
from ..assembly.space import at_owners
from ..base.parallel import global_any, global_max, global_sum, warn_together
from ..interface.activation import Activation, Utilization
from ..interface.active import ActiveInterface
from ..interface.guess import (
    hold_points,
    hold_sliding_points,
    open_free_points,
    pressed_points,
    touching_points,
)
from ..interface.sliding import sliding
from .ledger import Ledger
from .loading import Loading
from .states import RunScales, Snapshot

#: Change of the load factor for the derivative of the residual, relative to its ray.
RATE_STEP = 1e-7

#: How often a step is done again with the tau_s of its end before it is cut.
MOST_REPEATS = 3

#: Slip relative to the facet above which a point faces another facet than its partner's.
SLID = 0.5


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
        ledger: Works of the steps so far.
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
        self.ledger = Ledger(discretization, loading)
        # How often the present step has been done again with a larger tau_s.
        self._repeats = 0
        self.rests_on_contact = False
        activation.follow(discretization.u)
        loading.move(0.0)
        discretization.update_stabilization()
        self._dt, self.start = 1.0, self.snapshot()

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
        self.ledger.settle()
        self._dt, self.start = dt, self.snapshot()
        self.ledger.begin(self.start, dt, overstress > 0, cycles)
        self._loading.spread()
        self.slow_down(overstress, cycles)
        try:
            added = self.discretization.update_stabilization()
        except ValueError:
            self.cancel()
            raise
        if not self.rests_on_contact:
            for active in self._failing():
                open_free_points(active)
        self.ledger.set_out(added, t)
        self._loading.move(t)

    def slow_down(self, overstress: float, cycles: float = 0.0) -> None:
        """Choose the overstress of the step and the cycles it stands for.

        Args:
            overstress: Drag on the gap of bonded points in multiples of the softening modulus H.
            cycles: As in :meth:`begin`.
        """
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
        self.ledger.hold()

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
        return float(global_sum(self._comm, self.ledger.dissipation()[0]))

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
            t, change = self._loading.t, RATE_STEP * (ray.end - ray.start)
            return self._residual_rate(self._loading.move, t, change)[0]
        return self._loading.balance(at_owners(self.discretization.space, ray.rate(ray.vectors)))

    def overstress_rate(self, overstress: float) -> tuple[NDArray[np.float64], float]:
        """Minus the change of the residual with the overstress, u held, and that of the work.

        Args:
            overstress: What it is, in multiples of H.

        Returns:
            Owned dofs [N]; of the work on bonds [N mm].
        """
        return self._residual_rate(self.slow_down, overstress, RATE_STEP * (1 + overstress))

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
        self.ledger.commit()
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
            self.ledger.works,
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
        self.ledger.works = snapshot.works
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
        self.ledger.enter_opening(after.stored_energy().sum() - stored)
        return True

    def _follow(self, discretization: Discretization) -> None:
        """Work with another discretization from now on."""
        self.discretization = discretization
        self.ledger.follow(discretization)
        self.activation.follow(discretization.u)
        self._loading.follow(discretization)
