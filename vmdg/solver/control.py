"""How far a step goes: to a load factor, or until it has done so much work on bonds.

Load control is the wrong parameter once bonds break: every point that breaks is a small limit
point. The work on bonds D only grows along an equilibrium path, so it passes limit points,
snap-backs and separations as ordinary steps (Gutierrez 2004; Verhoosel, Remmers and Gutierrez
2009). A step is given

    lambda = target    or    D(u) - D_n = dD,

and where a load factor is to be met while bonds break, dD is the unknown of the secant method on
lambda(D), which is continuous. Before anything is damaged D has no gradient: then the return maps
along du_0 + alpha du_1 tell where D reaches dD (as PRED_ELAS of Lorentz and Badel 2004).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

#: Share of dD by which a step may miss it, and a first guess of the load factor.
MISSED, GUESSED = 1e-7, 1e-2

#: Share of dD by which a step of a jump may miss it.
ROUGH = 0.1

#: Increment for the directional derivative of D, relative to the size of the direction [mm].
INCREMENT = 1e-7

#: How often the last step an extrapolation may be.
MAX_REACH = 4.0

#: Differences of load factors, relative to the stage, that are rounding, and those within which the
#: onset of damage is found.
ROUNDING, ONSET = 1e-11, 1e-9

#: Share of the work on bonds that is left, by the tangent of a stable state, when load control
#: leads to the target.
NEAR = 0.03


class Direction(NamedTuple):
    """Displacement of owned dofs and load factor, or a change of both."""

    u: NDArray[np.float64]
    t: float


class Trials(Protocol):
    """States along a direction, see :class:`vmdg.solver.newton.Newton`; collective."""

    def place(self) -> Direction: ...
    def go(self, start: Direction, direction: Direction, length: float) -> None: ...
    def bond_work(self, start: Direction, way: Direction | None, length: float) -> float: ...
    def size(self, direction: Direction) -> float: ...
    def product(self, one: Direction, other: Direction) -> float: ...


@dataclass
class Control:
    """Load control: the step ends at the target.

    Attributes:
        target: Load factor.
        span: Load factors of the present stage, the scale of differences.
        work: Work on bonds that the step does; None for load control [N mm].
        moves: Whether an overstress slows down bodies as it does bonds.
        onset: Change of the load factor to the onset of damage, a kink at which the step ends; None
            where it ends elsewhere.
        arc: Size of the change of displacement that ends the step; None where it does not [mm].
        gradient: dD/dlambda at the last correction; 0 where D does not grow, or is not asked for
            [N mm].
        brakes: Whether an overstress takes the place of the load factor.
    """

    target: float
    span: float = 1.0
    work: float | None = None
    moves: bool = field(default=False, kw_only=True)
    onset: float | None = field(default=None, init=False)
    arc: float | None = field(default=None, init=False)
    gradient: float = field(default=0.0, init=False)
    brakes: ClassVar[bool] = False

    def __str__(self) -> str:
        """What leads the step, in words."""
        return "by load"

    @property
    def loaded(self) -> bool:
        """Whether the load factor itself is prescribed."""
        return self.work is None

    def snapped(self, t: float) -> float:
        """The target where a load factor differs from it by rounding."""
        return self.target if abs(t - self.target) <= ROUNDING * self.span else t

    def met(self, t: float, work: float) -> bool:
        """Whether an equilibrium ends the step.

        Args:
            t: Load factor.
            work: Work on bonds in the step [N mm].
        """
        return t == self.target

    def extrapolate(self, trials: Trials, ahead: Direction) -> bool:
        """Go on as in the last step, as far as the control asks for; collective.

        Returns:
            False, and nothing has changed, where this is too far or leads elsewhere.
        """
        start = trials.place()
        left = self.target - start.t
        if left * ahead.t <= 0 or left / ahead.t > MAX_REACH:
            return False
        trials.go(start, ahead, left / ahead.t)
        return True


@dataclass
class Work(Control):
    """Control by the work on bonds: the step ends where it is dD, whatever lambda is there.

    Where nothing breaks on the way to the target and load control has failed, the size of the
    change of the displacement takes the place of the work: at buckling, as at a limit point, K is
    next to singular, and a given load may lead anywhere; a given displacement leads on along the
    path (arc length; Crisfield 1981).

    Attributes:
        target: Load factor to which the load goes before anything is damaged.
        work: dD, until the target is foreseen to come without so much of it [N mm].
        within: Share of the work that the way to the target is foreseen to take of which dD is no
            more; 1 for load control where dD is enough for all of it.
        kink: Whether dD stays the control whatever is foreseen: at the onset of damage nothing can
            be foreseen, and on a path of breaking bonds load control does not serve.
        bends: Whether the displacement may take the place of the work.
        reach: Its size at which a step ends then; None for the share ``within`` of the last change,
            if that share is less than 1 [mm].
    """

    within: float = 1.0
    kink: bool = False
    bends: bool = False
    reach: float | None = None
    _forward: Direction | None = field(default=None, init=False, repr=False)
    _origin: Direction | None = field(default=None, init=False, repr=False)
    _limited: bool = field(default=False, init=False, repr=False)
    _first: bool = field(default=True, init=False, repr=False)

    def __post_init__(self):
        self._limited = self.kink

    def __str__(self) -> str:
        """What leads the step, in words."""
        return f"by work {self.work:.4g} N mm on bonds"

    def met(self, t: float, work: float) -> bool:
        """Whether an equilibrium ends the step."""
        if self.loaded or self.arc is not None:
            # Full steps stay on the arc.
            return self.arc is not None or t == self.target
        if self.onset is not None:
            return abs(self.onset) <= MISSED * self.span and work <= self.work
        # Where less is left to break than dD the way ends at the target.
        arrived = t == self.target and work < self.work
        return arrived or abs(work - self.work) <= MISSED * self.work

    def change(self, trials: Trials, start: Direction, zero: Direction, one: Direction) -> float:
        """Change of the load factor in a correction, by D linearised in du_0 and du_1; collective.

        Args:
            trials: Gives D.
            start: u and lambda.
            zero: du_0.
            one: du_1, for a unit of lambda.
        """
        first, self._first = self._first, False
        self._origin = self._origin or start
        if self.arc is not None:
            return self._along_arc(trials, start, zero, one)
        D, middle = self._worked(trials, start, None, 0.0), Direction(start.u + zero.u, start.t)
        if self.onset is not None:
            self.onset = self._begin_of_damage(trials, middle, one)
            return self.onset

        def slope(direction: Direction, sign: float = 1.0) -> float:
            size = trials.size(direction)
            if not 0 < size < np.inf:
                return size - size
            length = sign * INCREMENT / size
            more = self._worked(trials, start, direction, length) - D
            # Where no point breaks the difference of two sums is rounding.
            return 0.0 if abs(more) <= ROUNDING * self.work else more / length

        left = self.target - start.t
        # Where points are about to break D grows to one side only.
        self.gradient = gradient = slope(one) or slope(one, -1.0)
        length = left
        if gradient != 0:
            length = (self.work - D - slope(zero)) / gradient
            # Where D hardly grows its derivative says nothing about how far it is to dD.
            length = min(max(length, -self.span), self.span)
        else:
            now, then = (self._worked(trials, middle, one, x) for x in (0.0, left))
            if then > now == 0 and first and not self.kink:
                onset = self._begin_of_damage(trials, middle, one)
                if self.reach is not None and self._bound(trials, zero, one, onset):
                    return self._along_arc(trials, start, zero, one)
                self.onset = onset
                return onset
            if then == now > 0:
                # Nothing is left to break: the step ends where the last bond has.
                self.work, self.target = None, start.t
                return 0.0
        if not self._limited and abs(length) >= abs(left) and length * left > 0:
            foreseen = trials.bond_work(middle, one, left)
            if foreseen == 0:
                if self._bound(trials, zero, one, left):
                    return self._along_arc(trials, start, zero, one)
                self.work = None
                return left
            if foreseen < self.work and not self._limit(foreseen):
                return left
            return self._reach(trials, middle, one, left)
        return length if gradient != 0 else self._reach(trials, middle, one, left)

    def _bound(self, trials: Trials, zero: Direction, one: Direction, length: float) -> bool:
        """Whether the displacement becomes the control on a way on which nothing breaks."""
        way = trials.size(Direction(zero.u + length * one.u, length))
        if self.reach is None and self.within < 1:
            self.reach = self.within * (trials.size(self._forward) if self._forward else way)
        if self.bends and self.reach is not None and way > self.reach:
            self.arc = self.reach
        return self.arc is not None

    def _along_arc(
        self, trials: Trials, start: Direction, zero: Direction, one: Direction
    ) -> float:
        """Change of the load factor that ends a correction on |u - u_n| = reach; collective."""
        before = Direction(start.u - self._origin.u, start.t - self._origin.t)
        after = Direction(before.u + zero.u, before.t)
        a, b = trials.product(one, one), trials.product(after, one)
        root = math.sqrt(max(b * b - a * (trials.product(after, after) - self.arc**2), 0.0))
        forward = before if trials.size(before) > 0 else self._forward
        along = trials.product(forward, one) if forward else self.target - start.t
        length = (-b + math.copysign(root, along)) / a
        left = self.target - start.t
        if length * left > 0 and abs(length) >= abs(left):
            # The target comes first.
            self.work = self.arc = None
            return left
        return length

    def _worked(
        self, trials: Trials, start: Direction, way: Direction | None, length: float
    ) -> float:
        """D for its gradient: work on bonds there, 0 where it is rounding; collective [N mm].

        At an equilibrium that a run has reached before, points that were breaking are on their
        yield surface but for rounding, and their work of 1e-17 would give D a gradient.
        """
        work = trials.bond_work(start, way, length)
        return work if work > ROUNDING * self.work else 0.0

    def _limit(self, foreseen: float) -> bool:
        """Whether dD remains the control where the target is foreseen to come before it."""
        self._limited = True
        self.work = self.within * foreseen if self.within < 1 and foreseen > 0 else None
        return self.work is not None

    def _begin_of_damage(self, trials: Trials, start: Direction, one: Direction) -> float:
        """Length of a direction up to which nothing breaks; negative where something has."""
        toward = math.copysign(self.span, self.target - start.t)
        low, high = (-toward, 0.0) if trials.bond_work(start, one, 0.0) > 0 else (0.0, toward)
        while abs(high - low) > ONSET * self.span:
            middle = (low + high) / 2
            breaks = trials.bond_work(start, one, middle) > 0
            low, high = (low, middle) if breaks else (middle, high)
        return low

    def extrapolate(self, trials: Trials, ahead: Direction) -> bool:
        """Go on as in the last step until D is dD, or see from it where the path goes on."""
        if self.bends:
            self._forward = ahead
            return False
        self._first = False
        start, left = trials.place(), self.target - trials.place().t
        end = MAX_REACH
        if not self._limited and ahead.t * left > 0 and left / ahead.t < end:
            end = left / ahead.t
            if (foreseen := trials.bond_work(start, ahead, end)) < self.work:
                if not self._limit(foreseen):
                    trials.go(start, ahead, end)
                    return True
        trials.go(start, ahead, self._reach(trials, start, ahead, end))
        return True

    def _reach(self, trials: Trials, start: Direction, direction: Direction, end: float) -> float:
        """Length of a direction at which D is dD, at most ``end``."""
        sought = (trials, start, direction, self.work, {})
        if end == 0 or _excess(0.0, *sought) >= 0:
            return 0.0
        if _excess(end, *sought) <= 0:
            return end
        # As arguments: brentq's wrapper of a function refers to itself, and would keep the problem.
        return brentq(_excess, 0.0, end, sought, xtol=GUESSED * abs(end), rtol=GUESSED)


def _excess(
    length: float, trials: Trials, start: Direction, way: Direction, work: float, known: dict
) -> float:
    """D - dD at a length of a direction, asked for once; no number is too far; collective."""
    if length not in known:
        known[length] = np.nan_to_num(trials.bond_work(start, way, length) - work, nan=np.inf)
    return known[length]


@dataclass
class Arrival(Work):
    """A step that ends at the target, controlled by the work on bonds on the way.

    Attributes:
        start: lambda at the start of the step.
        beyond: D and lambda of an equilibrium beyond the target, if there is one.
    """

    start: float = 0.0
    beyond: tuple[float, float] | None = None
    kink: bool = True
    _before: tuple[float, float] = field(default=(0.0, 0.0), init=False, repr=False)

    def __post_init__(self):
        super().__post_init__()
        self._before = 0.0, self.start

    def met(self, t: float, work: float) -> bool:
        """Whether an equilibrium ends the step; if not, dD is another one."""
        if self.work is None:
            return t == self.target
        left, (D, t_D) = self.target - t, self._before
        if left * (self.target - self.start) > 0:
            self._before = work, t
        else:
            self.beyond = work, t
        if self.beyond is None:
            # Not there yet: as the last two equilibria lead, but no more than twice as far. A path
            # that has turned back ends the step here.
            slope = (t - t_D) / max(work - D, np.finfo(float).tiny)
            if slope * left <= 0:
                return True
            self.work = work + min(left / slope, work)
        else:
            (D, t_D), (D_next, t_next) = self._before, self.beyond
            share = (self.target - t_D) / (t_next - t_D)
            self.work = D + (D_next - D) * min(max(share, 0.05), 0.95)
        stable = self.gradient * (self.target - self.start) > 0
        if stable and abs(self.gradient * left) <= NEAR * work:
            self.work = None
        return left == 0


@dataclass
class Brake(Work):
    """A step of a jump: at a given load bonds are slowed down so that the work on them is dD.

    The unknown beside the displacement is the overstress, in multiples of H, in the place of the
    load factor; the target is none.
    """

    kink: bool = True
    brakes: ClassVar[bool] = True

    def __post_init__(self):
        super().__post_init__()
        self._first = False

    def met(self, t: float, work: float) -> bool:
        """Whether an equilibrium ends the step: dD need not be exact."""
        return self.work is None or abs(work - self.work) <= ROUGH * self.work
