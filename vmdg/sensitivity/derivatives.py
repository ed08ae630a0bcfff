"""Direct differentiation of a run by parameters p of laws and bodies.

A converged step satisfies R(u, lambda, h_n, p) = 0, with the history h_n at its start and
h = h(u, lambda, h_n, p) at its end. With the tangent K of the step

    K.du/dp = -dR/dp - dlambda/dp dR/dlambda,

dR/dp at fixed u, with the derivatives of h_n and of tau_s along. They are differences between
return maps, and between forces where tau_s or moduli change; the derivative of h then follows from
that of the return map by the trial traction. At a given load factor dlambda/dp is zero. Where the
path ended a step by itself its rows have no fixed load factor: there du/dp is orthogonal to the
path, which changes neither the path nor a curve over any abscissa.

A jump has no derivative: history counts as fixed in it.

Source: Kleiber, Antunez, Hien and Kowalczyk, Parameter Sensitivity in Nonlinear Mechanics, 1997.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..assembly.discretization import interface_forces
from ..base.parallel import global_any, global_norm, global_sum
from ..base.timers import timer
from ..interface.active import ActiveInterface, lets_go
from ..interface.history import InterfaceSnapshot, PointHistory
from ..interface.return_map import Trial
from ..interface.stabilization import Stabilization
from ..interface.values import PointValues
from ..linear.system import System
from ..problem.problem import Problem
from ..problem.states import Rate, Rates, Works
from .neighbours import Neighbours
from .parameters import Parameter, parameters_of
from .point_rates import PointRates
from .records import CHANGE, one_of, stacked, zeros
from .rows import Row, Rows
from .stabilization_rates import StabilizationRates

Array = NDArray[np.float64]

#: Resistance of a body that floats, relative to the norm of K: rounding.
SINGULAR = 1e-13


@dataclass
class _Partial:
    """Rates by a parameter at fixed displacement and load factor."""

    histories: list[PointHistory]  # Of the start of the step, of every interface
    stabilizations: list[Stabilization]
    trials: list[Trial]
    changes: bool


class Derivatives:
    """Carries the derivatives of a problem along its steps; all methods are collective.

    Args:
        names: Names of the parameters, or values by name, see :mod:`.parameters`.
        energy: Whether derivatives of dissipated energies and external work are needed.
    """

    def __init__(self, problem: Problem, names: Sequence[str] | Mapping[str, float], energy: bool):
        self._problem, self._energy = problem, energy
        self._parameters = parameters_of(problem, names)
        self._neighbours = Neighbours(problem)
        self._discretization, self._actives = (
            self._neighbours.discretization,
            self._neighbours.actives,
        )
        self._stabilizations = StabilizationRates(problem)
        self._rows = Rows(self._neighbours, self._parameters)
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
        zero = np.zeros_like(self._problem.u.x.array)
        histories = []
        for i, active in enumerate(self._actives):
            damage = active.facets.damage[active.quadrature.facet]
            rate = zeros(active.history)
            if active.law.inelastic:
                more = damage * self._strength_rate(parameter, i)
                rate = replace(rate, softening=more + rate.softening)
            histories.append(rate)
        stabilizations = self._stabilizations.first(parameter)
        interfaces = [
            InterfaceSnapshot(history, zeros(active.values), stabilization)
            for history, active, stabilization in zip(
                histories, self._actives, stabilizations, strict=True
            )
        ]
        works = Works(np.zeros(3), np.zeros(2))
        return Rate(zero, 0.0, zero, interfaces, (works, works) if self._energy else None)

    def _strength_rate(self, parameter: Parameter, i: int) -> Array | float:
        one, other = (self._laws[parameter.name][h][i].strength for h in (CHANGE, -CHANGE))
        return (one - other) / (2 * CHANGE)

    # A step

    def advance(self, system: System, follows: bool, onset: bool, dt: float) -> None:
        """Differentiate a converged step that is not yet committed.

        Args:
            follows: Whether the load factor is an unknown of the step.
            onset: Whether the step then ends at the onset of damage, a corner of the path, with
                which its row moves.
        """
        step, near = self._problem.step, self._neighbours
        with timer("derivatives"):
            before = [step.rates.by_name[one.name] for one in self._parameters]
            given = [active.trial() for active in self._actives]
            stabilizations = self._stabilizations.of_step(self._parameters, before)
            partial = [
                self._partial(*known, given)
                for known in zip(self._parameters, before, stabilizations, strict=True)
            ]
            points = self._point_rates(given, partial, dt)
            begun = self._by_parameter([one.at_rest() for one in points])
            here = interface_forces(self._discretization)
            pulled = [
                near.forces(parameter, known.stabilizations, values, here)
                if known.changes
                else near.forces_of_gaps(values)
                for parameter, known, values in zip(self._parameters, partial, begun, strict=True)
            ]
            right = [-forces for forces in pulled]
            moved = [near.held(rate) for rate in before]
            if follows:
                right.append(near.load_rate(dt))
                moved.append(self._problem.loading.rate())
            found = self._responses(system, right, moved)
            ways, factors = [], np.zeros(len(begun))
            if follows:
                along, under = found[-1]
                factors = self._factors(found, onset, given, points)
            for (u, forces), pull, t in zip(found[: len(begun)], pulled, factors, strict=True):
                forces = forces + pull
                if follows:
                    u, forces = u + t * along, forces + t * (under - right[-1])
                ways.append((near.everywhere(u), float(t), near.everywhere(forces)))
            moves = self._moves([(u, t) for u, t, _ in ways], given)
            ended = [one.along(move) for one, move in zip(points, moves, strict=True)]
            known = zip(
                self._parameters, partial, ways, self._by_parameter(ended), before, strict=True
            )
            by_name = {parameter.name: self._rate(parameter, *rest) for parameter, *rest in known}
            step.rates = replace(step.rates, by_name=by_name, known=True)

    def _responses(
        self, system: System, right: Sequence[Array], moved: Sequence[Array]
    ) -> list[tuple[Array, Array]]:
        """Displacements and forces K.du; zero where a force that is rounding only moves a body that
        floats, once its bond is broken, without resistance."""
        comm, loading, found = self._problem.comm, self._problem.loading, []
        for force, held, (du, balance) in zip(
            right, moved, system.respond(right, moved), strict=True
        ):
            stiff = SINGULAR * system.norm * global_norm(comm, du)
            floats = global_norm(comm, loading.balance(force.copy())) <= stiff
            if floats and not global_any(comm, bool(held.any())):
                du, balance = np.zeros_like(du), np.zeros_like(balance)
            found.append((du, balance))
        return found

    def _factors(
        self,
        found: Sequence[tuple[Array, Array]],
        onset: bool,
        given: Sequence[Trial],
        points: Sequence[PointRates],
    ) -> Array:
        """dlambda/dp of a step whose load factor is unknown (parameters,), from displacements at
        fixed load factor by parameter, and by the load factor, with their forces."""
        *still, along = (u for u, _ in found)
        products = [along @ u for u in (*still, along)]
        *sums, square = global_sum(self._problem.comm, products)
        orthogonal = -np.array(sums) / (square or 1.0)
        if not onset:
            return orthogonal
        # The points that begin to fail stay at their strength.
        near, total = self._neighbours, np.zeros(len(found))
        moves = self._moves([(near.everywhere(u), 0.0) for u, _ in found], given)
        for active, rates, move in zip(self._actives, points, moves, strict=True):
            if active.law.inelastic:
                rises = active.values.update.softening > active.history.softening
                weights = active.quadrature.weights * (rises & (active.history.mode == 0))
                total += rates.softening(move) @ weights
        *begun, rise = global_sum(self._problem.comm, total)
        return -np.array(begun) / rise if rise else orthogonal

    def _moves(self, ways: Sequence[tuple[Array, float]], given: Sequence[Trial]) -> list[Trial]:
        """Rates of the input of the return maps of every interface along displacements and load
        factors; stacks."""
        moves = (self._neighbours.trials_along(u, t, given) for u, t in ways)
        return [stacked(of_interface) for of_interface in zip(*moves, strict=True)]

    def _by_parameter(self, stacks: Sequence[PointValues]) -> list[list[PointValues]]:
        """Of every parameter those of every interface, from a stack of every interface."""
        return [[one_of(stack, k) for stack in stacks] for k in range(len(self._parameters))]

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

    def _partial(
        self,
        parameter: Parameter,
        last: Rate,
        stabilizations: list[Stabilization],
        given: Sequence[Trial],
    ) -> _Partial:
        """Rates at fixed displacement and load factor."""
        ends = zip(self._actives, self._problem.step.start.interfaces, last.interfaces, strict=True)
        histories = [_history(*known) for known in ends]
        changes = any(
            array.any()
            for one in stabilizations
            for array in (one.tau, one.weights, one.norm, one.delta_s)
        )
        # The pressure of a mean dilatation depends on the gaps at the facets of its cell.
        bodies = self._discretization.bodies
        changes |= parameter.of_body or bodies.mean_dilatation or not bodies.small
        changes = global_any(self._problem.comm, changes)
        if changes:
            trials = self._neighbours.trials(parameter, histories, stabilizations, given)
        else:
            trials = [
                replace(zeros(trial), gap=history.gap, softening=history.softening)
                if active.law.inelastic
                else zeros(trial)
                for active, trial, history in zip(self._actives, given, histories, strict=True)
            ]
        return _Partial(histories, stabilizations, trials, changes)

    def _point_rates(
        self, given: Sequence[Trial], partial: Sequence[_Partial], dt: float
    ) -> list[PointRates]:
        """Rates at the points of every interface, for rates of the input of return maps at fixed
        displacement."""
        found = []
        for i, (active, trial) in enumerate(zip(self._actives, given, strict=True)):
            laws = tuple(
                [self._laws[one.name][h][i] for one in self._parameters] for h in (CHANGE, -CHANGE)
            )
            rates = stacked([known.trials[i] for known in partial])
            found.append(PointRates(active, trial, laws, rates, dt))
        return found

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
            self._rows.works(parameter, beside, last, h, before)
            for h, before in zip((CHANGE, -CHANGE), last.works, strict=True)
        ]
        return replace(found, works=tuple(works))

    def columns(self, row: Mapping[str, Any], watched: Row, energies: Row | None) -> dict[str, Any]:
        return self._rows.columns(row, watched, energies)


def _history(
    active: ActiveInterface, start: InterfaceSnapshot, rate: InterfaceSnapshot
) -> PointHistory:
    """Rates of the history in a step: where a facet is left out at its start zeta = R^T.g."""
    if not lets_go(active):
        return rate.history
    let_go = (active.history.gap != start.history.gap).any(axis=1, keepdims=True)
    opening, R = rate.values.opening, start.values.rotation
    if R is not None:
        turned = np.einsum("pji,pj->pi", rate.values.rotation, start.values.opening)
        opening = turned + np.einsum("pji,pj->pi", R, opening)
    return replace(rate.history, gap=np.where(let_go, opening, rate.history.gap))
