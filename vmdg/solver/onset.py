"""Onset of damage: the connected pieces of interfaces, and which of them are sound.

The onset in a sound piece is a kink of the path, at which a step ends: otherwise pieces that are
next to fail would soften together, below their strength. What begins to fail may unload all that
failed before, so its damage work limits the next step.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..assembly.discretization import Discretization
from ..assembly.space import facet_pieces
from ..base.parallel import global_any, global_sum
from ..interface.active import damage_work
from ..laws import Mode

#: A mask of the points of every interface with a bond that stay in a step.
Points = Sequence[NDArray[np.bool_]]

Names = NDArray[np.int64]


class Sound(NamedTuple):
    """The pieces at the start of a step."""

    elastic: bool = False
    points: Points = ()  # Points of sound pieces; empty if there are none
    # Points of pieces that have only begun to fail, whose damage work limits the step; empty if
    # there are none
    counted: Points = ()


class Pieces:
    """The connected pieces of the interfaces with a bond; all methods are collective."""

    def __init__(self, discretization: Discretization):
        active = discretization.active.values()
        self.interfaces = [one for one in active if one.law.has_bond]
        self._comm = discretization.mesh.comm
        self._thickness = float(discretization.geometry.thickness)
        self._space = discretization.space
        self._names = self._pieces()

    def _pieces(self) -> list[NDArray[np.int64]]:
        """Name of the piece of every point that stays in a step."""
        if not self.interfaces:
            return []
        pieces = facet_pieces(self._space, [one.facets for one in self.interfaces])
        found = zip(self.interfaces, pieces, strict=True)
        return [piece[one.quadrature.facet[one.quadrature.kept]] for one, piece in found]

    def sound(self, small: float) -> Sound:
        """The pieces at the last converged state.

        Args:
            small: Fraction of the strength above which what is lost is not the onset.
        """
        fails, grown = [], []
        if any(one.facets.slides for one in self.interfaces):
            self._names = self._pieces()
        for one in self.interfaces:
            lost, mode = (
                one.history.softening[one.quadrature.kept],
                one.history.mode[one.quadrature.kept],
            )
            strength = np.broadcast_to(one.law.strength, len(one.quadrature.weights))[
                one.quadrature.kept
            ]
            fails.append((mode != Mode.ELASTIC) & (lost < strength))
            grown.append(fails[-1] & (lost > small * strength))
        if not global_any(self._comm, any(mask.any() for mask in fails)):
            return Sound(True, [~mask for mask in fails])
        broken = self._of(fails)
        begun = np.setdiff1d(broken, self._of(grown))
        sound = [~np.isin(name, broken) for name in self._names]
        some = global_any(self._comm, any(mask.any() for mask in sound))
        counted = [np.isin(name, begun) for name in self._names] if begun.size else ()
        return Sound(False, sound if some else (), counted)

    def begun(self, points: Points) -> Names:
        """Names of the pieces of some points in which damage begins in the step so far."""
        works = [one.values.update.damage_work[one.quadrature.kept] > 0 for one in self.interfaces]
        return self._of([mask & work for mask, work in zip(points, works, strict=True)])

    def work(self, points: Points) -> float:
        """Damage work of some points in the step so far [N mm]."""
        work = sum(map(damage_work, self.interfaces, points))
        return self._thickness * float(global_sum(self._comm, work))

    def _of(self, points: Points) -> Names:
        named = [name[mask] for name, mask in zip(self._names, points, strict=True)]
        here = np.unique(np.concatenate(named)) if named else np.zeros(0, dtype=np.int64)
        return np.unique(np.concatenate(self._comm.allgather(here)))
