"""History of the points of an interface from step to step, and the works of a step."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..laws import Law, Mode, Update
from .stabilization import Stabilization
from .values import PointValues

Array = NDArray[np.float64]

Record = TypeVar("Record", "PointHistory", PointValues)


@dataclass(frozen=True)
class PointHistory:
    """Converged history of an interface on this rank, zeta and Q of (37), in the law's frame.

    No array is modified in place, so an earlier history can be restored. A tie has no points here.
    """

    gap: Array  # zeta (nq, d) [mm]
    softening: Array  # Q (nq,) [MPa]
    mode: NDArray[np.int8]  # Branch of the last return map, :class:`vmdg.Mode` (nq,)
    traction: Array  # T (nq, d) [MPa]

    @classmethod
    def start(cls, softening: Array, d: int) -> PointHistory:
        """Initial history of points with an initial damage, Q (nq,) [MPa]."""
        gap, traction = np.zeros((2, len(softening), d))
        return cls(gap, softening, np.zeros(len(softening), dtype=np.int8), traction)

    def apart(self, distance: Array, normal: Array) -> PointHistory:
        """The same for points at a distance g (nq, d) [mm] along and across N (nq, d): they carry
        nothing, unless they overlap."""
        along = np.einsum("pi,pi->p", distance, normal)
        gap = distance + (np.maximum(along, 0.0) - along)[:, None] * normal
        return replace(self, gap=gap)

    def after(self, update: Update | None) -> PointHistory:
        """After a return map; None where there was none."""
        if update is None:
            return self
        return PointHistory(update.gap, update.softening, update.mode, update.traction)


#: Arrays of a PointHistory.
HISTORY_ARRAYS = tuple(field.name for field in fields(PointHistory))


@dataclass(frozen=True)
class InterfaceSnapshot:
    """The complete state of an interface."""

    history: PointHistory
    values: PointValues
    stabilization: Stabilization
    # Fraction of a fluid's pressure that acted in the last step; None for none
    share: NDArray[np.float64] | None = None
    # Work gradient of that step, for a resumed run; None where it can be computed
    gradient: NDArray[np.float64] | None = None
    pairs: Any = None  # Pairs of surfaces that slide; None for others
    up_to_date: bool = False  # Whether the values are those of the displacement and tau_s


def with_rows(record: Record, rows: NDArray, other: Record, theirs: NDArray) -> Record:
    """A record of arrays with some rows replaced by those of another record."""
    arrays = {}
    for field in fields(record):
        mine, source = getattr(record, field.name), getattr(other, field.name)
        if isinstance(mine, np.ndarray):
            arrays[field.name] = mine.copy()
            arrays[field.name][rows] = source[theirs]
    return replace(record, **arrays)


def works(before: PointHistory, update: Update, law: Law, N: Array, r: Array) -> Array:
    """Dissipation of a step at the points, (39), by damage, friction and viscosity (3, nq) [N/mm].

    Viscous work uses the overstress at the end; :func:`.gap_work` adds its change within the step.
    """
    works = np.array([update.damage_work, update.friction_work, update.viscous_work])
    if np.any(np.greater(law.friction, 0.0)):
        between = _friction_between(before, update, law, N, r)
        works[1] = np.maximum(works[1] + between, 0.0)
    return works


def _friction_between(before: PointHistory, update: Update, law: Law, N: Array, r: Array) -> Array:
    """Friction work missed by the law, which knows the end of the step only (nq,).

    The law uses the pressure at the end. Where a point slides, the mean of both ends is accurate to
    second order, which adds mu (|T_N,n| - |T_N,n+1|) dgamma / 2. Where a sliding point lifts off,
    the pressure falls to zero within the fraction s = |T_N,n| / (|T_N,n| + T_N,n+1 + r dzeta_N) of
    the step, with T_N,n+1 of what is left of a bond: mu |T_N,n| s |dzeta_T| / 2 [N/mm]. Where a gap
    closes, the pressure grows from zero within the last s = |T_N,n+1| / (|T_N,n+1| + r |dzeta_N|)
    of the step, which leaves mu |T_N,n+1| s dgamma / 2. All are multiplied by the fraction of the
    point subject to friction.
    """
    first, last = (
        np.maximum(-np.einsum("pi,pi->p", T, N), 0.0) for T in (before.traction, update.traction)
    )
    rubs = law.rubbing(update.softening)
    # An initially sticking point slides in a part of the step only.
    slid = (before.mode == Mode.FRICTION) | (before.softening >= law.strength)
    slips = (update.mode == Mode.FRICTION) & slid | (update.mode == Mode.SHEAR) & (rubs < 1.0)
    work = slips * (first - last) * update.multiplier / 2
    parted = np.isin(update.mode, (Mode.OPEN, Mode.TENSION, Mode.ELASTIC)) & (last == 0)
    rubbed = (before.mode == Mode.FRICTION) | (update.mode == Mode.TENSION) & (rubs < 1.0)
    lifts = rubbed & parted & (first > 0)
    change = (update.gap - before.gap)[lifts]
    opening = np.einsum("pi,pi->p", change, N[lifts])
    slip = np.linalg.norm(change - opening[:, None] * N[lifts], axis=1)
    pressure, pulled = first[lifts], np.einsum("pi,pi->p", update.traction, N)[lifts]
    share = pressure / (pressure + pulled + r[lifts] * np.maximum(opening, 0.0))
    work[lifts] = pressure * share * slip / 2
    free = (rubs < 1.0) | (before.softening >= law.strength)
    closes = (update.mode == Mode.CLOSING) & (first == 0) & (last > 0) & free
    pressure = last[closes]
    closed = np.einsum("pi,pi->p", (before.gap - update.gap)[closes], N[closes])
    share = pressure / (pressure + r[closes] * np.maximum(closed, 0.0))
    work[closes] = pressure * (share / 2 - 1) * update.multiplier[closes]
    return law.friction * rubs * work
