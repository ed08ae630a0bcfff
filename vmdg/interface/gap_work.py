"""Work of the tractions on the gaps of one interface in a step.

Where in a step points begin to yield, part or close is not seen at its ends. The trial traction
goes straight from its start to its end, and return maps on the way tell.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..laws import Update
from ..laws.base import dot
from .active import ActiveInterface
from .return_map import Trial, map_back

Array = NDArray[np.float64]

#: Parts of a step for each of which the mean traction works on the gap, and parts of those in which
#: a point begins to yield, parts or closes.
PARTS = 16

#: Share of a step that is not divided further.
SHORTEST = 1e-3

#: Change of the trial traction along that of zeta, relative to strength^2/H, up to which a part is
#: not divided.
LARGE = 1e-5

#: Parts of the step for each of which a law charges damage.
CHARGED = 4


def gap_force(active: ActiveInterface, traction: Array) -> Array:
    """-T dA, what the energy of bodies and (30) has for a force on zeta, flat [N; N/mm in the
    plane].

    Args:
        active: The interface.
        traction: T in the frame of its law (nq, d) [MPa].
    """
    return -(active.quadrature.weights[:, None] * traction).ravel()


def gap_forces(active: ActiveInterface) -> tuple[Array, Array, Array]:
    """-T dA at the start and end of the step, see :func:`gap_force`, and d zeta [mm], flat."""
    history, update = active.history, active.values.update
    if update is None:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    start, end = (gap_force(active, T) for T in (history.traction, update.traction))
    return start, end, (update.gap - history.gap).ravel()


class States(NamedTuple):
    """Of points, or of points one after the other on their way through a step (s, m)."""

    traction: Array  #: T (m, d) [MPa]
    gap: Array  #: zeta (m, d) [mm]
    softening: Array  #: Q (m,) [MPa]
    mode: NDArray[np.int8]  #: (m,)

    def at(self, *rows: NDArray | slice) -> States:
        """Some of them."""
        return States(*(array[rows] for array in self))


def gap_work(active: ActiveInterface, dt: float, straight: bool) -> tuple[float, float]:
    """int T.d zeta over the step, and what its parts charge to damage more than the whole.

    Of this rank's points [N mm; N in plane strain]. The work of an overstress is that of the mean
    traction, as in :func:`.history.works`. A law that unloads to the origin charges the mean of the
    directions of both ends where the gap turns while the bond parts, an error of third order.

    Args:
        active: The interface, at the end of a step that is not yet committed.
        dt: Time step [s].
        straight: Take the mean of the tractions at both ends.
    """
    update, history, q, law = active.values.update, active.history, active.quadrature, active.law
    if update is None:
        return 0.0, 0.0
    moved = np.flatnonzero((update.gap != history.gap).any(axis=1))
    if not moved.size:
        return 0.0, 0.0
    weights = q.weights[moved]
    first, last = (
        States(x.traction, x.gap, x.softening, x.mode).at(moved) for x in (history, update)
    )
    if straight or law.viscosity > 0:
        return float(weights @ dot((first.traction + last.traction) / 2, last.gap - first.gap)), 0.0
    N, r, law = q.normal[moved], active.stabilization.norm[q.facet[moved]], law.at(moved)
    small = np.broadcast_to(LARGE * law.strength**2, len(moved))
    H = np.broadcast_to(law.softening_modulus, len(moved))
    whole = last.traction + r[:, None] * (last.gap - first.gap) - first.traction

    def mapped(rows: NDArray, share: Array, start: States) -> Update:
        """Return maps at shares of the step from states of some points on the way."""
        load = first.traction[rows] + share[:, None] * whole[rows]
        load -= r[rows, None] * (start.gap - first.gap[rows])
        known = load, load, load, N[rows], r[rows], start.gap, start.softening
        return map_back(law.at(rows), load, Trial(*known), dt)

    def way(rows: NDArray, ends: tuple[States, States], low: Array, part: float) -> States:
        """States of points at the ends of all parts of a part of the step."""
        shares = low + part * np.arange(1, PARTS)[:, None] / PARTS
        rows = np.tile(rows, PARTS - 1)
        new = mapped(rows, shares.ravel(), first.at(rows))
        new = States(new.traction, new.gap, new.softening, new.mode)
        parts = zip(ends[0], new, ends[1], strict=True)
        return States(
            *(np.concatenate([a[None], b.reshape(-1, *a.shape), c[None]]) for a, b, c in parts)
        )

    def work(states: States, rows: NDArray, low: Array, part: float) -> Array:
        """int T.d zeta of points between these states; a part in which a mode ends is divided."""
        a, b = states.at(slice(None, -1)), states.at(slice(1, None))
        works = np.einsum("spi,spi->sp", (a.traction + b.traction) / 2, b.gap - a.gap)
        part /= PARTS
        s, p = np.nonzero(a.mode != b.mode)
        gaps = np.linalg.norm(b.gap[s, p] - a.gap[s, p], axis=1)
        missed = H[rows[p]] * part * np.linalg.norm(whole[rows[p]], axis=1) * gaps
        s, p = (index[missed > small[rows[p]]] for index in (s, p))
        if s.size and part > SHORTEST:
            rows, low, ends = rows[p], low[p] + part * s, (a.at(s, p), b.at(s, p))
            works[s, p] = work(way(rows, ends, low, part), rows, low, part)
        return works.sum(axis=0)

    rows, low = np.arange(len(moved)), np.zeros(len(moved))
    states = way(rows, (first, last), low, 1.0)
    total = float(weights @ work(states, rows, low, 1.0))
    parting = np.flatnonzero(update.damage_work[moved] > 0)
    if not (law.unloads_to_origin and parting.size):
        return total, 0.0
    shares = np.repeat(np.arange(1, CHARGED + 1) / CHARGED, len(parting))
    start = states.at(slice(None, -1, PARTS // CHARGED), parting)
    start = States(*(array.reshape(-1, *array.shape[2:]) for array in start))
    spent = mapped(np.tile(parting, CHARGED), shares, start).damage_work.reshape(CHARGED, -1)
    return total, float(weights[parting] @ (spent.sum(axis=0) - update.damage_work[moved[parting]]))
