"""Rates of the values at the points of an interface, for rates of the input of its return maps.

Differences of return maps at p (1 + h) and p (1 - h): one general mechanism for all laws, exact to
about 1e-9. The maps of all parameters are evaluated together, at the points where something
changes: a return map of few points takes as long as that of thousands.

Records of rates are stacks: their arrays have a first axis for the parameters (n, nq, ...).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from ..interface.active import ActiveInterface
from ..interface.return_map import Trial, evaluate, in_frame
from ..interface.values import PointValues
from ..laws import Law, Update
from ..laws.base import VARYING, parameter_names
from .records import (
    CHANGE,
    NEAR,
    aligned,
    combined,
    difference,
    flat,
    one_of,
    plus,
    rate_of,
    shifted,
    unflat,
)

Array = NDArray[np.float64]

#: Least size of T_tr for differences, relative to the largest one.
LEAST = 1e-6

#: Where the laws of vmdg are.
_LAWS = Law.__module__.rpartition(".")[0]


class PointRates:
    """Rates of the values at the points of an interface by several parameters; linear in those of
    the displacement.

    Args:
        laws: Laws at p (1 + h) and at p (1 - h), of every parameter.
        rates: Of the input of the return map, by the logarithms of the parameters, at fixed
            displacement; a stack.
    """

    def __init__(
        self,
        active: ActiveInterface,
        given: Trial,
        laws: tuple[Sequence[Law], Sequence[Law]],
        rates: Trial,
        dt: float,
    ):
        self._law, self._values, self._given = active.law, active.values, given
        self._turns, self._rates, self._count = active.turns, rates, len(laws[0])
        if not self._law.inelastic:
            return
        # Along the parameters, and along the components of T_tr.
        load, size = _load(given), np.linalg.norm(_load(given), axis=1)
        self._size = np.maximum(size, LEAST * size.max(initial=0.0))
        self._size[self._size == 0.0] = 1.0
        ways = self._size[:, None] * np.eye(load.shape[1])[:, None]
        every, known = [], []
        for chosen, h in zip(laws, (CHANGE, -CHANGE), strict=True):
            every += [*chosen, *[self._law] * len(ways)]
            trial = shifted(given, rates, h)
            straight = (np.stack([one] * len(ways)) for one in _known(given)[1:])
            ends = zip(_known(trial), (load + h * ways, *straight), strict=True)
            known.append([np.concatenate(parts) for parts in ends])
        arguments = [np.concatenate(ends) for ends in zip(*known, strict=True)]
        rows = _changing(active, rates)
        update = _return_maps(self._law, every, arguments, given, rows, dt)
        half, here = len(every) // 2, _without_tangents(active.values.update)
        higher, lower = (one_of(update, part) for part in (slice(half), slice(half, None)))
        modes = here.mode, update.mode[:half], update.mode[half:]
        found = rate_of(here, higher, lower, modes, CHANGE)
        self._fixed = one_of(found, slice(self._count))
        # The gap's slopes are known, and T + r zeta changes as T_tr does.
        gap = np.moveaxis(active.values.update.tangent, 2, 0) * self._size[:, None]
        traction = ways - given.r[:, None] * gap
        slopes = one_of(found, slice(self._count, None))
        self._slopes = replace(slopes, gap=gap, traction=traction)

    def at_rest(self) -> PointValues:
        """Rates at fixed displacement; a stack."""
        return self._point_values(self._rates, self._fixed if self._law.inelastic else None)

    def along(self, moves: Trial) -> PointValues:
        """Of every parameter, along the rates of the input of return maps by its displacement; a
        stack."""
        update = plus(self._update(moves), self._fixed) if self._law.inelastic else None
        return self._point_values(plus(self._rates, moves), update)

    def softening(self, moves: Trial) -> Array:
        """Rates of Q along displacements of every parameter, and along one by which no parameter
        changes (n + 1, nq)."""
        found = self._update(moves).softening
        found[:-1] += self._fixed.softening
        return found

    def _update(self, moves: Trial) -> Update:
        """Rates of the return map along displacements, for the laws as they are."""
        ways = np.moveaxis(_load_rate(self._given, moves) / self._size[:, None], 2, 0)

        def along(slopes: Array) -> Array:
            return sum(aligned(way, one) * one for way, one in zip(ways, slopes, strict=True))

        return combined(along, self._slopes)

    def _point_values(self, rates: Trial, update: Update | None) -> PointValues:
        if update is not None and not self._turns:
            # In a fixed frame everything but the update is linear in the input.
            return PointValues(
                rates.opening, rates.jump, update.gap, update.traction, update=update
            )
        trial = flat(shifted(self._given, rates, NEAR))
        if update is None:
            end = evaluate(self._law, trial, 0.0)
        else:
            # Nothing needs second derivatives of the return map.
            near = flat(shifted(_without_tangents(self._values.update), update, NEAR))
            known = trial.opening, trial.jump, near.gap, near.traction
            end = in_frame(trial, lambda _: PointValues(*known, update=near))
        end = unflat(replace(end, update=None, compliance=None), self._count)
        return replace(difference(end, self._values, NEAR), update=update)


def _without_tangents(update: Update) -> Update:
    """A return map without its second derivatives, which nothing needs."""
    return replace(update, tangent=None, work_gradient=None)


def _changing(active: ActiveInterface, rates: Trial) -> NDArray[np.intp]:
    update, history = active.values.update, active.history
    moves = update.tangent.any(axis=(1, 2)) | update.gap.any(axis=1) | history.gap.any(axis=1)
    moves |= (update.softening > 0) | (update.mode != history.mode)
    moves |= rates.gap.any(axis=(0, 2)) | rates.softening.any(axis=0)
    return np.flatnonzero(moves)


def _known(trial: Trial) -> tuple[Array, Array, Array, Array]:
    """Input of a return map without the normal."""
    return _load(trial), trial.gap, trial.softening, trial.r


def _load(trial: Trial) -> Array:
    """T_tr in the frame of the law (..., nq, d) [MPa]."""
    total = trial.total if trial.R is None else _turned(trial.R, trial.total)
    return total - trial.r[..., None] * trial.gap


def _load_rate(trial: Trial, moves: Trial) -> Array:
    """Rates of T_tr in the frame of the law along displacements (n, nq, d) [MPa]."""
    if trial.R is None:
        return moves.total
    return _turned(moves.R, trial.total) + _turned(trial.R, moves.total)


def _turned(R: Array, total: Array) -> Array:
    return np.einsum("...ji,...j->...i", R, total)


def _return_maps(
    law: Law,
    laws: Sequence[Law],
    arguments: Sequence[Array],
    given: Trial,
    rows: NDArray[np.intp],
    dt: float,
) -> Update:
    """Return maps of T_tr, zeta_n, Q_n and r with these laws (n, nq, ...), elastic except in some
    rows; a stack."""
    load, *rest = arguments
    update = Update.elastic(*(one.reshape(-1, *one.shape[2:]) for one in (load, *rest[:2])))
    update = _without_tangents(update)
    for group in _alike(law, laws) if rows.size else ():
        known = [one[np.ix_(group, rows)].reshape(-1, *one.shape[2:]) for one in arguments]
        known.insert(1, np.tile(given.N[rows], (len(group), 1)))
        cycles = () if given.cycles is None else (np.tile(given.cycles[rows], len(group)),)
        joined = _joined(law, [laws[i] for i in group], load.shape[1], rows)
        found = _mapped(joined, known, dt, *cycles)
        where = (np.array(group)[:, None] * load.shape[1] + rows).ravel()
        for field in fields(Update):
            mine, theirs = getattr(update, field.name), getattr(found, field.name)
            if mine is not None and theirs is not None:
                mine[where] = theirs
    mode = update.mode.reshape(len(laws), -1)
    return replace(unflat(update, len(laws)), mode=mode)


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
