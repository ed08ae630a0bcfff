"""What a path does beyond a limit point that no machine would do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_max
from ..problem.states import Snapshot


def damage_twice(
    before: Snapshot, limit: Snapshot, states: Sequence[Snapshot]
) -> NDArray[np.float64]:
    """The largest fraction of its strength that a bond loses a second time on the way to each of
    some states (n,), which never decreases; collective.

    A machine holds the load at a limit point until the next equilibrium. On the path the load falls
    and comes back. Where bonds break one by one both have the same end: what fails fails further,
    all else unloads elastically. But what opened or slid before the limit, by dzeta, may come back
    meanwhile: the gap was paid for, and is lost. With the steps d_k zeta on the way it is H b/P_c,
    b = sum of max(-d_k zeta.dzeta, 0)/|dzeta|. Laws that unload to the origin lose nothing.
    Surfaces that slide have other points in every state; they are left out.

    Args:
        before: The state before the limit point.
        limit: The state of the largest load.
        states: Those beyond, in their order.
    """
    now, most = limit.discretization, np.zeros(len(states))
    same = all(state.discretization is now for state in (before, *states))
    for k, active in enumerate(now.active.values() if same else ()):
        law, slides = active.law, limit.interfaces[k].pairs is not None
        if not law.has_bond or law.unloads_to_origin or slides:
            continue
        history = limit.interfaces[k].history
        moved = history.gap - before.interfaces[k].history.gap
        length = np.linalg.norm(moved, axis=1)
        bonded = (length > 0) & (history.softening < law.strength)
        share = law.softening_modulus / law.strength * bonded / np.where(bonded, length, 1.0)
        gap, back = history.gap, np.zeros(len(moved))
        for number, state in enumerate(states):
            way, gap = state.interfaces[k].history.gap - gap, state.interfaces[k].history.gap
            back += np.maximum(-np.einsum("pi,pi->p", way, moved), 0.0)
            most[number] = max(most[number], np.max(share * back, initial=0.0))
    return global_max(now.mesh.comm, most)
