"""Rates of the values at the points of an interface, for rates of the input of its return maps.

Differences of return maps at p (1 + h) and p (1 - h): one general mechanism for all laws, exact to
about 1e-9. The maps of all parameters are evaluated together, at the points where something
changes: a return map of few points takes as long as that of thousands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..interface.active import ActiveInterface
from ..interface.return_map import Trial, evaluate
from ..interface.values import PointValues
from ..laws import Law, Update
from ..laws.base import VARYING, parameter_names
from .records import CHANGE, NEAR, combined, difference, plus, rate_of, shifted

Array = NDArray[np.float64]

#: Both ends of a difference.
_BOTH = (CHANGE, -CHANGE)

#: Least size of T_tr for differences, relative to the largest one.
LEAST = 1e-6


#: Where the laws of vmdg are.
_LAWS = Law.__module__.rpartition(".")[0]


class Change(NamedTuple):
    """A parameter at an interface.

    Attributes:
        laws: Laws at p (1 + h) and p (1 - h).
        rate: Rate of the input of the return map by the logarithm of p.
    """

    laws: tuple[Law, Law]
    rate: Trial


class _Mapped:
    """Stands for a law whose return map is known."""

    inelastic = True

    def __init__(self, update: Update):
        self._update = update

    def return_map(self, *_: object) -> Update:
        return self._update


class PointRates:
    """Rates of the values at the points of an interface by several parameters; linear in those of
    the displacement.

    Args:
        dt: Time step of the return map [s].
    """

    def __init__(self, active: ActiveInterface, given: Trial, changes: Sequence[Change], dt: float):
        self._law, self._values, self._given = active.law, active.values, given
        self._turns, self._rates = active.turns, [change.rate for change in changes]
        if not self._law.inelastic:
            return
        # Laws, loads and other input at both ends of every difference: along parameters, and along
        # the components of T_tr.
        laws = [law for change in changes for law in change.laws]
        trials = [shifted(given, rate, h) for rate in self._rates for h in _BOTH]
        loads = [_load(trial) for trial in trials]
        load, size = _load(given), np.linalg.norm(_load(given), axis=1)
        self._size = np.maximum(size, LEAST * size.max(initial=0.0))
        self._size[self._size == 0.0] = 1.0
        for way in np.eye(load.shape[1]):
            for h in _BOTH:
                laws.append(self._law)
                trials.append(given)
                loads.append(load + h * self._size[:, None] * way)
        rows = _changing(active, changes)
        here = _without_tangents(active.values.update)
        updates = [
            _without_tangents(one) for one in _return_maps(self._law, laws, loads, trials, rows, dt)
        ]
        rates = [
            rate_of(here, a, b, (here.mode, a.mode, b.mode), CHANGE)
            for a, b in zip(updates[::2], updates[1::2], strict=True)
        ]
        self._fixed = rates[: len(changes)]
        # The gap's slopes are known, and T + r zeta changes as T_tr does.
        self._slopes, C = [], active.values.update.tangent * self._size[:, None, None]
        for j, slope in enumerate(rates[len(changes) :]):
            traction = -given.r[:, None] * C[..., j]
            traction[:, j] += self._size
            self._slopes.append(replace(slope, gap=C[..., j], traction=traction))

    def at_rest(self) -> list[PointValues]:
        return [self._point_values(k, rate) for k, rate in enumerate(self._rates)]

    def along(self, moves: Sequence[Trial]) -> list[PointValues]:
        """Of every parameter, along a displacement of each.

        Args:
            moves: Rates of the input of return maps along the displacements.
        """
        return [
            self._point_values(k, plus(rate, move), move)
            for k, (rate, move) in enumerate(zip(self._rates, moves, strict=True))
        ]

    def softening(self, move: Trial, k: int | None = None) -> Array:
        """Of Q along a displacement (nq,), by the parameter of this number at the same time."""
        return self._update(move, k).softening

    def _update(self, move: Trial, k: int | None) -> Update:
        ways = _load_rate(self._given, move) / self._size[:, None]

        def sum_of(*parts: Array) -> Array:
            slopes, rest = parts[: ways.shape[1]], parts[ways.shape[1] :]
            along = (
                way.reshape(-1, *[1] * (slope.ndim - 1)) * slope
                for way, slope in zip(ways.T, slopes, strict=True)
            )
            return sum((*along, *rest))

        return combined(sum_of, *self._slopes, *([] if k is None else [self._fixed[k]]))

    def _point_values(self, k: int, rate: Trial, move: Trial | None = None) -> PointValues:
        """Of the parameter of this number, for the rate of the input, of which a part is along a
        displacement."""
        if not self._law.inelastic:
            end = evaluate(self._law, shifted(self._given, rate, NEAR), 0.0)
            return difference(end, self._values, NEAR)
        update = self._fixed[k] if move is None else self._update(move, k)
        if not self._turns:
            # In a fixed frame everything but the update is linear in the input.
            return PointValues(rate.opening, rate.jump, update.gap, update.traction, update=update)
        mapped = _Mapped(shifted(self._values.update, update, NEAR))
        end = evaluate(mapped, shifted(self._given, rate, NEAR), 0.0)
        # Nothing needs second derivatives of the return map.
        found = difference(replace(end, update=None, compliance=None), self._values, NEAR)
        return replace(found, update=update)


def _without_tangents(update: Update) -> Update:
    """A return map without its second derivatives, which nothing needs."""
    return replace(update, tangent=None, work_gradient=None)


def _changing(active: ActiveInterface, changes: Sequence[Change]) -> NDArray[np.intp]:
    update, history = active.values.update, active.history
    moves = update.tangent.any(axis=(1, 2)) | update.gap.any(axis=1) | history.gap.any(axis=1)
    moves |= (update.softening > 0) | (update.mode != history.mode)
    for change in changes:
        moves |= change.rate.gap.any(axis=1) | (change.rate.softening != 0)
    return np.flatnonzero(moves)


def _load(trial: Trial) -> Array:
    """T_tr in the frame of the law (nq, d) [MPa]."""
    total = trial.total if trial.R is None else np.einsum("pji,pj->pi", trial.R, trial.total)
    return total - trial.r[:, None] * trial.gap


def _load_rate(trial: Trial, move: Trial) -> Array:
    """Rate of T_tr in the frame of the law along a displacement (nq, d) [MPa]."""
    if trial.R is None:
        return move.total
    turned = np.einsum("pji,pj->pi", move.R, trial.total)
    return turned + np.einsum("pji,pj->pi", trial.R, move.total)


def _return_maps(
    law: Law,
    laws: Sequence[Law],
    loads: Sequence[Array],
    trials: Sequence[Trial],
    rows: NDArray[np.intp],
    dt: float,
) -> list[Update]:
    """Return maps with these laws and T_tr, elastic except in some rows."""
    updates = [
        Update.elastic(load, trial.gap, trial.softening)
        for load, trial in zip(loads, trials, strict=True)
    ]
    if not rows.size:
        return updates
    for group in _alike(law, laws):
        chosen = [trials[i] for i in group]
        arguments = [np.concatenate([loads[i][rows] for i in group])]
        for name in ("N", "gap", "softening", "r"):
            arguments.append(np.concatenate([getattr(trial, name)[rows] for trial in chosen]))
        cycles = () if chosen[0].cycles is None else (np.tile(chosen[0].cycles[rows], len(group)),)
        joined = _joined(law, [laws[i] for i in group], len(loads[0]), rows)
        found = _mapped(joined, arguments, dt, *cycles)
        for place, i in enumerate(group):
            _write(updates[i], found, rows, slice(place * len(rows), (place + 1) * len(rows)))
    return updates


@np.errstate(under="ignore")
def _mapped(law: Law, arguments: Sequence[Array], dt: float, *cycles: Array) -> Update:
    """A return map, without the checks of r > H, which the step has passed."""
    if type(law).return_map is Law.return_map:
        return law._advance(*arguments, law.damping(dt))
    return law.return_map(*arguments, dt, *cycles)


def _alike(law: Law, laws: Sequence[Law]) -> list[list[int]]:
    fixed = [name for name in parameter_names(law) if not (_joins(law) and name in VARYING)]
    groups: dict[tuple, list[int]] = {}
    for i, one in enumerate(laws):
        groups.setdefault(tuple(getattr(one, name) for name in fixed), []).append(i)
    return list(groups.values())


def _joins(law: Law) -> bool:
    return bool(law.varying) or type(law).__module__.startswith(_LAWS)


def _joined(law: Law, laws: Sequence[Law], count: int, rows: NDArray[np.intp]) -> Law:
    if not _joins(law):
        return laws[0]
    names = [name for name in parameter_names(law) if name in VARYING]
    varying = {
        name: [np.broadcast_to(getattr(one, name), count)[rows] for one in laws]
        for name in names
        if name in law.varying or any(getattr(one, name) is not getattr(law, name) for one in laws)
    }
    return laws[0].with_values({name: np.concatenate(given) for name, given in varying.items()})


def _write(update: Update, found: Update, rows: NDArray[np.intp], part: slice) -> None:
    for field in fields(Update):
        mine, theirs = getattr(update, field.name), getattr(found, field.name)
        if mine is not None and theirs is not None:
            mine[rows] = theirs[part]
