"""The limit point of a path whose load is a parabola of the damage work."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from vmdg.solver.attempt import Attempt
from vmdg.solver.limit_point import limit_point


class Parabola:
    """Steps along t = -(D - top)^2 / 2."""

    def __init__(self, top: float):
        self.top = top
        self.problem = SimpleNamespace(step=self)
        self.options = SimpleNamespace(path=SimpleNamespace(small=1e-6, halvings=8))

    def state(self, work: float) -> SimpleNamespace:
        t = -((work - self.top) ** 2) / 2
        return SimpleNamespace(D=work, t=t, change_to=lambda other: None)

    def return_to(self, state: SimpleNamespace) -> None:
        self.now = state

    def snapshot(self) -> SimpleNamespace:
        return self.now

    def attempt(self, limits, last) -> Attempt:
        self.now = self.state(self.now.D + limits.work)
        return self.step(limits.work)

    def step(self, work: float) -> Attempt:
        return Attempt(slope=1 / (self.top - self.now.D), work=work)

    def reached(self, work: float) -> tuple[SimpleNamespace, Attempt]:
        """A state, and a step of unit work to it."""
        self.now = self.state(work)
        return self.now, self.step(1.0)


@pytest.mark.parametrize("top", (-0.3, 0.3))
def test_largest_load(top):
    """It is the top, and a row only where it is beyond the last row: damage does not decrease."""
    steps = Parabola(top)
    limit, step = steps.reached(0.0)
    last = steps.state(-1.0), step
    found, ended = limit_point(steps, last, limit, steps.reached(1.0), 1.0)
    assert found.D == pytest.approx(top, abs=1e-3)
    assert (ended is not None) == (top > 0)
