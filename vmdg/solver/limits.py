"""Where a step ends: where the first of its limits is met.

A step goes along the equilibrium path until its parameter, the load factor or in a jump the
overstress, is the target, or bonds have taken a given work, or the displacement has gone a given
way, whichever comes first. Load control, control by dissipation (Gutierrez 2004; Verhoosel, Remmers
and Gutierrez 2009) and arc length (Riks 1979) are one constraint,

    g(u, lambda) = max_i (q_i(u, lambda) - limit_i) = 0,

of which a correction takes the piece that is met first along du_0 + dlambda du_1. The work on bonds
only grows along a path, so that it passes limit points, snap-backs and separations as ordinary
steps; where nothing breaks, as in buckling, the way of the displacement does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Differences of load factors, relative to the stage, that are rounding.
ROUNDING = 1e-11


class Direction(NamedTuple):
    """Displacement of owned dofs [mm] and parameter, or a change of both."""

    u: NDArray[np.float64]
    t: float


class Reach(NamedTuple):
    """How far a state of a step is, or how far a direction leads.

    Attributes:
        t: Parameter.
        work: Work on bonds [N mm].
        way: Displacement along the tangent of the path at the start of the step [mm].
    """

    t: float = 0.0
    work: float = 0.0
    way: float = 0.0


class Jump(NamedTuple):
    """What a step of a jump is told.

    Attributes:
        t: Load factor.
        drag: That slows bodies down for an overstress of H, relative to the norm of K.
    """

    t: float
    drag: float = 0.0


@dataclass(frozen=True)
class Limits:
    """Where a step ends.

    Attributes:
        start: Parameter at which it begins.
        target: Parameter that it does not pass.
        span: Size of the stage; no correction changes the parameter by more.
        onset: Work on bonds up to which damage only begins; 0 where that is no matter [N mm].
        work: Work on bonds [N mm].
        way: Displacement along the path [mm].
        jump: What it is a step of, if its parameter is the overstress.
    """

    start: float
    target: float
    span: float
    onset: float = 0.0
    work: float = math.inf
    way: float = math.inf
    jump: Jump | None = None

    def __str__(self) -> str:
        """What may end it before the target, in words."""
        work, way = f"{self.work:.4g} N mm on bonds", f"{self.way:.4g} mm"
        parts = [text for text, x in ((work, self.work), (way, self.way)) if x < math.inf]
        return f"at most {' and '.join(parts)}" if parts else "by load"

    @property
    def length(self) -> float:
        """Of the way to the target."""
        return abs(self.target - self.start)

    @property
    def toward(self) -> float:
        """Sign of the way to the target, 1 where it is held."""
        return math.copysign(1.0, self.target - self.start)

    @property
    def by_load_alone(self) -> bool:
        """Whether the parameter is the only limit."""
        return self.work == self.way == math.inf

    def change(self, now: Reach, zero: Reach, one: Reach) -> tuple[float, bool]:
        """dlambda of a correction, and whether the target is what it ends at.

        Forward is where the work on bonds grows, else where the way does if it is limited, else
        towards the target.

        Args:
            now: Where the iteration is.
            zero: Where du_0 leads.
            one: Where du_1 leads, by a unit of the parameter.
        """
        way = one.way if self.way < math.inf else 0.0
        forward = math.copysign(1.0, one.work or way or self.toward)
        left, found = self.target - now.t, []
        for limit, done, more, rate in (
            (self.work, now.work, zero.work, one.work),
            (self.way, now.way, zero.way, one.way),
        ):
            if rate * forward > 0 and limit < math.inf:
                # Where a piece hardly grows its rate says nothing about how far it is.
                change = (limit - done - more) / rate
                found.append(min(max(change, -self.span), self.span))
        nearest = min(found, key=lambda change: change * forward, default=left)
        if not found or (forward == self.toward and left * forward <= nearest * forward):
            return left, True
        return nearest, False

    def shortened(self, gone: Reach, share: float) -> Limits:
        """Limits of an attempt that is shorter by a share than one that would have gone so far.

        Work that is no more than that of the onset is not shortened further.
        """
        work = max(share * min(self.work, gone.work or math.inf), self.onset)
        way = share * min(self.way, gone.way or math.inf)
        return replace(self, work=work, way=way)
