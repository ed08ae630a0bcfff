"""One interface with open facets: its terms in the forms, its return map and its history."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from ..base.agreement import together
from ..base.parallel import global_any
from ..base.quadrature import facet_degree
from ..domain.materials import Bodies
from ..forms.geometry import Geometry
from ..laws import Mode
from ..laws.base import dot, joined_laws, same_law, work_gradient
from ..points.facets import InterfaceFacets
from ..points.interface import Interface
from ..points.pair_points import NO_GAP, PairPoints
from ..points.pairing import PairedFacets
from ..points.points import FacetPoints, Points
from .fluid import Fluid
from .frame import TurningTangent
from .history import InterfaceSnapshot, PointHistory, with_rows, works
from .point_residual import PointResidual
from .return_map import ReturnMap, Trial, apply, evaluate
from .stabilization import Stabilization, Stabilizer
from .tangent import PointTangent
from .values import InterfaceState, PointValues, joined, rows_of


def _quadrature(mesh: Mesh, facets: InterfaceFacets, degree: int, geometry: Geometry) -> Points:
    if isinstance(facets, PairedFacets):
        return PairPoints(mesh, facets, degree, geometry)
    return FacetPoints(mesh, facets, degree, geometry)


#: Rounding of T of an open point, relative to r zeta, with room.
ROUNDING = 1e-12


class ActiveInterface:
    """An interface with its open facets and the state of their points.

    Open points that never had a bond, T = 0, leave -|{P.N}|^2/(2r) of (30): zero for the solution,
    but for its approximation the body would be softer near another one that it does not touch. The
    facets where all points are so at the start of a step, or in an iteration of a step from rest,
    are left out: with zero flux weights zeta = g makes T = s = 0, and no term remains. A facet is
    taken in, with its weights, in the first iteration in which one of its points closes with them,
    and then for the whole step: a decision by every state would alternate where -|{P.N}|^2/(2r)
    itself closes the gap. As s = 0 at its start, both forms have one energy there, and the energy
    of the step is that with the facet.

    Attributes:
        turns: Whether the law works in a frame that rotates with the interface.
        terms: Its terms of (27) and (30) at the points.
        stabilization: Stabilization in the forms; None before the first :meth:`apply`.
        floor: Largest r so far (nf,) [MPa/mm], a lower bound for the next step.
        fluid: Fluid between the crack faces; None for none.
    """

    def __init__(
        self, interface: Interface, facets: InterfaceFacets, u: fem.Function, bodies: Bodies
    ):
        space = u.function_space
        self.interface = interface
        self.facets = facets
        self.quadrature = _quadrature(
            space.mesh, facets, facet_degree(space.ufl_element().degree), bodies.geometry
        )
        self.law = facets.law.at(self.quadrature.facet)
        self._u, self._bodies = u, bodies
        self.stabilizer = self._make_stabilizer()
        self.fluid: Fluid | None = None
        self._make_evaluators()
        self.stabilization: Stabilization | None = None
        self.floor = np.zeros(len(facets.facets))
        damage = facets.damage[self.quadrature.facet] if self.law.inelastic else np.zeros(0)
        self.history = PointHistory.start(self.law.strength * damage, self.quadrature.d)
        if self.quadrature.distance is not None:
            given = self.quadrature.distance, self.quadrature.normal
            self.history = self.history.apart(*given)
        self.values = self._return_map.start()
        self._made_at: tuple[object, ...] = (None, None, None)
        # For a resumed run, the work gradient of the last step before.
        self._resumed: NDArray[np.float64] | None = None
        self._overstress_modulus: NDArray[np.float64] | None = None
        self._cycles: NDArray[np.float64] | None = None
        # Whether the step starts from undeformed bodies; facets that were taken in during it.
        self._at_rest, self._kept = False, np.zeros(0, dtype=np.intp)

    def _make_stabilizer(self) -> Stabilizer:
        return Stabilizer(self.interface, self.quadrature, self._u, self._bodies)

    def _make_evaluators(self) -> None:
        given = self.quadrature, self._u, self._bodies
        pressure = None if self.fluid is None else self.fluid.pressure
        self._return_map = ReturnMap(self.interface, *given, pressure)
        self.turns = self._return_map.turns
        self.terms = PointResidual(*given, self.interface.traction_jump, pressure)
        self.__dict__.pop("point_tangent", None)

    # At the current displacement

    def apply(self, stabilization: Stabilization) -> float:
        """Set tau_s and the flux weights of the forms for a step; the resulting change of the
        energy (30) at this rank's points [N mm; N in plane strain]; collective."""
        before = self.stabilization
        self._set_stabilization(stabilization)
        if self.law.inelastic:
            self.stabilizer.check_softening(stabilization)
            if before is not None:
                self._follow_penalty(np.maximum(stabilization.norm - before.norm, 0.0))
        energy = 0.0 if before is None else self._energy_between(before, self.stabilization)
        released = self._leave_out_open() if lets_go(self) else 0.0
        return energy + released * (before is not None)

    def _leave_out_open(self) -> float:
        """Leave out the facets that are open everywhere, with zeta = g; the resulting change of the
        energy (30) at this rank's points [N mm; N in plane strain]; collective."""
        q, r, out = self.quadrature, self.stabilization.norm, self._idle()
        moved = global_any(q.mesh.comm, self._u.x.array.any())
        self._at_rest, self._kept = not moved, self._labels[:0]
        if self._at_rest or not out.any():
            return 0.0
        trial = self.trial()
        out[q.facet[self._widths(trial) <= 0]] = False
        self._leave_out(out)
        if not out.any():
            return 0.0
        R = np.eye(q.d)[None] if trial.R is None else trial.R
        rows = out[q.facet]
        r, s = r[q.facet, None], self.values.elastic_opening
        flux = trial.total - r * trial.opening
        energy = rows * q.weights @ np.einsum("pi,pi->p", flux + r * s / 2, s)
        known = {"gap": trial.opening, "traction": 0.0}
        inside = apply(R.swapaxes(1, 2), trial.opening)
        if trial.R is not None:
            known |= {"frame_total": r * inside, "frame_gap": inside, "frame_traction": 0.0}
        for name, value in known.items():
            array = getattr(self.values, name)
            mark = rows.reshape(-1, *[1] * (array.ndim - 1))
            known[name] = np.where(mark, value, array)
        self.values = replace(self.values, **known)
        self._open_gaps(np.where(rows[:, None], inside, self.history.gap), rows)
        return -float(energy)

    def _leave_out(self, out: NDArray[np.bool_]) -> None:
        """Leave these facets out of the forms (nf,), and no others."""
        weights = self.stabilizer.flux_weights(self.stabilization.delta)
        weights = np.where(out[:, None, None, None], 0.0, weights)
        self.stabilization = replace(self.stabilization, weights=weights)

    @property
    def _labels(self) -> NDArray[np.intp]:
        """Numbers of the facets, the same in all iterations (nf,)."""
        return np.arange(len(self.facets.facets))

    def _idle(self) -> NDArray[np.bool_]:
        """Facets without a traction at the start of the step that never had a bond: of a law
        without one, or broken from the start where bodies do not slide."""
        facets = np.ones(len(self.facets.facets), dtype=bool)
        if self.law.has_bond:
            facets &= not self.facets.slides and self.facets.damage == 1.0
        facets[self.quadrature.facet[self.history.traction.any(axis=1)]] = False
        return facets

    def _widths(self, trial: Trial) -> NDArray[np.float64]:
        """Normal openings with or without the fluxes, whichever is smaller (nq,) [mm]; zero where
        they are rounding."""
        normal = trial.N if trial.R is None else apply(trial.R, trial.N)
        width = np.minimum(dot(trial.total, normal) / trial.r, dot(trial.opening, normal))
        rounding = NO_GAP * self.quadrature.extent[self.quadrature.facet]
        return np.where(np.abs(width) <= rounding, 0.0, width)

    def _open_gaps(self, gap: NDArray[np.float64], rows: NDArray[np.bool_]) -> None:
        """Set zeta of the history (nq, d) [mm], with s = 0 at some points (nq,)."""
        self.history = replace(self.history, gap=gap)

    def _energy_between(self, before: Stabilization, after: Stabilization) -> float:
        """Difference of (30) at the current state [N mm; N in plane strain].

        (30) is linear in tau_s and in delta_1 = I - delta_2, and so in delta_s.
        """
        q, values = self.quadrature, self.values
        s, jump = values.elastic_opening, values.jump
        weights = (after.weights - before.weights)[q.facet, 0]
        penalty = apply((after.penalty - before.penalty)[q.facet], s)
        energy = np.einsum("pi,pi->p", s, apply(weights, jump) + penalty / 2)
        if self.interface.traction_jump:
            delta_s = (after.delta_s - before.delta_s)[q.facet]
            energy -= np.einsum("pi,pi->p", jump, apply(delta_s, jump)) / 2
        return float(energy @ q.weights)

    def _follow_penalty(self, change: NDArray[np.float64]) -> None:
        """Update C of the last return map for a larger r.

        dT_tr = dT + r d zeta, and d zeta/dT depends on the law alone, so C^-1 - r is unchanged:
        with C of the old r a softening point would soften additionally by the change. Where r
        decreases, part of H is neglected, which makes the first correction a conservative one.
        """
        if not change.any():
            return
        C = self.values.compliance
        more = np.eye(self.quadrature.d) + change[self.quadrature.facet][:, None, None] * C
        self.values = replace(self.values, compliance=np.linalg.solve(more, C))

    def _set_stabilization(self, stabilization: Stabilization) -> None:
        self.stabilization, self.floor = stabilization, stabilization.norm

    # Surfaces that slide

    @property
    def couplings(self) -> NDArray[np.int32]:
        """Rows (cell 1, facet in it, cell 2, facet in it) that are coupled in matrices, flat."""
        return self.facets.rows(np.ones(len(self.facets.facets), dtype=bool))

    def couple(self) -> bool:
        """If pairs are not coupled, couple all facets near each other from now on; return whether
        this was needed."""
        return False

    def pair(self, release: bool = False) -> None:
        """Pair the surfaces in the configuration of the current displacement, with ``release`` also
        facets whose bond is broken everywhere, from now on."""

    # Return maps

    def start(self) -> PointValues:
        return self._return_map.start()

    def trial(self, closes: bool = False) -> Trial:
        """Input of the return map of the step at the current displacement, with ``closes`` taking
        in facets that were left out and now touch."""
        known, q = self.stabilization, self.quadrature
        out = known.left_out if lets_go(self) else np.zeros(0, dtype=bool)
        if out.any():
            known = replace(known, weights=self.stabilizer.flux_weights(known.delta))
        trial = self._return_map.trial(known, self.history, self._overstress_modulus, self._cycles)
        if closes and self._at_rest and lets_go(self):
            opened = self._idle() & ~np.isin(self._labels, self._kept)
            opened[q.facet[self._widths(trial) <= 0]] = False
            if (opened & ~out).any():
                out |= opened
                self._leave_out(out)
        if not out.any():
            return trial
        if closes and (closed := out[q.facet] & (self._widths(trial) < 0)).any():
            labels = self._labels[q.facet[closed]]
            self._kept = np.union1d(self._kept, labels)
            out[q.facet[closed]] = False
            self._leave_out(out)
        alone = trial.r[:, None] * trial.opening
        return replace(trial, total=np.where(out[q.facet, None], alone, trial.total))

    def go_between(self, start: PointHistory, end: PointValues, share: float) -> None:
        """Set values at the current displacement, with zeta at a fraction of its change in the
        step."""
        trial = self.trial()
        if end.update is not None:
            gap = start.gap + share * (end.update.gap - start.gap)
            trial = replace(trial, gap=gap)
        self.take(evaluate(self.law, trial, 1.0, end))

    def take(self, values: PointValues) -> None:
        """Store the result of a return map at the points, of which the residual is made."""
        self.values = values
        self._made_at = self._state()

    def _state(self) -> tuple[object, ...]:
        return self.values, self.stabilization, self.quadrature.field(self._u)

    @property
    def up_to_date(self) -> bool:
        """Whether the values are those of the present displacement and tau_s; eigenstrains may have
        changed."""
        return all(a is b for a, b in zip(self._made_at, self._state(), strict=True))

    @cached_property
    def point_tangent(self) -> PointTangent:
        """The tangent at the points; compiles its kernels, collective."""
        return PointTangent(
            self.quadrature,
            self._u,
            self._bodies,
            jump=self.interface.traction_jump,
            fluid=None if self.fluid is None else self.fluid.pressure,
        )

    def tangent(
        self, damage: bool = True
    ) -> tuple[
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64] | None,
        TurningTangent | None,
    ]:
        """D dA and Tt dA at the points, see :class:`.PointTangent`, and from what they are made:
        C = d zeta/dT and the changes by a rotating frame; collective."""
        changes = self._return_map.tangent(self.values) if damage else (None, None)
        return *self.point_tangent(self.stabilization, self.values, *changes), *changes

    def state(self) -> InterfaceState:
        q, history, values = self.quadrature, self.history, self.values
        count, d, inelastic = len(q.weights), q.d, self.law.inelastic
        rotation = values.rotation
        return InterfaceState(
            points=q.points,
            weights=q.weights,
            normal=q.normal,
            opening=values.opening,
            gap=values.gap if inelastic else np.zeros((count, d)),
            softening=history.softening if inelastic else np.zeros(count),
            traction=values.traction,
            mode=history.mode if inelastic else np.full(count, Mode.ELASTIC, dtype=np.int8),
            rotation=np.tile(np.eye(d), (count, 1, 1)) if rotation is None else rotation,
            facet=self.facets.facets[q.facet],
            damage=history.softening / self.law.strength if self.law.has_bond else np.ones(count),
        )

    @property
    def bonded_area(self) -> float:
        """Reference area of this rank's open facets with their bond as it was at the start
        [mm2; mm in plane strain]."""
        return float(self.quadrature.weights.sum())

    # Steps

    def slow_down(self, overstress: float, cycles: float = 0.0) -> None:
        """Set the overstress and the number of cycles of the step.

        Args:
            overstress: Overstress modulus at points that are bonded at the start, in multiples of
                H, to bridge an unstable stage; 0 for the plain law.
            cycles: Load cycles that the step represents; they affect fatigue laws only.
        """
        self._overstress_modulus = None
        wears = self.law.fatigues and cycles > 0
        self._cycles = np.full(len(self.quadrature.weights), cycles) if wears else None
        if self.law.inelastic and overstress != 0:
            bonded = self.history.softening < self.law.strength
            self._overstress_modulus = overstress * self.law.softening_modulus * bonded

    def settle(self) -> None:
        """Before the works of a step: the tractions that points had at its start, where surfaces
        slide; collective."""

    def commit(self) -> None:
        """Accept the last return map as the converged history."""
        self.history = self.history.after(self.values.update)

    def take_traction(self) -> None:
        """Copy the traction of the last residual into the history: new facets have carried it
        too."""
        if self.law.inelastic:
            self.history = replace(self.history, traction=traction_in_frame(self.values))

    def snapshot(self) -> InterfaceSnapshot:
        """The current state; its arrays are never modified."""
        share = None if self.fluid is None else self.fluid.share
        known = self.history, self.values, self.stabilization, share
        return InterfaceSnapshot(*known, up_to_date=self.up_to_date)

    def return_to(self, snapshot: InterfaceSnapshot) -> None:
        self.history, self.values = snapshot.history, snapshot.values
        if snapshot.gradient is not None:
            self._resumed = snapshot.gradient
        self._set_stabilization(snapshot.stabilization)
        if self.fluid is not None and snapshot.share is not None:
            self.fluid.share = snapshot.share
        if snapshot.up_to_date:
            self._made_at = self._state()

    def continue_from(self, other: ActiveInterface) -> None:
        """Copy history, floor and fluid of the facets of ``other``; new facets have none."""
        theirs = other.quadrature.points_of_facet
        position = self.facets.rows_of(other.facets)
        mine = self.quadrature.points_of_facet[position]
        points, others = self.quadrature.points[mine], other.quadrature.points[theirs]
        apart = np.linalg.norm(points[:, :, None] - others[:, None], axis=3)
        if (apart.argmin(axis=2) != np.arange(points.shape[1])).any():
            raise RuntimeError("the order of the points of a facet changed")
        self.floor = np.zeros(len(self.facets.facets))
        self.floor[position] = other.floor
        self.values = with_rows(self.values, mine, other.values, theirs)
        if self.law.inelastic:
            self.history = with_rows(self.history, mine, other.history, theirs)
        if self.fluid is not None:
            share = self.fluid.share.copy()
            share[mine] = other.fluid.share[theirs]
            self.fluid.share = share

    def works(self) -> NDArray[np.float64]:
        """Dissipation of this rank's points in the step, (39), by damage, friction and viscosity
        (3,) [N mm; N in plane strain]."""
        update, q = self.values.update, self.quadrature
        if update is None:
            return np.zeros(3)
        r = self.stabilization.norm[q.facet]
        return works(self.history, update, self.law, q.normal, r) @ q.weights

    def work_gradient(self, dt: float) -> NDArray[np.float64]:
        """d damage work/d T_tr of the last return map, in the frame of the law (nq, d) [mm].

        For a resumed run it is read from the checkpoint.
        """
        update, history, q = self.values.update, self.history, self.quadrature
        if update is None:
            return self._resumed if self._resumed is not None else np.zeros((len(q.weights), q.d))
        r = self.stabilization.norm[q.facet]
        load = update.traction + r[:, None] * (update.gap - history.gap)
        r = r if self._overstress_modulus is None else r + self._overstress_modulus
        cycles = () if self._cycles is None else (self._cycles,)
        known = q.normal, history.gap, history.softening, r, dt, *cycles
        return work_gradient(self.law, update, load, *known)


def total_in_frame(active: ActiveInterface) -> NDArray[np.float64]:
    """{P.N} + r g at the current displacement, in the frame of the law (nq, d) [MPa]."""
    trial = active.trial()
    return trial.total if trial.R is None else np.einsum("pji,pj->pi", trial.R, trial.total)


def last_total(active: ActiveInterface) -> NDArray[np.float64]:
    """The same at the last return map, from T = {P.N} + r (g - zeta) (nq, d) [MPa]."""
    T, gap, R = active.values.traction, active.values.gap, active.values.rotation
    total = T + active.stabilization.norm[active.quadrature.facet, None] * gap
    return total if R is None else np.einsum("pji,pj->pi", R, total)


def trial_of(active: ActiveInterface, stabilization: Stabilization, history: PointHistory) -> Trial:
    """Input of the return map at the current displacement for another tau_s and history, in both of
    which it is linear."""
    return active._return_map.trial(stabilization, history, None, None)


def traction_in_frame(values: PointValues) -> NDArray[np.float64]:
    """T in the frame of the law (nq, d) [MPa]."""
    T, R = values.traction, values.rotation
    return T if R is None else np.einsum("pji,pj->pi", R, T)


def update_points(interfaces: Sequence[ActiveInterface], dt: float, hold: bool = False) -> None:
    """Return maps of a step, jointly for all interfaces with equal laws and frames.

    A return map of few points takes as long as that of thousands.
    """
    for group in _with_equal_laws(interfaces):
        trials = [active.trial(closes=not hold) for active in group]
        last = joined([replace(active.values, update=None) for active in group]) if hold else None
        law, trial = joined_laws([active.law for active in group]), joined(trials)
        comm = group[0].quadrature.mesh.comm
        values = together(comm, partial(evaluate, law, trial, dt, last))
        ends = np.cumsum([len(trial.opening) for trial in trials])
        for active, trial, end in zip(group, trials, ends, strict=True):
            alone = len(group) == 1
            active.take(values if alone else rows_of(values, slice(end - len(trial.opening), end)))


def resume(active: ActiveInterface, gradient: NDArray[np.float64]) -> None:
    """Take the work gradient of the last step of a run that continues here (nq, d) [mm]."""
    active._resumed = gradient


def lets_go(active: ActiveInterface) -> bool:
    """Whether facets are left out where they are open: their law can fail, and there is no fluid to
    push them."""
    bare = active.fluid is None and not active.interface.traction_jump
    return bare and active.interface.law.inelastic


def take_fluid(active: ActiveInterface) -> None:
    """Add a fluid between the crack faces, at zero pressure."""
    assert not active.facets.slides
    active.fluid = Fluid(active.quadrature, active._u, active._bodies)
    active._make_evaluators()


def compile_kernels(active: ActiveInterface, residual: bool) -> None:
    """Compile the kernels of the tangent now, and those of the residual if it is a sum over points;
    collective."""
    _ = active.point_tangent
    if residual:
        active.terms.compile()


def take_in(active: ActiveInterface) -> None:
    """Take in all facets that were left out."""
    if lets_go(active):
        active._leave_out(np.zeros(len(active.facets.facets), dtype=bool))


def at_rest(active: ActiveInterface) -> bool:
    """Whether the step starts from undeformed bodies, and facets may be left out in it."""
    return active._at_rest


def take_overlap(active: ActiveInterface) -> None:
    """Copy the traction of points that overlap at the start into the history. Others carry nothing,
    and those that touch have no gap: with a rounding of these they would count as loaded, or as
    open."""
    active.take_traction()
    q, history = active.quadrature, active.history
    along, rounding = dot(q.distance, q.normal), NO_GAP * q.extent[q.facet]
    apart, touches = (rows[:, None] for rows in (along >= -rounding, np.abs(along) <= rounding))
    traction = np.where(apart, 0.0, history.traction)
    active.history = replace(history, traction=traction, gap=np.where(touches, 0.0, history.gap))


def goes_on(active: ActiveInterface) -> None:
    """No more facets are left out, also where bodies were undeformed when tau_s was set: without an
    iteration in which forces balance, the energy would jump."""
    active._at_rest = False


def fine_scales(active: ActiveInterface) -> NDArray[np.float64]:
    """Fine-scale displacement (24) of sides 1 and 2 at the points (nq, 2, d) [mm].

    In the signs of the code: -delta_s.[[P.N]] + delta_1^T.s and -delta_s.[[P.N]] - delta_2^T.s.
    """
    facet, values, stabilization = active.quadrature.facet, active.values, active.stabilization
    flux = apply(stabilization.delta_s[facet], values.jump)
    share = np.einsum("paji,pj->pai", stabilization.weights[facet], values.elastic_opening)
    return np.array([1.0, -1.0])[:, None] * share - flux[:, None]


def meets_or_parts(active: ActiveInterface) -> bool:
    """Whether points of this rank begin or cease to touch in the step, which had no bond before."""
    if active.values.update is None or not len(active.quadrature.weights):
        return False
    before, now = (one.traction.any(axis=1) for one in (active.history, active.values))
    return bool(((before != now) & ~(active.history.softening < active.law.strength)).any())


def damage_work(active: ActiveInterface, points: NDArray[np.bool_] | slice = slice(None)) -> float:
    """Damage work of some of this rank's points that stay in the step, the first of
    :meth:`.ActiveInterface.works` [N mm; N in plane strain]."""
    if active.values.update is None:
        return 0.0
    kept = active.quadrature.kept
    work, weights = active.values.update.damage_work[kept], active.quadrature.weights[kept]
    return float(work[points] @ weights[points])


def pressed(active: ActiveInterface) -> NDArray[np.bool_]:
    """Points whose faces pressed on each other in the last converged state (nq,): T.N < 0, beyond
    the rounding of r zeta, which T of an open point is."""
    q, history = active.quadrature, active.history
    known = active.stabilization
    r = 0.0 if known is None else known.norm[q.facet]
    return dot(history.traction, q.normal) < -ROUNDING * r * np.linalg.norm(history.gap, axis=1)


def interface_flux(active: ActiveInterface) -> NDArray[np.float64]:
    """The interface terms of (27) with dA, conjugate to jets at the points (nq, jet)."""
    areas = active.point_tangent.areas
    return active.terms(active.stabilization, active.values) * areas[:, None]


def interface_energy(active: ActiveInterface, anew: bool = False) -> float:
    """Energy (30) at this rank's points [N mm; N in plane strain]; ``anew`` if eigenstrains have
    changed since the last return map."""
    if active.stabilization is None:
        return 0.0
    values = active.values
    if anew or not active.up_to_date:
        # Tractions again, with its zeta.
        trial = active.trial()
        if active.law.inelastic:
            R, gap = values.rotation, values.gap
            trial = replace(trial, gap=gap if R is None else np.einsum("pji,pj->pi", R, gap))
        values = evaluate(active.law, trial, 1.0, values)
    energy = active.terms.energy(active.stabilization, values)
    if active.fluid is None:
        return energy
    # The traction has the fluid in it, whose work is that of a load.
    lost = active.fluid.intrusion(active.values, active.stabilization)
    p = active.fluid.pressure.x.array[: len(lost)]
    return energy - float((p * lost) @ active.quadrature.weights)


def recoverable_energy(active: ActiveInterface) -> float:
    """Recoverable work in the gap at this rank's points [N mm]."""
    if not active.law.inelastic:
        return 0.0
    history, q = active.history, active.quadrature
    return float(q.weights @ active.law.stored_energy(history.gap, q.normal, history.softening))


def _starts_apart(active: ActiveInterface) -> bool:
    return active.quadrature.initial_gap is not None


def _with_equal_laws(interfaces: Sequence[ActiveInterface]) -> list[list[ActiveInterface]]:
    groups: list[list[ActiveInterface]] = []
    for active in interfaces:
        for group in groups:
            one = group[0]
            alike = one.turns == active.turns and _starts_apart(one) == _starts_apart(active)
            if alike and same_law(one.interface.law, active.interface.law):
                group.append(active)
                break
        else:
            groups.append([active])
    return groups
