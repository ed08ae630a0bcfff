"""Work of the tractions on the gaps of one interface in a step.

The ends of a step do not show where within it points begin to yield, separate or close. The trial
traction is interpolated linearly between them, and return maps at intermediate states show it.

For rate-dependent laws the return map at the fraction s of a step is that of backward Euler over
the time s dt, from the start of the step: |T_tr(s)| - r dgamma = R(dgamma) + c dgamma/s, c = eta
R_n/P_c. That path is continuous from one end to the other: as s falls to 0 so does dgamma, and V to
|T_n| - R_n, the overstress at the end of the step before. (With a fixed dt it would start with a
jump, as if the overstress relaxed instantly.) The viscous work of a step is the integral of V.dzeta
along this path, with the same points and rule as for T.dzeta, so that the balance depends on bond
and friction alone, as without viscosity. At a constant rate it is V dgamma, as a law returns it;
where the rate changes the difference is of first order.

At constant load T is interpolated linearly over zeta, and all of T.dzeta that is not work on bond
or friction is viscous.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..laws import Update
from ..laws.base import dot
from ..laws.extrinsic import RadialLaw
from .active import ActiveInterface
from .history import works
from .return_map import Trial, map_back

Array = NDArray[np.float64]

#: Number of parts of a step integrated by the mean traction, and of subdivisions of a part in which
#: a point begins to yield, separates or closes.
PARTS = 16

#: Fraction of a step that is not subdivided further.
SHORTEST = 1e-3

#: Change of the trial traction times that of zeta, relative to strength^2/H, up to which a part is
#: not subdivided.
LARGE = 1e-5

#: A traction below this, relative to that at the other end of a part, is rounding.
ROUNDING = 1e-10

#: Fraction of the step at which the overstress is taken as that at its start.
FIRST = 1e-7


def gap_force(active: ActiveInterface, traction: Array) -> Array:
    """-T dA, the force conjugate to zeta in the energy of bodies and (30), flat [N; N/mm in the
    plane], of T in the frame of its law (nq, d) [MPa]."""
    return -(active.quadrature.weights[:, None] * traction).ravel()


def gap_forces(active: ActiveInterface) -> tuple[Array, Array, Array]:
    """-T dA at the start and end of the step, see :func:`gap_force`, and d zeta [mm], flat."""
    history, update = active.history, active.values.update
    if update is None:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    start, end = (gap_force(active, T) for T in (history.traction, update.traction))
    return start, end, (update.gap - history.gap).ravel()


class States(NamedTuple):
    """States of points (m,), or of points at successive instants of a step (s, m)."""

    traction: Array  #: T (m, d) [MPa]
    gap: Array  #: zeta (m, d) [mm]
    softening: Array  #: Q (m,) [MPa]
    mode: NDArray[np.int8]  #: (m,)
    overstress: Array  #: V (m, d) [MPa]

    @classmethod
    def of(cls, update: Update) -> States:
        V = update.overstress
        known = update.traction, update.gap, update.softening, update.mode
        return cls(*known, np.zeros_like(update.traction) if V is None else V)

    def at(self, *rows: NDArray | slice) -> States:
        return States(*(array[rows] for array in self))


def gap_work(active: ActiveInterface, dt: float, straight: bool) -> tuple[float, Array]:
    """int T.d zeta over the step, and the excess of the works of its parts over those of the whole.

    The latter (3,) for damage, friction and viscosity, in addition to
    :meth:`.ActiveInterface.works`. For this rank's points [N mm; N in plane strain]. A law that
    unloads to the origin uses the mean over the directions at both ends where the gap rotates while
    the bond softens, an error of third order.

    Args:
        straight: Use the mean of the tractions at both ends.
    """
    update, history, q, law = active.values.update, active.history, active.quadrature, active.law
    charged = np.zeros(3)
    if update is None:
        return 0.0, charged
    moved = np.flatnonzero((update.gap != history.gap).any(axis=1))
    if not moved.size:
        return 0.0, charged
    weights, rated = q.weights[moved], law.viscosity > 0 and update.overstress is not None
    if straight:
        mean = (history.traction + update.traction) / 2
        total = dot(mean, update.gap - history.gap)
        if rated:
            charged[2] = q.weights @ _at_rest(active, total)
        return float(q.weights @ total), charged
    N, r, law = q.normal[moved], active.stabilization.norm[q.facet[moved]], law.at(moved)
    known = history.traction, history.gap, history.softening, history.mode
    first = States(*known, np.zeros_like(history.traction)).at(moved)
    last = States.of(update).at(moved)
    small = np.broadcast_to(LARGE * law.strength * law.strength, len(moved))
    H = np.broadcast_to(law.softening_modulus, len(moved))
    whole = last.traction + r[:, None] * (last.gap - first.gap) - first.traction

    def mapped(rows: NDArray, load: Array, start: States, time: float | Array) -> Update:
        known = load, load, load, N[rows], r[rows], start.gap, start.softening
        return map_back(law.at(rows), load, Trial(*known), time, keep=False)

    def at(rows: NDArray, share: Array) -> States:
        """States of some points at fractions of the step."""
        load = first.traction[rows] + share[:, None] * whole[rows]
        return States.of(mapped(rows, load, first.at(rows), share * dt if rated else dt))

    def way(rows: NDArray, ends: tuple[States, States], low: Array, part: float) -> States:
        shares = low + part * np.arange(1, PARTS)[:, None] / PARTS
        new = at(np.tile(rows, PARTS - 1), shares.ravel())
        parts = zip(ends[0], new, ends[1], strict=True)
        return States(
            *(np.concatenate([a[None], b.reshape(-1, *a.shape), c[None]]) for a, b, c in parts)
        )

    def work(states: States, rows: NDArray, low: Array, part: float) -> Array:
        """int T.d zeta and int V.d zeta of points between these states (2, m).

        A part in which the mode changes is subdivided.
        """
        a, b = states.at(slice(None, -1)), states.at(slice(1, None))
        works = np.array(
            [
                np.einsum("spi,spi->sp", (one + other) / 2, b.gap - a.gap)
                for one, other in ((a.traction, b.traction), (a.overstress, b.overstress))
            ]
        )
        # T_N zeta_N = 0 all the way where faces without a bond meet or part.
        one, other, opening = (
            np.einsum("spi,pi->sp", x, N[rows]) for x in (a.traction, b.traction, b.gap - a.gap)
        )
        lowest, highest = np.minimum(one, other), np.maximum(one, other)
        meets = (lowest < 0) & (np.abs(highest) <= ROUNDING * -lowest)
        works[0] -= meets * lowest / 2 * opening
        part /= PARTS
        s, p = np.nonzero(a.mode != b.mode)
        gaps = np.linalg.norm(b.gap[s, p] - a.gap[s, p], axis=1)
        missed = H[rows[p]] * part * np.linalg.norm(whole[rows[p]], axis=1) * gaps
        s, p = (index[missed > small[rows[p]]] for index in (s, p))
        if s.size and part > SHORTEST:
            rows, low, ends = rows[p], low[p] + part * s, (a.at(s, p), b.at(s, p))
            works[:, s, p] = work(way(rows, ends, low, part), rows, low, part)
        return works.sum(axis=1)

    rows, low = np.arange(len(moved)), np.zeros(len(moved))
    if rated:
        # the traction of a bond broken in the previous step is overstress, which ends at once
        begun = at(rows, np.full(len(moved), FIRST))
        first = first._replace(overstress=begun.overstress + first.traction - begun.traction)
    states = way(rows, (first, last), low, 1.0)
    total, viscous = work(states, rows, low, 1.0)
    if rated:
        charged[2] = weights @ (viscous - update.viscous_work[moved])

    whole_works = works(history, update, active.law, q.normal, active.stabilization.norm[q.facet])
    whole_works = whole_works[:, moved]

    def excess(chosen: NDArray[np.intp]) -> Array:
        """Damage, friction and viscous work of the parts of some points beyond that of their whole
        step (3,)."""
        some = states.at(slice(None), chosen)
        start, end = (
            States(*(array.reshape(-1, *array.shape[2:]) for array in some.at(part)))
            for part in (slice(None, -1), slice(1, None))
        )
        rows = np.tile(chosen, PARTS)
        # without its overstress the end follows from the start, given enough time
        load = end.traction - end.overstress + r[rows, None] * (end.gap - start.gap)
        found = mapped(rows, load, start, np.inf if rated else dt)
        # The states know the mode since the start of the step, where a gap that has closed closes.
        modes = np.append(some.mode[0], found.mode[: -len(chosen)])
        each = works(start._replace(mode=modes), found, law.at(rows), N[rows], r[rows])
        return (each.reshape(3, PARTS, -1).sum(axis=1) - whole_works[:, chosen]) @ weights[chosen]

    # With one curve for all directions damage work follows from Q.
    turns = law.unloads_to_origin and not isinstance(law, RadialLaw)
    parting = np.flatnonzero(update.damage_work[moved] > 0)
    if turns and parting.size:
        charged[0] = excess(parting)[0]
    # The pressure under which a point slides changes, and may begin or end, within the step. All
    # points that slide are asked: whether one ends open or under no pressure is up to rounding.
    turning = (states.mode[1:] != states.mode[:-1]).any(axis=0)
    rubbing = np.flatnonzero(turning | (whole_works[1] > 0))
    if np.any(np.greater(law.friction, 0.0)) and rubbing.size:
        charged[1] = excess(rubbing)[1]
    return float(weights @ total), charged


def _at_rest(active: ActiveInterface, total: Array) -> Array:
    """Viscous part of T.dzeta in excess of that of the law (nq,) [N/mm], of int T.dzeta (nq,)."""
    update, history, q, law = active.values.update, active.history, active.quadrature, active.law
    damage, friction, viscous = works(
        history, update, law, q.normal, active.stabilization.norm[q.facet]
    )
    stored = law.stored_energy(update.gap, q.normal, update.softening)
    stored -= law.stored_energy(history.gap, q.normal, history.softening)
    return np.maximum(total - stored - damage - friction, 0.0) - viscous
