"""Rates of tau_s and delta, which are those of the start of a step."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_any
from ..interface.active import ActiveInterface, lets_go
from ..interface.stabilization import Stabilization
from ..problem.problem import Problem
from ..problem.states import Rate
from .parameters import Parameter
from .records import difference, shifted

Array = NDArray[np.float64]

#: Relative change of a parameter for tau_s in the initial state, between two neighbours.
FIRST = 1e-4

#: The same in a step, between its state and one neighbour.
LATER = 1e-6

#: Difference of r, relative, above which a step was repeated with a larger one.
RAISED = 1e-2

#: A parameter, its change h, the rate of the displacement, and lower bounds of r (nf,).
_Near = tuple[Parameter, float, Array, Sequence[Array]]


class StabilizationRates:
    """Rates of tau_s and delta of all interfaces of a problem; all methods are collective."""

    def __init__(self, problem: Problem):
        self._problem, self._discretization = problem, problem.discretization
        self._actives = list(self._discretization.active.values())

    def first(self, parameter: Parameter) -> list[Stabilization]:
        """Rates of tau_s and delta in the initial state."""
        zero = np.zeros_like(self._problem.u.x.array)
        floors = [np.zeros_like(active.floor) for active in self._actives]
        everywhere = [np.ones(len(low), dtype=bool) for low in floors]
        moved = [(parameter, h, zero, floors) for h in (FIRST, -FIRST)]
        ends = self._near(moved, everywhere)
        return [difference(a, b, 2 * FIRST) for a, b in zip(*ends, strict=True)]

    def of_step(
        self, parameters: Sequence[Parameter], rates: Sequence[Rate]
    ) -> list[list[Stabilization]]:
        """Rates of tau_s and delta of the step by every parameter, which are those of its start."""
        before = [[one.stabilization for one in rate.interfaces] for rate in rates]
        if self._discretization.stabilizers.constant:
            return [list(map(_in_forms, self._actives, one)) for one in before]
        start, applied = self._problem.step.start, [one.stabilization for one in self._actives]
        floors = [one.stabilization.norm for one in start.interfaces]
        # Elsewhere r is its lower bound.
        risen = [one.norm > low for one, low in zip(applied, floors, strict=True)]
        loading, t = self._problem.loading, self._problem.t
        u, values = self._problem.u.x.array.copy(), [active.values for active in self._actives]
        self._problem.u.x.array[:] = start.u
        loading.move(start.t)

        def moved() -> Iterator[_Near]:
            for parameter, rate, last in zip(parameters, rates, before, strict=True):
                # The pressure of a mean dilatation is that of the tractions there.
                for active, one, known in zip(
                    self._actives, start.interfaces, rate.interfaces, strict=True
                ):
                    active.values = shifted(one.values, known.values, LATER)
                bounds = [low + LATER * one.norm for low, one in zip(floors, last, strict=True)]
                yield parameter, LATER, rate.u, bounds

        ends = self._near(moved(), risen)
        for active, one in zip(self._actives, values, strict=True):
            active.values = one
        self._problem.u.x.array[:] = u
        loading.move(t)
        self._discretization.update_means(pressure=True)
        return [
            list(map(_in_forms, self._actives, map(_where_own, end, applied, last)))
            for end, last in zip(ends, before, strict=True)
        ]

    def _near(
        self, moved: Iterable[_Near], risen: Sequence[NDArray[np.bool_]]
    ) -> list[list[Stabilization]]:
        """tau_s and delta next to the current displacement, with those facets ``risen`` whose r may
        be above its lower bound (nf,)."""
        stabilizers, here, known = self._discretization.stabilizers, self._problem.u.x, []
        before, samples = here.array.copy(), []
        for one in moved:
            parameter, h, rate, _ = one
            here.array[:] = before + h * rate
            with parameter.changed(h):
                self._discretization.update_means(pressure=True)
                moves = global_any(self._problem.comm, parameter.of_body or bool(rate.any()))
                if moves:
                    derived, moduli = stabilizers.sample(risen)
                    samples.append((derived, list(moduli)))
                known.append((one, None if moves else stabilizers.needed()))
        here.array[:] = before
        factors = zip(samples, stabilizers.factors(samples, risen), strict=True)
        found = []
        for (parameter, h, _, floors), needed in known:
            if needed is None:
                (derived, _), own = next(factors)
                needed = derived, own
            with parameter.changed(h):
                found.append(stabilizers.scaled(*needed, floors))
        return found


def _where_own(near: Stabilization, here: Stabilization, last: Stabilization) -> Stabilization:
    """Rates from a neighbour, or those of the last step where the step was repeated with a larger
    r, which its start does not tell."""
    rate = difference(near, here, LATER)
    own = np.abs(near.norm - here.norm) <= RAISED * here.norm
    rows = {name: getattr(rate, name) for name in ("tau", "penalty", "norm", "safety")}
    for name, values in rows.items():
        mask = own.reshape(-1, *[1] * (values.ndim - 1))
        rows[name] = np.where(mask, values, getattr(last, name))
    return replace(rate, **rows)


def _in_forms(active: ActiveInterface, rate: Stabilization) -> Stabilization:
    """With the rates of the flux weights of facets that are not left out, and no others."""
    if not lets_go(active):
        return rate
    weights = active.stabilizer.flux_weights(rate.delta)
    out = active.stabilization.left_out[:, None, None, None]
    return replace(rate, weights=np.where(out, 0.0, weights))
