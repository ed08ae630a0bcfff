"""The protocol of a load step, for solvers and checkpoints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..assembly.damage import Damage
from ..assembly.discretization import Discretization
from ..assembly.means import lattice_of
from ..assembly.space import at_owners
from ..base.parallel import global_any, global_max, global_sum, warn_together
from ..interface.activation import Activation, Utilization
from ..interface.active import ActiveInterface, damage_work, goes_on, take_overlap
from ..interface.guess import (
    hold_modes,
    hold_points,
    hold_unstressed,
    open_free_points,
    pressed_points,
    touching_points,
    without_couples,
)
from ..interface.moving import MovingInterface
from ..interface.sliding import sliding
from ..laws import Mode
from .ledger import Ledger, WorkInMotion
from .loading import Loading, anchor
from .motion import Motion
from .states import Energy, Rates, RunScales, Snapshot

#: Relative step for finite differences of the residual by the load factor.
RATE_STEP = 1e-7

#: A time in which no body flows or relaxes [s].
INSTANT = 1e-150

#: Maximum number of repetitions of a step with the tau_s of its end.
MOST_REPEATS = 3

#: Slip relative to the facet size above which a point faces a different facet.
SLID = 0.5


class Step:
    """Load steps of a problem: a step begins, is iterated on, and is committed or cancelled.

    Attributes:
        discretization: For the currently open facets; replaced when facets open.
        activation: Facets of the interfaces, and which of them are open.
        scales: Sizes of the run so far, which the solver updates.
        sliding: Largest slip of points in contact so far, relative to the size of their facets.
        rates: Derivatives of the converged state by parameters; None for none.
        damage: The damage field of bodies that crack; None where none does.
        rests_on_contact: Whether a body is constrained by contact alone; otherwise points without
            bond and pressure start every step open.
    """

    def __init__(
        self,
        discretization: Discretization,
        activation: Activation,
        loading: Loading,
        motion: Motion | None = None,
    ):
        self.discretization = discretization
        self.activation = activation
        self._loading = loading
        self._comm = discretization.mesh.comm
        self.scales = RunScales()
        self.sliding = 0.0
        self.ledger = Ledger(discretization, loading)
        # Number of repetitions of the current step with a larger tau_s.
        self._repeats = 0
        self.rests_on_contact = False
        self.motion = motion
        self.rates: Rates | None = None
        activation.follow(discretization.u)
        loading.move(0.0)
        discretization.update_stabilization()
        self._dt = 1.0
        points = discretization.bodies.points
        self.damage = Damage(discretization, points) if points and points.cracking else None
        self._overlap()
        self.start = self.snapshot()
        # The last converged displacement.
        self._reached = self.start.u

    def _overlap(self) -> None:
        """Enter forces and energy of surfaces that overlap at the start."""
        now = self.discretization
        apart = [one for one in self._failing() if one.quadrature.distance is not None]
        if apart:
            self.assemble_residual(hold=True)
            for active in apart:
                take_overlap(active)
            self.ledger.enter_opening(now.stored_energy().sum())

    # The course of a step

    def begin(
        self,
        t: float,
        dt: float,
        overstress: float = 0.0,
        cycles: float = 0.0,
    ) -> None:
        """Store the converged state, then set loads and stabilization for a step to ``t``;
        overstress and cycles as for :meth:`slow_down`."""
        self.ledger.settle()
        self._dt, self.start = dt, self.snapshot()
        self.ledger.begin(self.start, dt, overstress > 0, cycles)
        for active in self.discretization.active.values():
            active.pair(release=True)
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

    def march(self, t: float, dt: float) -> None:
        """Begin a step to ``t`` that is neither iterated on nor cancelled, with tau_s as it is."""
        self._dt, self.start = dt, self.snapshot()
        self.ledger.begin(self.start, dt, False, 0.0)
        for active in self.discretization.active.values():
            goes_on(active)
        if self.discretization.slides:
            for active in self.discretization.active.values():
                active.pair(release=True)
        self.ledger.set_out(0.0, t)
        self._loading.move(t)

    def renew(self) -> None:
        """Evaluate tau_s between steps of :meth:`march`; collective."""
        self.slow_down(0.0)
        self.ledger.enter_opening(self.discretization.update_stabilization())

    def set_out(self) -> None:
        """Start the way to a given load factor or time: adjoint terms take the current moduli of
        bodies at points.

        They keep them on the way: with those of every step the residual would jump where points
        begin or cease to flow, however short the steps, and so would the path.
        """
        if bodies := self.discretization.bodies.points:
            bodies.renew()

    def slow_down(self, overstress: float, cycles: float = 0.0) -> None:
        """Set the overstress of bonded points per gap increment, in multiples of H, and the number
        of cycles that the step represents."""
        for active in self.discretization.active.values():
            active.slow_down(overstress, cycles)

    def assemble_residual(
        self, dt: float = INSTANT, hold: bool = False, anew: bool = False
    ) -> NDArray[np.float64]:
        """Return maps, then internal minus external forces at the current displacement, owned dofs,
        prescribed ones included [N]; ``hold`` fixes zeta at its converged value. By default no time
        passes."""
        return self.discretization.assemble_residual(dt, hold, self._loading.vector, anew)

    def hold(self, dt: float, anew: bool, softens: bool) -> None:
        """Assemble the residual of the predictor, with zeta at its converged value.

        Args:
            anew: Whether the last step does not continue: in the tangent sliding points are treated
                as sticking, and bodies at points as at rest.
            softens: Whether damage continues; otherwise so are points that soften.
        """
        modes = [Mode.FRICTION] * anew + [Mode.TENSION, Mode.SHEAR] * (not softens)
        for active in self._failing() if modes else ():
            hold_modes(active, modes)
        self.assemble_residual(dt, hold=True, anew=anew)
        self.ledger.record_start()
        apart = [one for one in self._failing() if one.quadrature.distance is not None]
        if apart and not global_any(self._comm, self.discretization.u.x.array.any()):
            for active in apart:
                without_couples(active)
            self.discretization.assemble_residual(None, loads=self._loading.vector)
            for active in apart:
                hold_unstressed(active)

    def close(self, dt: float) -> bool:
        """Whether crack faces in contact overlap in the prediction, which must be repeated;
        collective.

        The predictor assumes that they open; overlapping points are then treated as sticking.
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
        return global_any(self._comm, any(rows.any() for rows in points))

    def _failing(self) -> list[ActiveInterface]:
        parts = self.discretization.active.values()
        return [active for active in parts if active.law.inelastic]

    def bond_work(self) -> float:
        """Damage work in the step at the last residual; collective [N mm]."""
        now = self.discretization
        work = sum(map(damage_work, now.active.values()))
        return float(global_sum(self._comm, float(now.geometry.thickness) * work))

    def lost(self) -> float:
        """Largest fraction of the strength lost at a point in the step so far; collective."""
        lost = [0.0]
        for active in self._failing():
            change = active.values.update.softening - active.history.softening
            if active.law.has_bond:
                lost.append(np.max(change / active.law.strength, initial=0.0))
        return float(global_max(self._comm, max(lost)))

    def load_rate(self) -> NDArray[np.float64]:
        """Negative derivative of the residual by the load factor along the current ray, at fixed u,
        owned dofs [N].

        For dead loads it is their rate. With a fluid between crack faces, which also changes the
        return maps, and with eigenstrains it is computed by differences. The residual is restored.
        """
        loading, ray = self._loading, self._loading.ray
        if loading.pressurised or loading.strained(ray.start, ray.end):
            change = RATE_STEP * (ray.end - ray.start)
            return self._residual_rate(loading.move, loading.t, change)[0]
        return loading.balance(at_owners(self.discretization.space, ray.rate(loading.dead)))

    def overstress_rate(self, overstress: float) -> tuple[NDArray[np.float64], float]:
        """Negative derivative of the residual by the overstress at fixed u, owned dofs [N], and
        that of the damage work [N mm]."""
        return self._residual_rate(self.slow_down, overstress, RATE_STEP * (1 + overstress))

    def _residual_rate(
        self, move: Callable[[float], None], value: float, change: float
    ) -> tuple[NDArray[np.float64], float]:
        """Negative derivative of the residual by a parameter, by differences, and of the work."""
        now = self.discretization
        points = [active.snapshot() for active in now.active.values()]
        bodies = now.bodies.points and now.bodies.points.state
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
        if bodies:
            now.bodies.points.take(bodies)
        now.update_means()
        now.forces.x.array[:] = forces
        return self._loading.balance(rate / change), -work / change

    def invalid(self) -> str:
        """Why bodies cannot be in the current state though forces may balance: CELLS_INVERTED, or
        BODIES_OVERLAP where they slide; empty if they can; collective."""
        if global_any(self._comm, self.discretization.inverted()):
            return "CELLS_INVERTED"
        moving = [
            one for one in self.discretization.active.values() if isinstance(one, MovingInterface)
        ]
        if moving and global_any(self._comm, any([one.passed() for one in moving])):
            return "BODIES_OVERLAP"
        return ""

    def stabilization_suffices(self) -> bool:
        """Whether tau_s of the step satisfies coercivity at its end; collective."""
        return not global_any(self._comm, not self.discretization.stabilization_suffices())

    def raise_stabilization(self) -> bool:
        """Cancel the step, to restart it with the r required at its end; False, without changes,
        after too many repetitions; collective.

        Cutting the step need not help: the strain at its end, however reached, may require a larger
        r than its start.
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

    def commit(self, motion: WorkInMotion | None = None) -> None:
        """Accept the current state as converged: history, dissipation and external work."""
        self.ledger.commit(motion)
        for active in self.discretization.active.values():
            active.commit()
        if bodies := self.discretization.bodies.points:
            bodies.commit()
        self._repeats, self._reached = 0, self.discretization.u.x.array.copy()

    def watch_sliding(self) -> float:
        """Largest slip of points in contact now, relative to the size of their facets, 0 for none;
        collective.

        Warns once if contact slides so far that most points face a different facet.
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
            follow = ", or at finite strain sliding=True, with which points meet other facets"
            message = (
                f"{active.interface}: at facet {largest.facet} at "
                f"{largest.point.round(6).tolist()} the slip {largest.slip:.3g} mm is "
                f"{100 * largest.ratio:.0f} % of the size of the facet, {largest.size:.3g} mm. "
                "Points keep their partner in the reference configuration, so contact is evaluated "
                "at the original location: end the run earlier, or use facets that are longer than "
                f"the total slip{follow * active.facets.paired} (problem.step.sliding has the "
                "largest ratio so far)"
            )
        warn_together(self._comm, message)
        return now

    def cancel(self) -> None:
        self.return_to(self.start)
        self._repeats = 0

    # States

    def snapshot(self) -> Snapshot:
        now = self.discretization
        return Snapshot(
            self._loading.t,
            now,
            now.u.x.array.copy(),
            now.forces.x.array.copy(),
            [active.snapshot() for active in now.active.values()],
            list(self.activation.open),
            self.ledger.works,
            now.bodies.points and now.bodies.points.state,
            self.rates,
            self.motion and self.motion.state,
        )

    def return_to(self, snapshot: Snapshot) -> None:
        """Return to a converged state, including its set of open facets."""
        if snapshot.discretization is not self.discretization:
            self.activation.open = list(snapshot.open)
            self._change_space(snapshot.discretization)
        now = self.discretization
        now.u.x.array[:] = self._reached = snapshot.u
        now.forces.x.array[:] = snapshot.forces
        self.ledger.works, self.rates = snapshot.works, snapshot.rates
        for active, interface in zip(now.active.values(), snapshot.interfaces, strict=True):
            active.return_to(interface)
        if snapshot.bodies is not None:
            now.bodies.points.take(snapshot.bodies)
        if snapshot.motion is not None:
            self.motion.return_to(snapshot.motion)
        self._loading.move(snapshot.t)

    # Facets that open on demand

    def discretization_of(self, marks: Sequence[NDArray[np.bool_]]) -> Discretization:
        """The discretization with these open facets, masks over all local facets of the mesh for
        every interface: the current one if they are the same."""
        now = self.discretization
        same = all(map(np.array_equal, marks, self.activation.open))
        if not global_any(self._comm, not same):
            return now
        facets = self.activation.facets_among(marks)
        interfaces = self.activation.interfaces
        lattice = lattice_of(now.means)
        return Discretization(
            now.mesh,
            now.bodies,
            interfaces,
            facets,
            now.degree,
            lattice,
            now.weak_form.symbolic,
        )

    def open_facets(self, utilization: Utilization) -> bool:
        """Open the closed facets whose utilization is high enough; whether any opened; collective.

        The state is transferred exactly: new facets start bonded, with zero opening.
        """
        marks = self.activation.marks_to_open(utilization)
        before, after = self.discretization, self.discretization_of(marks)
        if after is before:
            return False
        stored = before.stored_energy().sum()
        self.activation.open = marks
        self._change_space(after)
        after.continue_from(before)
        self._loading.move(self._loading.t)
        after.update_stabilization()
        # The force on a node is now divided between its duplicates.
        self.assemble_residual(hold=True)
        for active in after.active.values():
            active.take_traction()
        # Facets of one cell share its energy, so tau_s changes next to opened facets.
        self.ledger.enter_opening(after.stored_energy().sum() - stored)
        return True

    def _change_space(self, discretization: Discretization) -> None:
        self.discretization = discretization
        self.ledger.change_space(discretization)
        self.activation.follow(discretization.u)
        self._loading.rebuild(discretization)


def energy_of(step: Step, anew: bool = False) -> Energy:
    """Energies at the current state, see :meth:`.Ledger.energy`; collective."""
    step.ledger.complete()
    energy = step.ledger.energy(anew)
    motion = step.motion
    return energy if motion is None else replace(energy, kinetic=motion.kinetic_energy())


def come_to_rest(step: Step) -> None:
    """Stop bodies in motion, for statics; kinetic energy counts as viscous work; collective."""
    anchor(step._loading)
    if step.motion is not None:
        step.ledger.release(step.motion.kinetic_energy())
        rest = np.zeros(step.discretization.owned)
        step.motion.move(rest, rest.copy())


def enter_given_state(step: Step) -> None:
    """Count the energy of a displacement that was given, not reached in steps, as supplied before a
    run in time; after its residual; collective."""
    given = not np.array_equal(step.discretization.u.x.array, step._reached)
    if step.motion is not None and global_any(step._comm, given):
        energy = step.ledger.energy().imbalance - step.motion.kinetic_energy()
        step.ledger.enter_start(-energy)


def cause(discretization: Discretization, reason: str) -> str:
    """Why an attempt failed: PETSc's reason, or MATERIAL_NOT_FINITE with the material;
    collective."""
    bodies = discretization.bodies.points
    told = discretization.mesh.comm.allgather(bodies.lost) if bodies else []
    lost = next(filter(None, told), "")
    return f"MATERIAL_NOT_FINITE {lost}" if lost else reason


def forces_at_start(step: Step) -> NDArray[np.float64]:
    """The residual at the start of a step, with the facets that it leaves out: with those of the
    last step the mean of both ends would do work that no energy has; collective [N].

    Bodies at points, whose stresses may depend on the time step, keep the forces that they had, and
    surfaces that slide, whose friction is that of the pressures that they had.
    """
    now, count = step.discretization, step.discretization.owned
    out = any(active.stabilization.left_out.any() for active in step._failing())
    if now.bodies.points or now.slides or not global_any(step._comm, out):
        return step.start.forces[:count]
    t = step._loading.t
    step._loading.move(step.start.t)
    found = step.assemble_residual(hold=True)[:count].copy()
    step._loading.move(t)
    return found
