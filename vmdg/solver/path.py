"""The equilibrium path to given load factors: how far steps go, where they are cut, snaps."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from ..base.parallel import global_norm, global_sum, warn_together
from ..problem.states import Snapshot
from ..problem.supports import bonds, hanging_piece, hold_pieces
from .attempt import Attempt, Guess
from .jump import jump
from .limit_point import PathPoint, highest
from .limits import ROUNDING, Direction, Limits
from .options import PathOptions
from .reasons import explained
from .result import Result, StepFailure
from .steps import Steps


class Part(NamedTuple):
    """A converged step on the way to a given load factor.

    Attributes:
        t: Load factor.
        done: Share of the way that is done.
        size: Change of the load factor in the step.
        attempt: How it went.
        cuts: How many attempts had failed.
        jumps: Steps with overstress of a jump.
    """

    t: float
    done: float
    size: float
    attempt: Attempt
    cuts: int
    jumps: int


@dataclass(frozen=True)
class Stage:
    """The way to a given load factor.

    Attributes:
        start: Load factor.
        target: Load factor.
        follows: Whether loads lie on a line in between, along which the path is followed; else
            steps go by load factors.
        traces: Whether there is no jump: snaps are followed back, or stop the run.
        most: Work on bonds that a step may do [N mm].
        leapt: Load factors at which it has jumped without getting on.
    """

    start: float
    target: float
    follows: bool
    traces: bool
    most: float
    leapt: tuple[float, ...] = ()

    @property
    def span(self) -> float:
        """Size of the stage."""
        return abs(self.target - self.start)

    def ahead(self, t: float, other: float) -> float:
        """How much further ``t`` is than another load factor."""
        return (t - other) * math.copysign(1.0, self.target - self.start)

    def behind_jump(self, t: float, numbers: PathOptions) -> Stage:
        """The stage after a jump at a load factor; there is none any more if they do not get on."""
        stays = self.leapt and self.ahead(t, self.leapt[-1]) <= numbers.small * self.span
        leapt = (*self.leapt, t) if stays else (t,)
        return replace(self, leapt=leapt, traces=self.traces or len(leapt) > numbers.patience)

    def done(self, t: float) -> float:
        """Share of the way."""
        if t == self.target:
            return 1.0
        return min(max((t - self.start) / (self.target - self.start), 0.0), 1.0)


@dataclass(frozen=True)
class Size:
    """How far the next step may go, and how the last one went.

    Attributes:
        work: On bonds, once ``breaks`` [N mm].
        breaks: Whether a step by load alone has failed: work on bonds is limited.
        way: Of the displacement [mm].
        stride: Of the load factor, where no line is followed.
        guess: How the last step went.
        idle: Steps that came no nearer to the target since one on which something broke.
    """

    work: float = math.inf
    breaks: bool = False
    way: float = math.inf
    stride: float = math.inf
    guess: Guess = field(default_factory=Guess)
    idle: int = 0


class Path:
    """Follows the equilibrium path of a problem.

    Args:
        steps: Takes the attempts.
        result: Takes the failures.
    """

    def __init__(self, steps: Steps, result: Result):
        self._steps, self._result = steps, result
        self._problem, self._options = steps.problem, steps.options
        self._numbers = steps.options.path
        scales = self._problem.step.scales
        leads = self._options.control == "dissipation"
        self._size = Size(scales.work or math.inf, scales.breaking or leads)
        self.forget()

    def forget(self) -> None:
        """The next step is as that of a run which begins here: what was breaking breaks further."""
        guess = Guess(goes_on=True)
        self._size, self._lost = Size(self._size.work, self._size.breaks, guess=guess), False

    def advance(self, target: float) -> Iterator[Part]:
        """Steps until ``target`` is reached.

        Behind a limit point steps are kept back until it is clear whether it is a real snap: they
        become rows if the load grows beyond it again, as where points break one by one.

        Raises:
            StepFailure: a step fails although it was cut as often as the options allow.
        """
        problem, step = self._problem, self._problem.step
        stage, limit, kept = self._set_out(target), None, []
        last: tuple[Snapshot, Attempt] | None = None
        while True:
            before = step.snapshot()
            try:
                part = self._next(stage)
            except StepFailure:
                if stage.traces:
                    raise
                after = yield from self._snap(stage, limit or before, kept, last)
                if after is None:
                    raise
                stage, limit, kept, last = after, None, [], None
                if problem.t == target:
                    return
                continue
            turned = limit is not None or stage.ahead(part.t, before.t) < 0
            if not (stage.follows and turned) or stage.traces:
                last = (before, part.attempt)
                yield part
            else:
                limit = limit or before
                kept.append((part, step.snapshot()))
                if stage.ahead(part.t, limit.t) > 0 or part.t == target:
                    yield from self._rows(kept)
                    limit, kept, last = None, [], None
                elif stage.ahead(limit.t, part.t) > stage.span:
                    stage = yield from self._snap(stage, limit, kept, last)
                    limit, kept, last = None, [], None
            if problem.t == target and not kept:
                return
            if not stage.follows and before.discretization is not problem.discretization:
                # Facets have opened: there are bonds to follow now.
                stage = self._set_out(target)

    def _rows(self, kept: list[tuple[Part, Snapshot]]) -> Iterator[Part]:
        """Steps that were kept back."""
        for part, state in kept:
            self._problem.step.return_to(state)
            yield part

    def _set_out(self, target: float) -> Stage:
        """The stage to a load factor."""
        problem, loading, options = self._problem, self._problem.loading, self._options
        start, step, steps = problem.t, problem.step, self._steps
        energy, _ = bonds(problem)
        most = options.max_share * energy
        by_load = options.control == "load" or steps.viscous or steps.cyclic
        # Bonds may break or bodies buckle; where facets have yet to open nothing is known of bonds.
        small = problem.discretization.bodies.small
        bends = most > 0 or not (small or step.activation)
        follows = not by_load and bends and loading.set_ray(start, target)
        if not follows:
            loading.clear_ray()
        # Loads may turn while the load factor goes on. What was breaking unloads then, and no work
        # on bonds leads the way back: it begins by load.
        way, sense = target - start, math.copysign(1.0, target - start)
        turned = step.scales.sense * sense < 0
        if follows and step.scales.sense != 0 and not turned:
            turned = not loading.as_given(start - self._numbers.small * way)
        step.scales = replace(step.scales, sense=sense)
        if turned:
            self._size = Size(self._size.work)
        self._size = replace(self._size, work=min(self._size.work, most or math.inf))
        traces = options.unstable == "trace" or options.control == "load" or most == 0
        return Stage(start, target, follows, traces, most)

    # One step

    def _next(self, stage: Stage) -> Part:
        """A converged step, after as many attempts as it takes."""
        problem, options, numbers, size = self._problem, self._options, self._numbers, self._size
        start, cuts, by_work = problem.t, 0, False
        guess = replace(size.guess, most=stage.most)
        if start == stage.target:
            # A load that is held is at rest.
            guess = replace(guess, ahead=None)
        limits = self._limits(stage)
        while True:
            before = problem.step.snapshot()
            found = self._steps.attempt(limits, guess)
            if found.converged and (refusal := self._refusal(stage, limits, before, found)):
                problem.step.return_to(before)
                found = found.failed(refusal)
            if found.converged:
                break
            self._result.failures.append((limits.target, found.reason))
            cuts += 1
            if cuts > options.max_cuts and found.reason == "UNSTABLE":
                # Nothing shows the body another way.
                self._lose(start)
                cuts, limits = 0, replace(limits, way=math.inf)
            if 2 * cuts > options.max_cuts or problem.discretization is not before.discretization:
                guess = replace(guess, ahead=None)
            if hold_pieces(problem):
                cuts = 0
                continue
            # A load that is held cannot be cut.
            length, late = abs(limits.target - start), cuts - options.max_cuts
            by_work |= limits.work < math.inf
            if late > by_work * options.max_cuts // 2 or length <= ROUNDING * stage.span:
                raise StepFailure(self._complaint(limits, found), self._result)
            if late > 0:
                # Where lips close and rub bonds may break, but their work does not lead the way.
                by_load = Limits(start, stage.target, stage.span)
                limits = self._strode(by_load, stage.span * numbers.cut**late)
            else:
                limits = self._shorter(stage, limits, found)
        self._lost &= found.unstable or problem.t != stage.target
        self._size = self._next_size(stage, limits, found, cuts)
        if self._size.idle > numbers.idle:
            problem.step.return_to(before)
            raise StepFailure(self._complaint(limits, found.failed("NO_END")), self._result)
        return Part(problem.t, stage.done(problem.t), problem.t - start, found, cuts, 0)

    def _limits(self, stage: Stage) -> Limits:
        """Where a first attempt ends."""
        size, start = self._size, self._problem.t
        limits = Limits(start, stage.target, stage.span)
        if stage.follows:
            work = size.work if size.breaks else math.inf
            return replace(limits, work=work, way=size.way)
        stride = size.stride
        if self._steps.cyclic and stride == math.inf:
            stride = self._steps.first_stride
        return self._strode(limits, stride)

    def _strode(self, limits: Limits, stride: float) -> Limits:
        """Limits with a target that is no further away."""
        if stride >= abs(limits.target - limits.start):
            return limits
        return replace(limits, target=limits.start + limits.toward * stride)

    def _shorter(self, stage: Stage, limits: Limits, found: Attempt) -> Limits:
        """Limits after an attempt that has failed."""
        stride = abs(limits.target - limits.start)
        if stage.follows:
            # Where bonds break the work on them limits the step, else the way.
            gone, numbers = found.guessed, self._numbers
            least = numbers.small * stage.most
            breaks = min(gone.work, limits.work) > least
            work = min(gone.work, stage.most) if breaks else 0.0
            gone = gone._replace(work=work, way=0.0 if breaks else gone.way)
            shorter = limits.shortened(gone, numbers.cut, least)
            return self._strode(limits, stride / 2) if shorter.by_load_alone else shorter
        if self._steps.cyclic:
            # Of a step that came to no end nothing is known but that it was far too long.
            kept = self._options.max_loss / found.lost if found.lost else 0.0
            return self._strode(limits, stride * max(kept / 2, self._numbers.cut))
        return self._strode(limits, stride / 2)

    def _next_size(self, stage: Stage, limits: Limits, found: Attempt, cuts: int) -> Size:
        """How far the next step may go."""
        numbers, options, size = self._numbers, self._options, self._size
        growth = min(numbers.aim / max(found.iterations, 1), numbers.growth)
        went = global_norm(self._problem.comm, found.ahead.u)
        way = growth * limits.way
        if not cuts and way > went / numbers.cut:
            way = math.inf
        least = numbers.small * stage.most
        work = max(growth * min(limits.work, size.work), least)
        work = min(work, stage.most or math.inf)
        # One step for the whole stage and far from the limit: load control is the shorter way.
        whole = cuts == 0 and limits.start == stage.start and self._problem.t == stage.target
        whole &= found.work * numbers.growth < limits.work
        breaks = (size.breaks or (cuts > 0 and stage.follows)) and not whole
        breaks |= options.control == "dissipation"
        stride = math.inf
        if self._steps.cyclic:
            aim = (1 - numbers.missed) * options.max_loss
            room = min(aim / max(found.lost, 1e-300), 1 / numbers.cut)
            stride = room * abs(limits.target - limits.start)
        elif cuts or size.stride < math.inf:
            stride = growth * abs(limits.target - limits.start)
        # Along the way nothing need break or come nearer to the target, without end.
        nearer = stage.ahead(self._problem.t, limits.start) > numbers.small * stage.span
        idle = 0 if found.work > least or not stage.follows else size.idle + (not nearer)
        guess = Guess(None if found.onset else found.ahead, found.work, goes_on=True)
        step = self._problem.step
        step.scales = replace(step.scales, work=0.0 if work == math.inf else work, breaking=breaks)
        return Size(work, breaks, way, stride, guess, idle)

    def _refusal(self, stage: Stage, limits: Limits, before: Snapshot, found: Attempt) -> str:
        """Why a step does not count although it has converged; nothing where it does."""
        t = self._problem.t
        if not stage.follows:
            return ""
        # By load alone, or beyond its limits, a step may come to a state that no path leads to. It
        # releases energy then; what it lacks is due to points that begin to yield on the way.
        far = found.work > stage.most or stage.ahead(before.t, t) > 0
        if found.work > 0 and not found.onset and (far or limits.by_load_alone):
            released = self._released(before) / found.work
            if max(released, -released if far else 0.0) > self._numbers.released:
                return "JUMPED"
        if stage.ahead(stage.start, t) > 0 and not self._problem.loading.as_given(t):
            return "PROGRAMME_LEFT"
        # Bonds that break are followed by the work on them, and behind a limit point of the load
        # stable states are not near. A body that lies loose has pivots that are rounding.
        loose = self._problem.step.rests_on_contact or self._problem.step.scales.held
        strays = found.unstable and found.work == 0 and stage.ahead(t, before.t) > 0
        return "UNSTABLE" if strays and not (loose or self._lost) else ""

    def _released(self, before: Snapshot) -> float:
        """Energy that a step has released, but for rounding [N mm]."""
        step, now = self._problem.step, self._problem.step.snapshot()
        released = self._problem.energy().imbalance - global_sum(self._problem.comm, step.within)
        step.return_to(before)
        released -= self._problem.energy().imbalance
        step.return_to(now)
        # The energy of bodies is not known better, however weak their bonds are.
        return math.copysign(max(abs(released) - self._steps.rounding, 0.0), released)

    def _lose(self, t: float) -> None:
        """Warn that the run goes on over unstable states."""
        self._lost = True
        warn_together(
            self._problem.comm,
            f"equilibria beyond load factor {t:.6g} are unstable: the tangent has negative "
            "eigenvalues. Where the body would buckle give it a small imperfection, a load or an "
            "eigenstrain, and smaller steps there; where a piece has come free, a support",
        )

    def _complaint(self, limits: Limits, found: Attempt) -> str:
        start, end, failures = limits.start, limits.target, self._result.failures
        norms = ", ".join(f"{norm:.3g}" for norm in found.norms[-4:]) or "none"
        cuts = 0 if start == end else self._options.max_cuts
        attempts = [reason for _, reason in failures[-cuts - 1 :]] or [found.reason]
        although = f" although it was cut {cuts} times" if start != end else ""
        return (
            f"the step from load factor {start:.8g} to {end:.8g} failed{although}; the problem is "
            f"in its state at {start:.8g}. In the last attempt "
            f"{explained(attempts)}. (Its last residuals: {norms} N.) "
            f"{hanging_piece(self._problem)}".rstrip()
        )

    # Snaps

    def _snap(
        self,
        stage: Stage,
        limit: Snapshot,
        kept: list[tuple[Part, Snapshot]],
        last: tuple[Snapshot, Attempt] | None,
    ) -> Generator[Part, None, Stage | None]:
        """The row of a jump, or those kept back where none leads on; arguments of :meth:`_leap`.

        Returns:
            The stage from there on; None where there is neither.
        """
        part = self._leap(stage, limit, kept, last)
        if part is not None:
            yield part
            return stage.behind_jump(part.t, self._numbers)
        yield from self._rows(kept)
        return replace(stage, traces=True) if kept else None

    def _leap(
        self,
        stage: Stage,
        limit: Snapshot,
        kept: list[tuple[Part, Snapshot]],
        last: tuple[Snapshot, Attempt] | None,
    ) -> Part | None:
        """From the limit point to the next equilibrium at its load; None, and undone, if none is.

        Args:
            stage: The stage.
            limit: State of the largest load.
            kept: Steps behind it; where there is none the stable path ended within the smallest
                attempt: the jump goes there, or to the target.
            last: The state before it and how the step between them went.
        """
        if not kept:
            there = self._result.failures[-1][0]
            return self._jump(stage, there, limit, limit) or self._jump(
                stage, stage.target, limit, limit
            )
        top = self._top(stage, last, limit, *kept[0])
        # At the limit point itself nothing would drive the problem on.
        away = self._numbers.released * stage.span
        states = [state for _, state in kept]
        far = (state for state in states if stage.ahead(top.t, state.t) > away)
        found = self._jump(stage, top.t, top, next(far, states[-1]))
        if found is None:
            self._problem.step.return_to(states[-1])
        return found

    def _top(
        self,
        stage: Stage,
        last: tuple[Snapshot, Attempt] | None,
        limit: Snapshot,
        part: Part,
        behind: Snapshot,
    ) -> Snapshot:
        """The state of largest load between the last step before a limit point and the one behind.

        Args:
            stage, last, limit: As in :meth:`_leap`.
            part: The first step behind it.
            behind: The state there.
        """
        step, sense = self._problem.step, math.copysign(1.0, stage.target - stage.start)

        def point(work: float, state: Snapshot, found: Attempt | None) -> PathPoint:
            slope = sense / found.slope if found and found.slope else math.nan
            return PathPoint(work, stage.ahead(state.t, limit.t), slope, state)

        def reach(left: PathPoint, right: PathPoint, work: float) -> PathPoint | None:
            # The state behind shows the way.
            way, start = left.state.way_to(right.state), left.state.t
            step.return_to(left.state)
            limits = Limits(start, start + sense * stage.span, stage.span, work - left.work)
            guess = Guess(way and Direction(*way), right.work - left.work, stage.most, True)
            found = self._steps.attempt(limits, guess)
            done = left.work + found.work
            return point(done, step.snapshot(), found) if found.converged else None

        left = point(0.0, limit, last and last[1])
        right = point(part.attempt.work, behind, part.attempt)
        if left.slope < 0 < last[1].work:
            left, right = point(-last[1].work, *last), left
        # Where bodies turn the path back, not bonds, the limit point is no matter of the work.
        if not right.work > left.work:
            return limit
        numbers = self._numbers
        return highest(left, right, reach, numbers.small * stage.span, numbers.halvings).state

    def _jump(self, stage: Stage, t: float, limit: Snapshot, start: Snapshot) -> Part | None:
        """To an equilibrium that no near one leads to; None, and undone, if there is none.

        Args:
            stage: The stage.
            t: Its load factor.
            limit: The last state of the stable path, from which what is released is counted.
            start: A state from which the problem runs away at this load.
        """
        problem = self._problem
        problem.step.return_to(limit)
        before = problem.energy()
        problem.step.return_to(start)
        found, count = jump(self._steps, t, stage.most)
        if not found.converged:
            self._result.failures.append((t, found.reason))
            problem.step.return_to(limit)
            return None
        problem.step.hold_loads(limit)
        # What is released, in place of what the overstress was charged; not less than nothing.
        after = problem.energy()
        charged = after.viscosity - before.viscosity
        problem.step.release(max(after.imbalance - before.imbalance, -charged))
        self._size = Size(self._size.work, self._size.breaks)
        return Part(t, stage.done(t), 0.0, found, 0, count)
