"""The constraint of a step: it ends where the first of its limits is met.

A step follows the equilibrium path until its parameter, the load factor or in a jump the
overstress, reaches the target, or the damage work reaches a limit, or the arc length of the
displacement does, whichever comes first. Load control, control by dissipation (Gutierrez 2004;
Verhoosel, Remmers and Gutierrez 2009) and arc length (Riks 1979) are one constraint,

    g(u, lambda) = max_i (q_i(u, lambda) - limit_i) = 0,

of which a correction uses the branch that is met first along du_0 + dlambda du_1. The damage work
is monotonic along a path, so limit points, snap-backs and separations are passed in ordinary steps;
without damage, as in buckling, the arc length is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Differences of load factors, relative to the stage, that count as rounding.
ROUNDING = 1e-11

#: Damage work at which a step ends at the onset, relative to that below which damage is starting.
ONSET = 1e-5


class Direction(NamedTuple):
    """Displacement of owned dofs [mm] and parameter, or their change."""

    u: NDArray[np.float64]
    t: float

    def plus(self, way: Direction, length: float) -> Direction:
        """A state along a direction from this one."""
        return Direction(self.u + length * way.u, self.t + length * way.t)


def packed(place: Direction) -> NDArray[np.float64]:
    """Displacement and parameter in one array (owned + 1,)."""
    return np.append(place.u, place.t)


def unpacked(x: NDArray[np.float64]) -> Direction:
    return Direction(x[:-1].copy(), float(x[-1]))


class Reach(NamedTuple):
    """Values of the limited quantities at a state of a step, or their rates along a direction."""

    t: float = 0.0
    work: float = 0.0  # Damage work [N mm]
    arc_length: float = 0.0  # Displacement along the path tangent at the start of the step [mm]


class Jump(NamedTuple):
    """Data of a step in a jump.

    Attributes:
        drag: Viscous resistance of bodies for an overstress of H, relative to the norm of K.
    """

    t: float
    drag: float = 0.0


@dataclass(frozen=True)
class Limits:
    """The limits of a step."""

    start: float
    target: float
    span: float  # Size of the stage, the largest change of the parameter in a correction
    onset: float = 0.0  # Damage work below which damage counts as starting; 0 to ignore this [N mm]
    work: float = math.inf  # Damage work [N mm]
    arc_length: float = math.inf  # Arc length [mm]
    kinks: bool = False  # Whether the step ends at an onset even where all pieces begin together
    jump: Jump | None = None

    def __str__(self) -> str:
        work, way = f"{self.work:.4g} N mm on bonds", f"{self.arc_length:.4g} mm"
        parts = [text for text, x in ((work, self.work), (way, self.arc_length)) if x < math.inf]
        return f"at most {' and '.join(parts)}" if parts else "by load"

    @property
    def length(self) -> float:
        return abs(self.target - self.start)

    @property
    def toward(self) -> float:
        """Sign of the direction to the target, 1 at constant parameter."""
        return math.copysign(1.0, self.target - self.start)

    @property
    def by_load_alone(self) -> bool:
        return self.work == self.arc_length == math.inf

    @property
    def at_onset(self) -> bool:
        return self.work < self.onset

    def ending_at_onset(self) -> Limits:
        """The same step, which ends at the onset of damage unless that is ignored."""
        return replace(self, work=ONSET * self.onset) if 0 < self.onset < self.work else self

    def change(self, now: Reach, zero: Reach, one: Reach) -> tuple[float, bool]:
        """dlambda of a correction, and whether it ends at the target.

        Forward is the direction of increasing damage work, otherwise of the arc length if it is
        limited, otherwise towards the target.
        """
        way = one.arc_length if self.arc_length < math.inf else 0.0
        forward = math.copysign(1.0, one.work or way or self.toward)
        left, found = self.target - now.t, []
        for limit, done, more, rate in (
            (self.work, now.work, zero.work, one.work),
            (self.arc_length, now.arc_length, zero.arc_length, one.arc_length),
        ):
            if rate * forward > 0 and limit < math.inf:
                # A quantity with a small rate does not determine the length.
                change = (limit - done - more) / rate
                found.append(min(max(change, -self.span), self.span))
        nearest = min(found, key=lambda change: change * forward, default=left)
        if not found or (forward == self.toward and left * forward <= nearest * forward):
            return left, True
        return nearest, False
