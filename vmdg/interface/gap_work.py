"""Work of the tractions on the gaps of one interface in a step.

Where in a step points begin to yield, part or close is not seen at its ends. The trial traction
goes straight from its start to its end, and return maps on the way tell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .active import ActiveInterface
from .return_map import Trial, map_back

Array = NDArray[np.float64]

#: Parts of a step for each of which the mean traction works on the gap.
PARTS = 16


def gap_forces(active: ActiveInterface) -> tuple[Array, Array, Array]:
    """-T dA at the start and end of the step [N; N/mm in plane strain] and d zeta [mm], flat.

    What the energy of bodies and (30) has for a force on zeta, in the frame of the law.
    """
    history, update = active.history, active.values.update
    if update is None:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    weights = active.quadrature.weights[:, None]
    start, end = (-(weights * T).ravel() for T in (history.traction, update.traction))
    return start, end, (update.gap - history.gap).ravel()


def gap_work(active: ActiveInterface, dt: float, straight: bool) -> float:
    """int T.d zeta over the step, of this rank's points [N mm; N in plane strain].

    The work of an overstress is that of the mean traction, as in :func:`.history.works`.

    Args:
        active: The interface, at the end of a step that is not yet committed.
        dt: Time step [s].
        straight: Take the mean of the tractions at both ends.
    """
    update, history, q = active.values.update, active.history, active.quadrature
    if update is None:
        return 0.0
    moved = np.flatnonzero((update.gap != history.gap).any(axis=1))
    parts = 1 if straight or active.law.viscosity > 0 else PARTS
    ends = [(history.traction[moved], history.gap[moved])]
    if parts > 1 and moved.size:
        rows = np.tile(moved, parts - 1)
        share = np.repeat(np.arange(1, parts) / parts, len(moved))[:, None]
        r, gap = active.stabilization.norm[q.facet[rows]], history.gap[rows]
        start = history.traction[rows]
        end = update.traction[rows] + r[:, None] * (update.gap[rows] - gap)
        load = start + share * (end - start)
        trial = Trial(load, load, load, q.normal[rows], r, gap, history.softening[rows])
        between = map_back(active.law.at(rows), load, trial, dt)
        ends.append((between.traction, between.gap))
    ends.append((update.traction[moved], update.gap[moved]))
    T, gap = (np.concatenate(a).reshape(parts + 1, -1, q.d) for a in zip(*ends, strict=True))
    work = np.einsum("spi,spi->p", (T[1:] + T[:-1]) / 2, np.diff(gap, axis=0))
    return float(work @ q.weights[moved])
