"""The equilibrium path to given load factors: how far steps go, where they are cut, snaps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from ..base.parallel import global_any, global_norm, global_sum, warn_together
from ..problem.states import Snapshot
from ..problem.supports import bonds, hanging_piece, hold_pieces
from .control import ROUNDING, Arrival, Control, Direction, Work
from .jump import CUT, MAX_STEPS, growth_after, jump
from .limit_point import PathPoint, highest
from .reasons import explained
from .report import StepReport
from .result import Result, StepFailure
from .stepper import Stepper

#: Least work of a step relative to the largest one, and the facets of which the first one breaks
#: the bond.
LEAST, FIRST_FACETS = 1e-6, 5.0

#: Share of the work on bonds whose release tells a snap from a long step.
RELEASED = 0.05

#: Share by which the work of a step may exceed what was foreseen where the path is smooth.
SMOOTH = 0.2

#: Share of the loss allowed in a step with cycles that the next one aims at, how much longer it may
#: be, and the share of its length that is left at least when it is cut.
STRIDE, LONGER, LEAST_STRIDE = 0.8, 8.0, 0.05

#: How exactly a limit point is found, relative to the stage.
LIMIT = 1e-6

#: How far behind it a jump begins, relative to the stage.
AWAY = 1e-2


class Part(NamedTuple):
    """A converged step on the way to a given load factor.

    Attributes:
        t: Load factor.
        done: Share of the way that is done.
        size: Change of the load factor in the step.
        report: How it went.
        cuts: How many attempts had failed.
        jumps: Steps with overstress of a jump.
    """

    t: float
    done: float
    size: float
    report: StepReport
    cuts: int
    jumps: int


@dataclass
class Stage:
    """The way to a given load factor.

    Attributes:
        start: Load factor.
        target: Load factor.
        follows: Whether the load may be controlled by the work on bonds.
        back: Whether the load factor turns with it.
        rise: The state before the present one and how the step between them went; None where there
            is none, or facets have opened since.
        limit: State of the largest load so far, where the path has turned back after it.
        after: States behind it, which become rows if the load grows beyond the limit again.
        traces: Whether there is no jump: snaps are followed back, or stop the run.
        arcs: Steps led by the displacement, on whose way nothing is spent: it may go on for ever.
    """

    start: float
    target: float
    follows: bool
    back: bool = False
    rise: tuple[Snapshot, StepReport] | None = None
    limit: Snapshot | None = None
    after: list[tuple[Part, Snapshot]] = field(default_factory=list)
    traces: bool = False
    arcs: int = 0

    @property
    def span(self) -> float:
        """Size of the stage."""
        return abs(self.target - self.start)

    def ahead(self, t: float, other: float) -> float:
        """How much further ``t`` is than another load factor."""
        return (t - other) * math.copysign(1.0, self.target - self.start)

    def done(self, t: float) -> float:
        """Share of the way."""
        if t == self.target:
            return 1.0
        return min(max((t - self.start) / (self.target - self.start), 0.0), 1.0)


class Path:
    """Follows the equilibrium path of a problem.

    Args:
        stepper: Takes the steps.
        result: Takes the failures.
    """

    def __init__(self, stepper: Stepper, result: Result):
        self._stepper = stepper
        self._problem = stepper.problem
        self._result = result
        scales = self._problem.step.scales
        self._most, self._work, self._breaking = 0.0, scales.work, scales.breaking
        self._lost = False
        self.forget()

    def _remember(self, work: float, breaking: bool) -> None:
        """Work on bonds of the next step, and whether load control has failed in breaking bonds."""
        self._work = min(max(work, LEAST * self._most), self._most)
        self._breaking = breaking or self._stepper.options.control == "dissipation"
        step = self._problem.step
        step.scales = replace(step.scales, work=self._work, breaking=self._breaking)

    def forget(self) -> None:
        """The next step does not go on as the last one."""
        self._ahead: Direction | None = None
        self._spent, self._kink = 0.0, False
        self._reach: float | None = None
        self._stride: float | None = None

    def advance(self, target: float) -> Iterator[Part]:
        """Steps until ``target`` is reached.

        Raises:
            StepFailure: a step fails although it was cut as often as the options allow.
        """
        stage = self._set_out(target)
        while True:
            before = self._problem.step.snapshot()
            try:
                part = self._next(stage)
            except StepFailure:
                if stage.traces:
                    raise
                if stage.limit is not None:
                    # Rows that are kept back lead nowhere else.
                    yield from self._jump(stage)
                    continue
                # The stable path ends within the smallest attempt: jump there or at the given load.
                states, last = (before, before), self._result.failures[-1][0]
                part = self._leap(stage, last, *states) or self._leap(stage, target, *states)
                if part is None:
                    raise
            turned = stage.limit or stage.ahead(part.t, before.t) < 0
            if stage.follows and not stage.traces and turned:
                yield from self._behind_limit(stage, before, part)
            else:
                stage.rise = part.report.change and (before, part.report)
                yield part
            if self._problem.t == target:
                return
            if not stage.follows and before.discretization is not self._problem.discretization:
                # Facets have opened: there are bonds to follow now.
                stage = self._set_out(target)

    def _set_out(self, target: float) -> Stage:
        """The stage to a load factor."""
        loading, start, options = self._problem.loading, self._problem.t, self._stepper.options
        energy, facets = bonds(self._problem)
        self._most = options.max_share * energy
        self._remember(self._work or FIRST_FACETS * energy / max(facets, 1), self._breaking)
        by_load = options.control == "load" or self._stepper.viscous or self._stepper.cyclic
        # Bonds may break or bodies buckle; where facets have yet to open nothing is known of bonds.
        small = self._problem.discretization.bodies.small
        bends = self._most > 0 or not (small or self._problem.step.activation)
        last, follows = loading.ray, not by_load and bends and loading.set_ray(start, target)
        if not follows:
            loading.clear_ray()
        turns = follows and (last is None or not loading.ray.goes_on(last))
        # The way back is first tried by load: bonds unload, and no work on them leads there.
        step, sense = self._problem.step, math.copysign(1.0, target - start)
        back = step.scales.sense * sense < 0
        step.scales = replace(step.scales, sense=sense)
        if back:
            self._remember(self._work, False)
        if global_any(self._problem.comm, turns or back):
            self.forget()
        # Jumps are slowed down by bonds.
        never = options.unstable == "trace" or options.control == "load" or self._most == 0
        return Stage(start, target, follows, back, traces=never)

    # One step

    def _next(self, stage: Stage) -> Part:
        """A converged step, after as many attempts as it takes."""
        problem, options = self._problem, self._stepper.options
        share, cuts, passed, start = 1.0, 0, None, problem.t
        if self._stepper.cyclic:
            stride = self._stride or self._stepper.first_stride
            share = stride / max(abs(stage.target - start), stride)
        while True:
            end = stage.target if share == 1 else start + share * (stage.target - start)
            control, ahead = self._control(stage, end, cuts, passed)
            before = problem.step.snapshot()
            report = self._stepper.step(control, ahead)
            if report.converged and stage.follows:
                if stage.ahead(problem.t, stage.target) > 0 and passed is None:
                    # The target was passed on the way: look for the state in between.
                    passed = report, problem.t
                    problem.step.return_to(before)
                    continue
                if refusal := self._refusal(stage, before, report):
                    problem.step.return_to(before)
                    report = report.failed(refusal)
            if report.converged:
                self._lost &= report.unstable
                break
            self._result.failures.append((end, report.reason))
            if self._problem.discretization is not before.discretization:
                # Facets have opened in the attempt: directions belong to one discretization.
                self.forget()
            cuts += 1
            if cuts > options.max_cuts and report.reason == "UNSTABLE":
                # Nothing shows the body another way.
                self._lose(start)
                cuts, share = 0, 1.0
            if hold_pieces(self._problem):
                cuts, share = 0, 1.0
                continue
            # A load that is held cannot be cut.
            if cuts > options.max_cuts or math.isclose(start, stage.target, rel_tol=1e-12):
                raise StepFailure(self._complaint(start, end, report), self._result)
            if passed is not None:
                self._work, passed = passed[0].work / 2, None
            elif type(control) is Work:
                self._work *= CUT
                reach = report.arc or (self._ahead and global_norm(problem.comm, self._ahead.u))
                if self._spent == 0 and reach:
                    self._reach = CUT * reach
            if self._stepper.cyclic:
                # Of a step that came to no end nothing is known but that it was far too long.
                kept = options.max_loss / report.lost if report.lost else 0.0
                share *= max(kept / 2, LEAST_STRIDE)
            elif not stage.follows or cuts % 2 == 0:
                share /= 2
        if report.work <= ROUNDING * self._most:
            # Pressed surfaces of parted bodies: no next step is led by it.
            report = replace(report, work=0.0)
        # A step to the onset of damage says nothing about how much may break in one.
        broke = cuts > 0 and report.work > 0 and not report.onset
        work = min(self._work, report.work) if broke else self._work
        breaking = self._breaking
        if stage.follows and cuts > 0:
            # What has got on where the other has failed leads the next step.
            breaking = type(control) is not Control
        elif report.work == 0:
            # Nothing breaks any more, or the displacement leads.
            breaking = report.arc is not None
        elif type(control) is Arrival and start == stage.start and problem.t == stage.target:
            # No more than foreseen, by one step: load control is the shorter way.
            breaking = report.work - control.work > SMOOTH * report.work
        self._kink = report.onset
        self._ahead, self._spent = (None, 0.0) if self._kink else (report.ahead, report.work)
        growth = growth_after(report)
        may = growth * work if report.work >= work / 2 else max(work, growth * report.work)
        self._remember(may, breaking)
        self._reach = report.arc and growth * report.arc
        stage.arcs += report.arc is not None
        if self._stepper.cyclic:
            room = options.max_loss / max(report.lost, options.max_loss / LONGER)
            self._stride = STRIDE * room * abs(problem.t - start)
        return Part(problem.t, stage.done(problem.t), problem.t - start, report, cuts, 0)

    def _refusal(self, stage: Stage, before: Snapshot, report: StepReport) -> str:
        """Why a step does not count although it has converged; nothing where it does."""
        t = self._problem.t
        if stage.ahead(t, stage.target) > 0:
            return "TARGET_PASSED"
        far = report.work > self._most or stage.ahead(before.t, t) > 0
        if far and self._jumped(before, report):
            return "JUMPED"
        if stage.ahead(stage.start, t) > stage.span and not self._problem.loading.as_given(t):
            return "PROGRAMME_LEFT"
        # Bonds that break are followed by the work on them, and behind a limit point of the load
        # stable states are not near.
        strays = report.unstable and report.work == 0 and stage.ahead(t, before.t) > 0
        return "UNSTABLE" if strays and not self._lost else ""

    def _lose(self, t: float) -> None:
        """Warn that the run goes on over unstable states."""
        self._lost = True
        warn_together(
            self._problem.comm,
            f"equilibria beyond load factor {t:.6g} are unstable: the tangent has negative "
            "eigenvalues. Where the body would buckle give it a small imperfection, a load or an "
            "eigenstrain, and smaller steps there; where a piece has come free, a support",
        )

    def _jumped(self, before: Snapshot, report: StepReport) -> bool:
        """Whether a step that broke much or went back has passed a snap: it released energy."""
        step, now = self._problem.step, self._problem.step.snapshot()
        released = self._problem.energy().imbalance - global_sum(self._problem.comm, step.within)
        step.return_to(before)
        released -= self._problem.energy().imbalance
        step.return_to(now)
        # The energy of bodies is not known better, however weak their bonds are.
        return abs(released) > RELEASED * report.work + self._stepper.rounding

    def _control(
        self, stage: Stage, end: float, cuts: int, passed: tuple[StepReport, float] | None
    ) -> tuple[Control, Direction | None]:
        """How the next attempt is controlled, and where its first guess leads.

        Args:
            stage: The stage.
            end: Where the attempt ends by load control.
            cuts: Attempts that have failed.
            passed: How a step went that has passed the target, and its load factor.
        """
        t, ahead, way = self._problem.t, self._ahead, (stage.target, stage.span)
        if passed is not None:
            report, beyond = passed
            first = (stage.target - t) / (beyond - t) * report.work
            return Arrival(*way, first, start=t, beyond=(report.work, beyond)), report.change
        by_load = cuts > 0 or not self._breaking or (stage.back and t == stage.start)
        if not stage.follows or (cuts % 2 == 0 and by_load):
            return Control(end, stage.span), ahead
        # Where load control has failed it is not to come back by another name.
        within = CUT ** (cuts // 2 + 1) if cuts else 1.0
        if self._spent == 0 or ahead is None:
            bends = self._spent == 0 and not self._kink and stage.arcs < MAX_STEPS
            work = Work(*way, self._work, within, self._kink, bends, self._reach)
            return work, ahead if bends else None
        if cuts == 0 and ahead.t * (stage.target - t) > 0:
            needed = (stage.target - t) / ahead.t * self._spent
            if needed <= self._work:
                return Arrival(*way, needed, start=t), ahead
            if needed < 2 * self._work:
                # Two equal steps rather than a short one to the target.
                return Work(*way, needed / 2, within, kink=True), ahead
        return Work(*way, self._work, within, kink=cuts == 0), ahead

    def _complaint(self, start: float, end: float, report: StepReport) -> str:
        norms = ", ".join(f"{norm:.3g}" for norm in report.norms[-4:]) or "none"
        cuts = 0 if start == end else self._stepper.options.max_cuts
        attempts = [reason for _, reason in self._result.failures[-cuts - 1 :]]
        although = f" although it was cut {cuts} times" if start != end else ""
        return (
            f"the step from load factor {start:.8g} to {end:.8g} failed{although}; the problem is "
            f"in its state at {start:.8g}. In the last attempt "
            f"{explained(attempts)}. (Its last residuals: {norms} N.) "
            f"{hanging_piece(self._problem)}".rstrip()
        )

    # Snaps

    def _behind_limit(self, stage: Stage, before: Snapshot, part: Part) -> Iterator[Part]:
        """Steps behind a limit point: kept back until it is clear whether it is a real snap."""
        stage.limit = stage.limit or before
        stage.after.append((part, self._problem.step.snapshot()))
        if stage.ahead(part.t, stage.limit.t) > 0:
            # The load has grown again: points have broken one by one.
            stage.rise = part.report.change and (before, part.report)
            yield from self._rows(stage)
        elif stage.ahead(stage.limit.t, part.t) > stage.span:
            yield from self._jump(stage)

    def _rows(self, stage: Stage) -> Iterator[Part]:
        """Steps that were kept back."""
        kept, stage.limit, stage.after = stage.after, None, []
        for part, state in kept:
            self._problem.step.return_to(state)
            yield part

    def _jump(self, stage: Stage) -> Iterator[Part]:
        """From the limit point to the next equilibrium at its load; the path if none is found."""
        # At the limit point itself nothing would drive the problem on.
        states, away = [state for _, state in stage.after], AWAY * stage.span
        far = (state for state in states if stage.ahead(stage.limit.t, state.t) > away)
        start = next(far, states[-1])
        self._refine(stage)
        part = self._leap(stage, stage.limit.t, stage.limit, start)
        if part is not None:
            stage.limit, stage.after = None, []
            yield part
            return
        stage.traces = True
        yield from self._rows(stage)

    def _leap(self, stage: Stage, t: float, limit: Snapshot, start: Snapshot) -> Part | None:
        """To an equilibrium that no near one leads to; None, and undone, if there is none.

        Args:
            stage: The stage.
            t: Its load factor.
            limit: The last state of the stable path, from which what is released is counted.
            start: A state from which the problem runs away at this load.
        """
        problem = self._problem
        problem.step.return_to(limit)
        imbalance = problem.energy().imbalance
        problem.step.return_to(start)
        report, steps = jump(self._stepper, t, stage.span, self._work)
        if not report.converged:
            self._result.failures.append((t, report.reason))
            return None
        # Not less than nothing, by rounding where bonds are next to nothing.
        problem.step.release(max(problem.energy().imbalance - imbalance, 0.0))
        self.forget()
        return Part(t, stage.done(t), 0.0, report, 0, steps)

    def _refine(self, stage: Stage) -> None:
        """Find the limit point: the largest load factor over the work, between two states."""
        step, origin = self._problem.step, stage.limit.t
        sense = math.copysign(1.0, stage.target - stage.start)

        def point(work: float, state: Snapshot, report: StepReport | None) -> PathPoint:
            slope = sense / report.gradient if report and report.gradient else math.nan
            return PathPoint(work, stage.ahead(state.t, origin), slope, state)

        def reach(left: PathPoint, right: PathPoint, work: float) -> PathPoint | None:
            # The state behind shows the way.
            way = left.state.way_to(right.state)
            step.return_to(left.state)
            control = Work(stage.target, stage.span, work - left.work, kink=True)
            report = self._stepper.step(control, way and Direction(*way))
            return point(work, step.snapshot(), report) if report.converged else None

        before, last = stage.rise or (None, None)
        part, behind = stage.after[0]
        left, right = point(0.0, stage.limit, last), point(part.report.work, behind, part.report)
        if left.slope < 0 < last.work:
            left, right = point(-last.work, before, None), left
        # Where bodies turn the path back, not bonds, the limit point is no matter of the work.
        if right.work > left.work:
            stage.limit = highest(left, right, reach, LIMIT * stage.span).state
