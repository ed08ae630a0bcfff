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
from ..interface.points import PointValues
from ..interface.return_map import Trial, evaluate
from ..laws import Law, Update
from ..laws.base import VARYING, parameter_names
from .records import Record, difference, rate_of, shifted

Array = NDArray[np.float64]


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


def point_rates(
    active: ActiveInterface, given: Trial, changes: Sequence[Change], h: float, dt: float
) -> list[PointValues]:
    """Rates of the values at the points by every parameter.

    Args:
        active: The interface, at the end of a step.
        given: Input of its return map there.
        changes: By parameter.
        h: Relative change of the parameters.
        dt: Time step of the return map [s].
    """
    laws = [law for change in changes for law in change.laws]
    trials = [shifted(given, change.rate, end) for change in changes for end in (h, -h)]
    here = _without_tangents(active.values)
    if not active.law.inelastic:
        values = [evaluate(law, trial, dt) for law, trial in zip(laws, trials, strict=True)]
        return [difference(*pair, h) for pair in _pairs(values)]
    rows = _changing(active, changes)
    updates = _return_maps(active.law, laws, trials, rows, dt)
    modes = [(here.update.mode, a.mode, b.mode) for a, b in _pairs(updates)]
    if active.turns:
        values = [
            _without_tangents(evaluate(_Mapped(update), trial, dt))
            for update, trial in zip(updates, trials, strict=True)
        ]
        known = zip(_pairs(values), modes, strict=True)
        return [rate_of(here, *pair, mode, h) for pair, mode in known]
    # In a fixed frame everything but the update is linear in the input.
    updates = [replace(update, tangent=None, work_gradient=None) for update in updates]
    known = zip(changes, _pairs(updates), modes, strict=True)
    found = [(change.rate, rate_of(here.update, *pair, mode, h)) for change, pair, mode in known]
    return [
        PointValues(rate.opening, rate.jump, update.gap, update.traction, update=update)
        for rate, update in found
    ]


def _pairs(values: Sequence[Record]) -> list[tuple[Record, Record]]:
    """Values at p (1 + h) and p (1 - h), by parameter."""
    return list(zip(values[::2], values[1::2], strict=True))


def _without_tangents(values: PointValues) -> PointValues:
    """Values at points without their second derivatives, which nothing needs."""
    update = values.update
    if update is not None:
        update = replace(update, tangent=None, work_gradient=None)
    return replace(values, compliance=None, update=update)


def _changing(active: ActiveInterface, changes: Sequence[Change]) -> NDArray[np.intp]:
    """Points other than those that are intact and stay so."""
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


def _return_maps(
    law: Law, laws: Sequence[Law], trials: Sequence[Trial], rows: NDArray[np.intp], dt: float
) -> list[Update]:
    """Return maps with these laws, elastic except in some rows."""
    loads = [_load(trial) for trial in trials]
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
    """Laws that differ from one law by parameters that may vary from point to point, together."""
    fixed = [name for name in parameter_names(law) if name not in VARYING]
    groups: dict[tuple, list[int]] = {}
    for i, one in enumerate(laws):
        groups.setdefault(tuple(getattr(one, name) for name in fixed), []).append(i)
    return list(groups.values())


def _joined(law: Law, laws: Sequence[Law], count: int, rows: NDArray[np.intp]) -> Law:
    """Laws at some of ``count`` points each, as one law at all of them."""
    names = [name for name in parameter_names(law) if name in VARYING]
    varying = {
        name: [np.broadcast_to(getattr(one, name), count)[rows] for one in laws]
        for name in names
        if name in law.varying or any(getattr(one, name) is not getattr(law, name) for one in laws)
    }
    return laws[0].with_values({name: np.concatenate(given) for name, given in varying.items()})


def _write(update: Update, found: Update, rows: NDArray[np.intp], part: slice) -> None:
    """Copy a part of a return map into some rows of another one."""
    for field in fields(Update):
        mine, theirs = getattr(update, field.name), getattr(found, field.name)
        if mine is not None and theirs is not None:
            mine[rows] = theirs[part]
