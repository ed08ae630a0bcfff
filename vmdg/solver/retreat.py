"""What a path does beyond a limit point that no machine would do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_max, global_sum
from ..interface.active import ActiveInterface
from ..problem.states import Snapshot

Array = NDArray[np.float64]


def done_twice(
    before: Snapshot, limit: Snapshot, states: Sequence[Snapshot], small: float
) -> Array:
    """The largest fraction of what a snap does that is done a second time on the way to each of
    some states (n,), which hardly decreases; 0 up to rounding; collective.

    A machine holds the load at a limit point until the next equilibrium. On the path the load falls
    and comes back. Where bonds break one by one both have the same end: what fails fails further,
    all else unloads elastically. But what opened, slid or flowed before the limit may come back
    meanwhile, and go the same way again:

    * what a bond paid for its gap is lost, with the steps d_k zeta on the way and dzeta before the
      limit the fraction H b/P_c of its strength, b = sum of max(-d_k zeta.dzeta, 0)/|dzeta|; laws
      that unload to the origin lose nothing;
    * friction and bodies take work, that of friction sum |T_T| b, relative to the damage work
      beyond the limit. Where bodies flow, and points of surfaces that slide are others in every
      state, it is all that they take while the load falls.
    """
    now = limit.discretization
    comm, fraction, work = now.mesh.comm, np.zeros(len(states)), np.zeros((2, len(states)))
    same = all(state.discretization is now for state in (before, *states))
    moves = any(one.pairs is not None for one in limit.interfaces)
    for k, active in enumerate(now.active.values() if same else ()):
        if active.law.inelastic and limit.interfaces[k].pairs is None:
            lost, rubbed = _back(k, active, before, limit, states)
            fraction = np.maximum(fraction, lost)
            work[0] += float(now.geometry.thickness) * rubbed
    for n, (last, state) in enumerate(zip((limit, *states), states, strict=False)):
        work[1, n] = state.works.dissipated[0] - limit.works.dissipated[0]
        if abs(state.t - limit.t) > abs(last.t - limit.t):
            taken = state.works.plastic - last.works.plastic
            if moves:
                taken += state.works.dissipated[1] - last.works.dissipated[1]
            work[0, n:] += taken
    back, damage = global_sum(comm, work)
    share = np.divide(back, damage, out=np.zeros(len(states)), where=damage > 0)
    return np.maximum(global_max(comm, fraction), np.where(share > small, share, 0.0))


def _back(
    k: int, active: ActiveInterface, before: Snapshot, limit: Snapshot, states: Sequence[Snapshot]
) -> tuple[Array, Array]:
    """Of an interface the largest fraction of its strength that a bond loses twice, and the work of
    friction on the way back (n,), this rank's [N mm]."""
    law, history, weights = active.law, limit.interfaces[k].history, active.quadrature.weights
    N, moved = active.quadrature.normal, history.gap - before.interfaces[k].history.gap
    length = np.linalg.norm(moved, axis=1)
    way = moved / np.where(length > 0, length, 1.0)[:, None]
    pays = (length > 0) & (history.softening < law.strength) & (not law.unloads_to_origin)
    price = law.softening_modulus / law.strength * pays if law.has_bond else 0.0 * length
    gap, back = history.gap, np.zeros(len(moved))
    lost, rubbed, work = np.zeros(len(states)), np.zeros(len(states)), 0.0
    for n, state in enumerate(states):
        here = state.interfaces[k].history
        step, gap = np.maximum(-np.einsum("pi,pi->p", here.gap - gap, way), 0.0), here.gap
        back += step
        lost[n] = np.max(price * back, initial=0.0)
        pressed = np.einsum("pi,pi->p", here.traction, N) < 0
        along = np.abs(np.einsum("pi,pi->p", here.traction, way))
        work += weights[pressed] @ (along * step)[pressed]
        rubbed[n] = work
    return lost, rubbed
