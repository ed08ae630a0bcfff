"""Peaks of the force between the ends of a step.

They are rows, so that the largest value of a column does not depend on the number of load steps.
Steps are as they would be without: a peak is looked at from the start of its step, and the run
continues from the end, unless bonds are damaged less there than at the peak: two steps from one
start may damage different ones. Then it continues from the peak.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_any, global_norm, global_sum
from ..problem.states import Snapshot
from .attempt import Attempt
from .iterate import force_of
from .limits import Limits
from .steps import Steps


class Place(NamedTuple):
    """A state on the path."""

    way: float  # Its distance along the path from an earlier state, in any measure that grows
    force: float  # See :func:`.force_of`


class Look(NamedTuple):
    """A state inside a step, and the step that ends there."""

    place: Place
    attempt: Attempt
    state: Snapshot


class Peaks:
    """Finds states of largest force inside the steps of a path; all methods are collective."""

    def __init__(self, steps: Steps):
        self._steps, self._problem, self._numbers = steps, steps.problem, steps.options.path
        self._largest, self._rate = 0.0, np.zeros(0)
        self.leave()

    def leave(self) -> None:
        """Continue elsewhere, as after a jump."""
        # The last two states without a kink between them and the next.
        self._last: list[Place] = []

    def face(self, rate: NDArray[np.float64]) -> None:
        """Note the rate of the supports; forces along others do not compare."""
        comm, last, same = self._problem.comm, self._rate, False
        if not global_any(comm, len(last) != len(rate)):
            size = global_norm(comm, rate) * global_norm(comm, last)
            same = float(global_sum(comm, rate @ last)) > (1 - self._numbers.peak) * size
        if not same:
            self._largest = 0.0
            self.leave()
        self._rate = rate

    def inside(
        self, before: Snapshot, limits: Limits, last: Attempt | None, found: Attempt, most: float
    ) -> tuple[Attempt, Snapshot] | None:
        """The state inside a converged step in which the force exceeds all so far and that at its
        end; None if there is none, or if the load falls.
        """
        small = self._numbers.small
        if limits.toward * (self._problem.t - before.t) <= 0:
            self.leave()
            return None
        look = None
        end = self._place(before, limits, found, most)
        self._largest = max(self._largest, end.force)
        if found.passed - self._largest > small * found.passed:
            look = self._look(before, replace(limits, kinks=True), last, most)
            if look and look.place.force - self._largest <= small * self._largest:
                look = None  # Of the iteration, not of the path.
        elif len(self._last) == 2:
            look = self._smooth(before, limits, last, found, end, most)
        if look is not None:
            self._largest = max(self._largest, look.place.force)
        kink = found.onset or found.passed > -np.inf
        self._last = [*([] if kink else self._last[-1:]), end]
        return look and (look.attempt, look.state)

    def _smooth(
        self,
        before: Snapshot,
        limits: Limits,
        last: Attempt | None,
        found: Attempt,
        end: Place,
        most: float,
    ) -> Look | None:
        """The largest force by successive parabolas through three states."""
        numbers, three, best = self._numbers, [*self._last, end], None
        if self._problem.discretization is before.discretization:
            last = found  # Else it is in another space.
        for _ in range(numbers.patience):
            top = vertex(three)
            share = (top.way - self._last[-1].way) / (end.way - self._last[-1].way)
            if not (0 < share < 1 and top.force - self._largest > numbers.peak * top.force):
                break
            look = self._look(before, shortened(limits, found, share), last, most)
            if look is None or look.place.force <= self._largest:
                break
            best, place = look, look.place
            self._largest = place.force
            three = [max(p for p in three if p < place), place, min(p for p in three if p > place)]
        return best

    def _look(
        self, before: Snapshot, limits: Limits, last: Attempt | None, most: float
    ) -> Look | None:
        """A step that ends inside the last one; None, and undone, if it does not converge."""
        step = self._problem.step
        after, scales, look = step.snapshot(), step.scales, None
        step.return_to(before)
        found = self._steps.attempt(limits, last)
        if found.converged:
            look = Look(self._place(before, limits, found, most), found, step.snapshot())
        step.return_to(after)
        step.scales = scales
        return look

    def _place(self, before: Snapshot, limits: Limits, found: Attempt, most: float) -> Place:
        way = abs(self._problem.t - before.t) / limits.span + (found.work / most if most else 0.0)
        return Place((self._last[-1].way if self._last else 0.0) + way, force_of(self._problem))


def heals(state: Snapshot, end: Snapshot) -> bool:
    """Whether points that stay in place are damaged less at the end than in a state; collective."""
    found = False
    if state.discretization is end.discretization:
        for one, other in zip(state.interfaces, end.interfaces, strict=True):
            stays = one.pairs is None
            found |= stays and bool((one.history.softening > other.history.softening).any())
    return global_any(end.discretization.mesh.comm, found)


def vertex(three: Sequence[Place]) -> Place:
    """Vertex of the parabola through three states where it is a maximum, else the last of them."""
    (x0, F0), (x1, F1), (x2, F2) = three
    first, second = (F1 - F0) / (x1 - x0), (F2 - F1) / (x2 - x1)
    bend = (second - first) / (x2 - x0)
    if bend >= 0:
        return three[-1]
    x = (x1 + x2) / 2 - second / (2 * bend)
    return Place(x, F1 + second * (x - x1) + bend * (x - x1) * (x - x2))


def shortened(limits: Limits, found: Attempt, share: float) -> Limits:
    """Limits of a share of a step."""
    if limits.work < np.inf and found.work > limits.onset:
        return replace(limits, work=max(share * found.work, limits.onset))
    return replace(limits, target=limits.start + share * found.ahead.t)
