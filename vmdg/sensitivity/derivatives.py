"""Direct differentiation of a run by parameters p of laws and bodies.

A converged step satisfies R(u, lambda, h_n, p) = 0, with the history h_n at its start and
h = h(u, lambda, h_n, p) at its end. With the tangent K of the step

    K.du/dp = -dR/dp - dlambda/dp dR/dlambda,

dR/dp at fixed u, with the derivatives of h_n and of tau_s along. They are differences between
return maps, and between forces where tau_s or moduli change; the derivative of h then follows from
two more return maps. At a given load factor dlambda/dp is zero. Where the path ended a step by
itself its rows have no fixed load factor: there du/dp is orthogonal to the path, which changes
neither the path nor a curve over any abscissa.

A jump has no derivative: history counts as fixed in it.

Source: Kleiber, Antunez, Hien and Kowalczyk, Parameter Sensitivity in Nonlinear Mechanics, 1997.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from dolfinx import fem
from dolfinx.la import InsertMode
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ..assembly.discretization import interface_forces, stabilization_anew
from ..assembly.point_matrices import local_tractions
from ..assembly.space import at_owners
from ..base.parallel import global_any, global_max, global_sum
from ..base.timers import timer
from ..base.units import power_of_two
from ..domain.topology import box_sides
from ..interface.history import InterfaceSnapshot, PointHistory
from ..interface.points import PointValues
from ..interface.return_map import Trial
from ..interface.stabilization import Stabilization
from ..linear.system import System
from ..problem.problem import Problem
from ..problem.states import Rate, Rates, Works
from .parameters import Parameter, parameters_of
from .point_rates import Change, point_rates
from .records import difference, plus, shifted, zeros

Array = NDArray[np.float64]

#: Values by name for the current state of a problem.
Row = Callable[[], Mapping[str, Any]]

#: Relative change of a parameter for differences.
CHANGE = 1e-6

#: The same for differences of rows of the history, of the row itself and one neighbour.
NEAR = 1e-7

#: The same for tau_s in a step.
MIDDLE = 1e-5

#: The same for quantities with more rounding, of two neighbours: energies, which are small
#: differences at finite strain, and tau_s, from eigenvalues.
FAR = 1e-4

#: Difference of r, relative, above which a step was repeated with a larger one.
RAISED = 1e-2

#: Displacement for differences, relative to the size of the body; at small strain they are exact.
MOVE = 1e-6


@dataclass
class _Partial:
    """Rates by a parameter at fixed displacement and load factor.

    Attributes:
        histories: Of the start of the step, of every interface.
        stabilizations: Of the step.
        trials: Of the input of return maps.
        changes: Whether more than history and law changes.
    """

    histories: list[PointHistory]
    stabilizations: list[Stabilization]
    trials: list[Trial]
    changes: bool


class Derivatives:
    """Carries the derivatives of a problem along its steps; all methods are collective.

    Args:
        problem: The problem, in its initial state or at the end of a run with the same parameters.
        names: Names of the parameters, see :mod:`.parameters`.
        energy: Whether derivatives of dissipated energies and external work are needed.

    Raises:
        ValueError: there is no such parameter, or the problem was already solved without
            derivatives.
    """

    def __init__(self, problem: Problem, names: Sequence[str], energy: bool):
        self._problem, self._energy = problem, energy
        self._parameters = parameters_of(problem, names)
        self._parts = problem.discretization
        self._actives = list(self._parts.active.values())
        self._field = fem.Function(problem.space)
        self._size = float(np.linalg.norm(box_sides(problem.mesh)))
        self._laws = {
            one.name: {h: one.laws(h) for h in (CHANGE, -CHANGE)} for one in self._parameters
        }
        step = problem.step
        names = [one.name for one in self._parameters]
        if step.rates is None or list(step.rates.by_name) != names:
            if problem.t != 0.0 or problem.u.x.array.any():
                raise ValueError(
                    "solve: derivatives are those of a whole run, but the problem is at load "
                    f"factor {problem.t:.8g} already: begin with a new Problem"
                )
            step.rates = Rates({one.name: self._first(one) for one in self._parameters})

    def _first(self, parameter: Parameter) -> Rate:
        """Rates of the initial state."""
        zero = np.zeros_like(self._problem.u.x.array)
        histories = []
        for i, active in enumerate(self._actives):
            damage = active.facets.damage[active.quadrature.facet]
            rate = zeros(active.history)
            if active.law.inelastic:
                more = damage * self._strength_rate(parameter, i)
                rate = replace(rate, softening=more + rate.softening)
            histories.append(rate)
        stabilizations = self._first_stabilizations(parameter)
        interfaces = [
            InterfaceSnapshot(history, zeros(active.values), stabilization)
            for history, active, stabilization in zip(
                histories, self._actives, stabilizations, strict=True
            )
        ]
        works = Works(np.zeros(3), np.zeros(2))
        return Rate(zero, 0.0, zero, interfaces, (works, works) if self._energy else None)

    def _strength_rate(self, parameter: Parameter, i: int) -> Array | float:
        """Rate of the strength of the law of an interface."""
        one, other = (self._laws[parameter.name][h][i].strength for h in (CHANGE, -CHANGE))
        return (one - other) / (2 * CHANGE)

    # A step

    def advance(self, system: System, follows: bool, onset: bool, dt: float) -> None:
        """Differentiate a converged step that is not yet committed.

        Args:
            system: Linear systems of the tangent.
            follows: Whether the load factor is an unknown of the step.
            onset: Whether the step then ends at the onset of damage, a corner of the path, with
                which its row moves.
            dt: Time step of its return maps [s].
        """
        step = self._problem.step
        with timer("derivatives"):
            before = step.rates.by_name
            given = [active.trial() for active in self._actives]
            partial = [self._partial(one, before[one.name], given) for one in self._parameters]
            begun = self._values(given, [one.trials for one in partial], dt)
            pulled = [
                self._forces(*known) for known in zip(self._parameters, partial, begun, strict=True)
            ]
            right, moved = (
                [-forces for forces in pulled],
                [np.zeros(self._parts.owned)] * len(begun),
            )
            if follows:
                right, moved = [*right, self._load_rate(dt)], [*moved, self._problem.loading.rate()]
            found = system.respond(right, moved)
            ways, factors = [], np.zeros(len(begun))
            if follows:
                along, under = found[-1]
                factors = self._factors(found, onset, given, partial, dt)
            for (u, forces), pull, t in zip(found[: len(begun)], pulled, factors, strict=True):
                forces = forces + pull
                if follows:
                    u, forces = u + t * along, forces + t * (under - right[-1])
                ways.append((self._everywhere(u), float(t), self._everywhere(forces)))
            trials = [
                [plus(*both) for both in zip(known.trials, along, strict=True)]
                for known, along in zip(
                    partial, (self._trials_along(u, t, given) for u, t, _ in ways), strict=True
                )
            ]
            ended = self._values(given, trials, dt)
            step.rates = replace(
                step.rates,
                by_name={
                    known[0].name: self._rate(*known, before[known[0].name])
                    for known in zip(self._parameters, partial, ways, ended, strict=True)
                },
                known=True,
            )

    def _factors(
        self,
        found: Sequence[tuple[Array, Array]],
        onset: bool,
        given: Sequence[Trial],
        partial: Sequence[_Partial],
        dt: float,
    ) -> Array:
        """dlambda/dp of a step whose load factor is unknown (parameters,).

        Args:
            found: Displacements at fixed load factor by parameter, and by the load factor, with
                their forces.
            onset: As of :meth:`advance`.
            given, partial, dt: Input of return maps and its rates by parameter, and time step.
        """
        *still, along = (u for u, _ in found)
        products = [along @ u for u in (*still, along)]
        *sums, square = global_sum(self._problem.comm, products)
        orthogonal = -np.array(sums) / (square or 1.0)
        if not onset:
            return orthogonal
        # The points that begin to fail stay at their strength. The way along the path counts as if
        # it were a further parameter, with unchanged laws.
        ways = [self._trials_along(self._everywhere(u), 0.0, given) for u in (*still, along)]
        rates = [
            [plus(*both) for both in zip(known.trials, way, strict=True)]
            for known, way in zip(partial, ways, strict=False)
        ]
        begun = self._beginning(self._values(given, rates, dt))
        laws = self._parameters[0].laws(0.0)
        scale = max(abs(self._problem.t), abs(float(orthogonal.max(initial=0.0))))
        further = [shifted(zeros(one), one, scale) for one in ways[-1]]
        moved = [
            point_rates(active, trial, [Change((law, law), rate)], CHANGE, dt)[0]
            for active, trial, law, rate in zip(self._actives, given, laws, further, strict=True)
        ]
        (rise,) = self._beginning([moved])
        return -begun * scale / rise if rise else orthogonal

    def _beginning(self, values: Sequence[Sequence[PointValues]]) -> Array:
        """Rates of the softening of all points that begin to fail in the step, by parameter."""
        totals = np.zeros(len(values))
        for i, active in enumerate(self._actives):
            if active.law.inelastic:
                rises = active.values.update.softening > active.history.softening
                weights = active.quadrature.weights * (rises & (active.history.mode == 0))
                totals += [weights @ one[i].update.softening for one in values]
        return global_sum(self._problem.comm, totals)

    def pass_jump(self) -> None:
        """Pass a step of a jump: history counts as fixed, and a broken bond as broken."""
        rates, by_name = self._problem.step.rates, {}
        for parameter in self._parameters:
            rate, interfaces = rates.by_name[parameter.name], []
            for i, (active, one) in enumerate(zip(self._actives, rate.interfaces, strict=True)):
                history = one.history
                if active.law.inelastic and active.values.update is not None:
                    broken = active.values.update.softening >= active.law.strength
                    whole = self._strength_rate(parameter, i)
                    softening = np.where(broken, whole, history.softening)
                    history = replace(history, softening=softening)
                interfaces.append(replace(one, history=history))
            works = rate.works and tuple(replace(w, increment=None) for w in rate.works)
            by_name[parameter.name] = replace(rate, interfaces=interfaces, works=works)
        jumps = rates.jumps + rates.known
        self._problem.step.rates = Rates(by_name, jumps, known=False)

    def _partial(self, parameter: Parameter, last: Rate, given: Sequence[Trial]) -> _Partial:
        """Rates at fixed displacement and load factor."""
        histories = [one.history for one in last.interfaces]
        stabilizations = self._stabilizations_of_step(parameter, last)
        changes = any(
            array.any()
            for one in stabilizations
            for array in (one.tau, one.weights, one.norm, one.delta_s)
        )
        # The pressure of a mean dilatation depends on the gaps at the facets of its cell.
        bodies = self._parts.bodies
        changes |= parameter.of_body or bodies.mean_dilatation or not bodies.small
        changes = global_any(self._problem.comm, changes)
        if changes:
            trials = self._trials_nearby(parameter, histories, stabilizations)
        else:
            trials = [
                replace(zeros(trial), gap=history.gap, softening=history.softening)
                if active.law.inelastic
                else zeros(trial)
                for active, trial, history in zip(self._actives, given, histories, strict=True)
            ]
        return _Partial(histories, stabilizations, trials, changes)

    def _forces(
        self, parameter: Parameter, partial: _Partial, values: Sequence[PointValues]
    ) -> Array:
        """dR/dp at fixed displacement, owned dofs [N]."""
        if partial.changes:
            return self._forces_nearby(parameter, partial.stabilizations, values)
        return self._forces_of_gaps(values)

    def _values(
        self, given: Sequence[Trial], rates: Sequence[Sequence[Trial]], dt: float
    ) -> list[list[PointValues]]:
        """Rates of the values at points by every parameter, for rates of the input of return maps
        by parameter and interface."""
        found = []
        for i, (active, trial) in enumerate(zip(self._actives, given, strict=True)):
            changes = [
                Change(tuple(self._laws[one.name][h][i] for h in (CHANGE, -CHANGE)), rate[i])
                for one, rate in zip(self._parameters, rates, strict=True)
            ]
            found.append(point_rates(active, trial, changes, CHANGE, dt))
        return [[one[k] for one in found] for k in range(len(self._parameters))]

    def _rate(
        self,
        parameter: Parameter,
        known: _Partial,
        way: tuple[Array, float, Array],
        values: Sequence[PointValues],
        last: Rate,
    ) -> Rate:
        """Rates at the end of the step, from those of displacement, load factor and forces, and of
        the values at points."""
        interfaces = [
            InterfaceSnapshot(history.after(value.update), value, stabilization)
            for history, value, stabilization in zip(
                known.histories, values, known.stabilizations, strict=True
            )
        ]
        found = Rate(*way, interfaces)
        if not self._energy:
            return found
        at_start = [
            replace(one, history=history)
            for one, history in zip(interfaces, known.histories, strict=True)
        ]
        beside = replace(found, interfaces=at_start)
        works = [
            self._works(parameter, beside, last, h, before)
            for h, before in zip((CHANGE, -CHANGE), last.works, strict=True)
        ]
        return replace(found, works=tuple(works))

    def _works(
        self, parameter: Parameter, rate: Rate, last: Rate, h: float, before: Works
    ) -> Works:
        """Works at a neighbouring value of the parameter, up to the end of the step."""
        problem, ledger = self._problem, self._problem.step.ledger
        start, loads = ledger.begun
        t = start.t + h * last.t
        if last.t and problem.loading.ray is not None:
            loads = problem.loading.ray.at(problem.loading.ray.vectors, t)
        interfaces = [
            replace(one, history=shifted(one.history, other.history, h))
            for one, other in zip(start.interfaces, last.interfaces, strict=True)
        ]
        moved = replace(
            start,
            t=t,
            u=start.u + h * last.u,
            forces=start.forces + h * last.forces,
            interfaces=interfaces,
        )
        with self._nearby(parameter, rate, h):
            return ledger.works_beside(moved, loads, before, finish=True)

    def _everywhere(self, values: Array) -> Array:
        """Values of owned dofs on local dofs, ghosts included."""
        self._field.x.array[: self._parts.owned] = values
        self._field.x.scatter_forward()
        return self._field.x.array.copy()

    # tau_s

    def _stabilizations_of_step(self, parameter: Parameter, last: Rate) -> list[Stabilization]:
        """Rates of tau_s and delta of the step, which are those of its start."""
        before = [one.stabilization for one in last.interfaces]
        if self._parts.constant_stabilization:
            return before
        start, applied = self._problem.step.start, [one.stabilization for one in self._actives]
        floors = [one.stabilization.norm for one in start.interfaces]
        rose = any((one.norm > low).any() for one, low in zip(applied, floors, strict=True))
        at_floor = not global_any(self._problem.comm, rose)
        loading, t = self._problem.loading, self._problem.t
        u = self._problem.u.x.array.copy()
        self._problem.u.x.array[:] = start.u
        loading.move(start.t)
        # Laws enter by the displacement alone, by little: one neighbour does.
        changes = (MIDDLE, -MIDDLE) if parameter.of_body else (CHANGE,)
        ends = [
            self._stabilization_at(parameter, h, last.u, floors, before, at_floor) for h in changes
        ]
        lower, width = (ends[1], 2 * MIDDLE) if parameter.of_body else (applied, CHANGE)
        self._problem.u.x.array[:] = u
        loading.move(t)
        self._parts.update_means(pressure=True)
        return [
            _where_own(difference(high, low, width / 2), high, here, last)
            for high, low, here, last in zip(ends[0], lower, applied, before, strict=True)
        ]

    def _first_stabilizations(self, parameter: Parameter) -> list[Stabilization]:
        """Rates of tau_s and delta in the initial state."""
        zero, floors = np.zeros_like(self._problem.u.x.array), []
        for active in self._actives:
            floors.append(np.zeros_like(active.floor))
        rates = [zeros(active.stabilization) for active in self._actives]
        ends = (
            self._stabilization_at(parameter, h, zero, floors, rates, at_floor=False)
            for h in (FAR, -FAR)
        )
        return [difference(a, b, FAR) for a, b in zip(*ends, strict=True)]

    def _stabilization_at(
        self,
        parameter: Parameter,
        h: float,
        u: Array,
        floors: Sequence[Array],
        rates: Sequence[Stabilization],
        at_floor: bool,
    ) -> list[Stabilization]:
        """tau_s and delta at p (1 + h) next to the current displacement, for rates of the
        displacement and of the lower bounds of r."""
        here = self._problem.u.x
        before = here.array.copy()
        bodies = global_any(self._problem.comm, parameter.of_body or bool(u.any()))
        here.array[:] = before + h * u
        bounds = [low + h * rate.norm for low, rate in zip(floors, rates, strict=True)]
        with parameter.changed(h):
            found = stabilization_anew(self._parts, bounds, bodies, at_floor)
        here.array[:] = before
        return found

    # Forces and trial tractions

    def _trials_nearby(
        self,
        parameter: Parameter,
        histories: Sequence[PointHistory],
        stabilizations: Sequence[Stabilization],
    ) -> list[Trial]:
        """Rates of the input of return maps at fixed displacement."""
        ends = []
        for h in (CHANGE, -CHANGE):
            with self._interfaces_at(h, histories, None, stabilizations), parameter.changed(h):
                ends.append([active.trial() for active in self._actives])
        return [difference(a, b, CHANGE) for a, b in zip(*ends, strict=True)]

    def _trials_along(self, u: Array, t: float, given: Sequence[Trial]) -> list[Trial]:
        """Rates of the input of return maps along a displacement, and a load factor."""
        problem, here = self._problem, self._problem.u.x
        size = global_max(problem.comm, float(np.abs(u).max(initial=0.0)))
        if size == 0:
            return [zeros(trial) for trial in given]
        straight = self._parts.bodies.linear and not problem.loading.pressurised
        h = float(power_of_two(self._size / size)) if straight else MOVE * self._size / size
        before, factor, ends = here.array.copy(), problem.t, []
        for end in (h,) if straight else (h, -h):
            here.array[:] = before + end * u
            if t:
                problem.loading.move(factor + end * t)
            self._parts.update_means()
            ends.append([active.trial() for active in self._actives])
        here.array[:] = before
        if t:
            problem.loading.move(factor)
        self._parts.update_means()
        # Halved twice if only one side is known.
        lower, width = (given, h / 2) if straight else (ends[1], h)
        return [difference(a, b, width) for a, b in zip(ends[0], lower, strict=True)]

    def _forces_of_gaps(self, values: Sequence[PointValues]) -> Array:
        """dR/dp where only gaps change, at small strain, owned dofs [N]: -Tt(eta).dzeta dA."""
        forces = fem.Function(self._problem.space)
        for active, rate, matrix in zip(self._actives, values, self._tractions, strict=True):
            if active.law.inelastic:
                forces.x.array[:] -= matrix @ rate.gap.ravel()
        forces.x.scatter_reverse(InsertMode.add)
        return forces.x.array[: self._parts.owned].copy()

    @cached_property
    def _tractions(self) -> list[csr_array]:
        """Transposes of int q.Tt(du) dA at small strain, over local dofs and gap components."""
        return [local_tractions(active) for active in self._actives]

    def _forces_nearby(
        self,
        parameter: Parameter,
        stabilizations: Sequence[Stabilization],
        values: Sequence[PointValues],
    ) -> Array:
        """dR/dp where tau_s or moduli change, owned dofs [N]."""
        parts, ends = self._parts, []
        before = parts.forces.x.array.copy()
        everything = parameter.of_body or parts.bodies.mean_dilatation
        for h in (CHANGE, -CHANGE):
            with self._interfaces_at(h, None, values, stabilizations), parameter.changed(h):
                if everything:
                    ends.append(parts.assemble_residual(None).copy())
                else:
                    ends.append(interface_forces(parts))
        parts.forces.x.array[:] = before
        parts.update_means(pressure=True)
        return (ends[0] - ends[1]) / (2 * CHANGE)

    def _load_rate(self, dt: float) -> Array:
        """-dR/dlambda at fixed displacement along the ray, owned dofs [N]."""
        problem, loading = self._problem, self._problem.loading
        ray = loading.ray
        if not (loading.pressurised or loading.strained(ray.start, ray.end)):
            return at_owners(problem.space, ray.rate(ray.vectors))
        t, change = loading.t, MOVE * (ray.end - ray.start)
        before, ends = self._parts.forces.x.array.copy(), []
        points = [active.snapshot() for active in self._actives]
        for end in (t + change, t - change):
            loading.move(end)
            ends.append(self._parts.assemble_residual(dt, False, loading.vector).copy())
        loading.move(t)
        for active, state in zip(self._actives, points, strict=True):
            active.return_to(state)
        self._parts.forces.x.array[:] = before
        self._parts.update_means(pressure=True)
        return -(ends[0] - ends[1]) / (2 * change)

    # Neighbouring states

    @contextmanager
    def _interfaces_at(
        self,
        h: float,
        histories: Sequence[PointHistory] | None,
        values: Sequence[PointValues] | None,
        stabilizations: Sequence[Stabilization],
    ) -> Iterator[None]:
        """All interfaces moved by h times these rates; None for no change."""
        before = [active.snapshot() for active in self._actives]
        for i, (active, state) in enumerate(zip(self._actives, before, strict=True)):
            state = replace(state, stabilization=shifted(state.stabilization, stabilizations[i], h))
            if histories is not None:
                state = replace(state, history=shifted(state.history, histories[i], h))
            if values is not None:
                state = replace(state, values=shifted(state.values, values[i], h))
            active.return_to(state)
        try:
            yield
        finally:
            for active, state in zip(self._actives, before, strict=True):
                active.return_to(state)

    @contextmanager
    def _nearby(self, parameter: Parameter, rate: Rate, h: float) -> Iterator[None]:
        """The problem in the state at p (1 + h)."""
        problem, parts = self._problem, self._parts
        u, forces = problem.u.x.array, parts.forces.x.array
        before, t = (u.copy(), forces.copy()), problem.t
        u += h * rate.u
        forces += h * rate.forces
        if rate.t:
            problem.loading.move(t + h * rate.t)
        parts.update_means(pressure=True)
        problem.loading.nearby, of = True, rate.interfaces
        records = (
            [one.history for one in of],
            [one.values for one in of],
            [one.stabilization for one in of],
        )
        try:
            with self._interfaces_at(h, *records), parameter.changed(h):
                yield
        finally:
            self._problem.loading.nearby = False
            u[:], forces[:] = before
            if rate.t:
                problem.loading.move(t)
            parts.update_means(pressure=True)

    # A row

    def columns(
        self, row: Mapping[str, Any], watched: Row, energies: Row | None
    ) -> dict[str, float]:
        """Derivatives of a row of the history, after the step is committed.

        Args:
            row: Values of the monitor by name, with or without a unit.
            watched: Returns them for the current state of the problem.
            energies: The same for energies; None for none.
        """
        rates, found = self._problem.step.rates, {}
        names = [name for name, value in row.items() if isinstance(value, float)]
        for parameter in self._parameters:
            rate = rates.by_name[parameter.name]
            changes = {"load": rate.t if rates.known else np.nan}
            near = self._near(parameter, rate, NEAR, watched) if rates.known else {}
            for name in names:
                changes[name] = (near[name] - row[name]) / NEAR if near else np.nan
            if energies is not None:
                ends = [self._near(parameter, rate, h, energies) for h in (FAR, -FAR)]
                for name in ends[0]:
                    change = (ends[0][name] - ends[1][name]) / (2 * FAR)
                    changes[name] = change if rates.known else np.nan
            for name, change in changes.items():
                found[f"d {_plain(name)}/d {parameter.name}"] = change / parameter.value
        return found | {"frozen [-]": rates.jumps}

    def _near(self, parameter: Parameter, rate: Rate, h: float, row: Row) -> Mapping[str, Any]:
        """A row at p (1 + h)."""
        ledger = self._problem.step.ledger
        works = ledger.works
        # Not numbers if they are not known.
        moved = Works(np.full(3, np.nan), np.full(2, np.nan))
        if rate.works is not None:
            ends = (one.dissipated for one in rate.works)
            dissipated = works.dissipated + h * np.subtract(*ends) / (2 * CHANGE)
            moved = replace(works, dissipated=dissipated, pending=None)
        ledger.works = moved
        try:
            with self._nearby(parameter, rate, h):
                return row()
        finally:
            ledger.works = works


def _where_own(
    rate: Stabilization, near: Stabilization, here: Stabilization, last: Stabilization
) -> Stabilization:
    """Rates, or those of the last step where the step was repeated with a larger r, which its start
    does not tell."""
    own = np.abs(near.norm - here.norm) <= RAISED * here.norm
    rows = {"tau": rate.tau, "norm": rate.norm, "safety": rate.safety}
    for name, values in rows.items():
        mask = own.reshape(-1, *[1] * (values.ndim - 1))
        rows[name] = np.where(mask, values, getattr(last, name))
    return replace(rate, **rows)


def _plain(column: str) -> str:
    """A column without its unit."""
    return column.rpartition(" [")[0] or column
