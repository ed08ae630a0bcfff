"""The equilibrium path to given load factors: step size, cuts, snaps."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_norm, global_sum, warn_together
from ..checks.supports import bonds, hanging_piece, stabilize_pieces
from ..problem.states import Snapshot
from .attempt import Attempt
from .jump import jump
from .limit_point import limit_point
from .limits import ROUNDING, Direction, Limits
from .options import PathOptions
from .peak import Peaks, heals
from .reasons import explained
from .result import Result, StepFailure
from .retreat import done_twice
from .steps import Steps


class Part(NamedTuple):
    """A converged step on the way to a given load factor."""

    t: float
    done: float
    size: float
    attempt: Attempt
    cuts: int
    jumps: int


@dataclass(frozen=True)
class Stage:
    """The way to a given load factor."""

    start: float
    target: float
    # Whether loads are linear in between, so that the path is followed; otherwise load control is
    # used
    follows: bool
    traces: bool  # Whether snaps are traced, or stop the run, rather than jumped over
    most: float  # Largest damage work in a step [N mm]
    # Whether loads have turned back, so that bonds unload at first: damage work, which grows along
    # the way back too, does not tell where the path goes
    unloads: bool = False
    leapt: tuple[float, ...] = ()

    @property
    def span(self) -> float:
        return abs(self.target - self.start)

    def ahead(self, t: float, other: float) -> float:
        """Distance of ``t`` from another load factor, in the direction of the stage."""
        return (t - other) * math.copysign(1.0, self.target - self.start)

    def behind_jump(self, t: float, numbers: PathOptions) -> Stage:
        """The stage after a jump at a load factor; without further jumps if they make no
        progress."""
        stays = self.leapt and self.ahead(t, self.leapt[-1]) <= numbers.small * self.span
        leapt = (*self.leapt, t) if stays else (t,)
        traces = self.traces or len(leapt) > numbers.patience
        return replace(self, leapt=leapt, traces=traces, unloads=False)

    def done(self, t: float) -> float:
        if t == self.target:
            return 1.0
        return min(max((t - self.start) / (self.target - self.start), 0.0), 1.0)


@dataclass(frozen=True)
class Size:
    """Size limits of the next step, other than the damage work."""

    arc_length: float = math.inf  # Arc length [mm]
    stride: float = math.inf
    last: Attempt | None = None
    idle: int = 0  # Number of steps without progress since the last one with damage


@dataclass
class Crest:
    """A limit point of the load that the path may still exceed."""

    # The last state before it and the step between them; None where there is none
    last: tuple[Snapshot, Attempt] | None = None
    limit: Snapshot | None = None  # The state of the largest load; None while the load grows
    kept: list[tuple[Part, Snapshot]] = field(default_factory=list)


class Path:
    """Follows the equilibrium path of a problem."""

    def __init__(self, steps: Steps, result: Result):
        self._steps, self._result = steps, result
        self._problem, self._options = steps.problem, steps.options
        self._numbers, step = steps.options.path, steps.problem.step
        self._by_work = steps.options.control == "dissipation"
        step.scales = replace(step.scales, breaking=step.scales.breaking or self._by_work)
        self.forget()

    def forget(self) -> None:
        """Discard the history of steps: the next one is like that of a resumed run, with continued
        damage."""
        self._size, self._lost = Size(last=Attempt()), False
        self._peaks = Peaks(self._steps)

    def advance(self, target: float) -> Iterator[Part]:
        """Steps until ``target`` is reached.

        Beyond a limit point steps are buffered until it is clear whether it is a real snap: they
        become rows if the load exceeds it again, as when points break one by one.
        """
        problem, step = self._problem, self._problem.step
        stage, crest = self._set_out(target), Crest()
        while True:
            before = step.snapshot()
            try:
                part, peak = self._next(stage)
            except StepFailure:
                crest.limit = crest.limit or before
                after = None if stage.traces else (yield from self._snap(stage, crest))
                if after is None:
                    raise
                stage, crest = after, Crest()
            else:
                turned = crest.limit is not None or stage.ahead(part.t, before.t) < 0
                if not (stage.follows and turned) or stage.traces:
                    crest.last = (before, part.attempt)
                    if peak:
                        peak.append((part, step.snapshot()))
                        yield from self._rows(peak)
                    else:
                        yield part
                else:
                    crest.limit = crest.limit or before
                    crest.kept.append((part, step.snapshot()))
                    ends = stage.ahead(part.t, crest.limit.t) > 0 or part.t == target
                    if ends and self._lost_twice(crest)[-1] <= self._numbers.twice:
                        yield from self._rows(crest.kept)
                        crest = Crest()
                    elif ends or stage.ahead(crest.limit.t, part.t) > stage.span:
                        stage, crest = (yield from self._snap(stage, crest)), Crest()
            if problem.t == target and not crest.kept:
                return
            if not stage.follows and before.discretization is not problem.discretization:
                # Facets have opened: there are bonds to follow now.
                stage = self._set_out(target)

    def _lost_twice(self, crest: Crest, states: Sequence[Snapshot] = ()) -> NDArray[np.float64]:
        """:func:`.done_twice` in states beyond a limit point, by default the buffered ones;
        collective."""
        before = crest.last[0] if crest.last else crest.limit
        states = states or [state for _, state in crest.kept]
        return done_twice(before, crest.limit, states, self._numbers.small)

    def _rows(self, kept: list[tuple[Part, Snapshot]]) -> Iterator[Part]:
        for part, state in kept:
            self._problem.step.return_to(state)
            yield part

    def _set_out(self, target: float) -> Stage:
        problem, loading, options = self._problem, self._problem.loading, self._options
        start, step, steps = problem.t, problem.step, self._steps
        step.set_out()
        most = options.max_share * bonds(problem)[0]
        # In passes of a step that bodies crack in, loads stay: a crack may run at once.
        by_load = options.control == "load" or steps.viscous or steps.cyclic
        by_load |= step.damage is not None
        # Bonds may break or bodies buckle; before facets open nothing is known about bonds.
        small = problem.discretization.bodies.small
        bends = most > 0 or not (small or step.activation)
        follows = not by_load and bends and loading.set_ray(start, target)
        if follows:
            self._peaks.face(loading.rate())
        else:
            loading.clear_ray()
        # Loads may reverse while the load factor increases. Damaged bonds then unload without
        # damage work, so the stage starts under load control.
        way, sense, scales = target - start, math.copysign(1.0, target - start), step.scales
        turned = unloads = scales.sense * sense < 0
        if follows and scales.sense != 0 and not turned:
            before = start - self._numbers.small * way
            turned = not loading.as_given(before)
            unloads = turned and loading.comes_back(before)
        if turned:
            self._size, scales = Size(), replace(scales, breaking=False)
        step.scales = replace(scales, sense=sense, work=min(scales.work, most or math.inf))
        traces = options.unstable == "trace" or options.control == "load" or most == 0
        return Stage(start, target, follows, traces, most, follows and unloads)

    # One step

    def _next(self, stage: Stage) -> tuple[Part, list[tuple[Part, Snapshot]]]:
        """A converged step, after one or more attempts, and the peak inside it, if there is one."""
        problem, most_cuts, last = self._problem, self._options.max_cuts, self._size.last
        start, limits, cuts, by_work = problem.t, self._limits(stage), 0, False
        while True:
            before = problem.step.snapshot()
            found = self._steps.attempt(limits, last)
            if found.converged and (refusal := self._refusal(stage, limits, before, found)):
                problem.step.return_to(before)
                found = found.failed(refusal)
            if found.converged:
                break
            self._result.failures.append((limits.target, found.reason))
            cuts += 1
            if cuts > most_cuts and found.reason == "UNSTABLE":
                # Without an imperfection the body stays on this path.
                self._lose(start)
                cuts, limits = 0, replace(limits, arc_length=math.inf)
            opened = problem.discretization is not before.discretization
            if last and (opened or 2 * cuts > most_cuts):
                last = last.going(None)
            if stabilize_pieces(problem):
                cuts = 0
                continue
            # A step at constant load cannot be cut.
            by_work |= limits.work < math.inf
            held = limits.length <= ROUNDING * stage.span
            if held or cuts - most_cuts > by_work * most_cuts // 2:
                raise StepFailure(self._complaint(limits, found), self._result)
            shorter = self._shorter(stage, limits, found, cuts - most_cuts)
            if shorter == limits and last and last.ahead is not None:
                last = last.going(None)
            elif shorter == limits and cuts <= most_cuts:
                # It would be the same attempt.
                cuts = most_cuts + 1
                shorter = self._shorter(stage, limits, found, 1)
            limits = shorter
        self._lost &= found.unstable or problem.t != stage.target
        self._size = self._next_size(stage, limits, found, cuts)
        if self._size.idle > self._numbers.idle:
            problem.step.return_to(before)
            raise StepFailure(self._complaint(limits, found.failed("NO_END")), self._result)
        part, peak = Part(problem.t, stage.done(problem.t), problem.t - start, found, cuts, 0), []
        if stage.follows and (
            inside := self._peaks.inside(before, limits, last, found, stage.most)
        ):
            attempt, state = inside
            row = Part(state.t, stage.done(state.t), state.t - start, attempt, 0, 0)
            if heals(state, problem.step.snapshot()):
                # The step ends there instead.
                problem.step.return_to(state)
                self._peaks.leave()
                self._size = replace(self._size, last=attempt)
                return row, []
            peak.append((row, state))
        return part, peak

    def _limits(self, stage: Stage) -> Limits:
        size, scales = self._size, self._problem.step.scales
        limits = Limits(self._problem.t, stage.target, stage.span, self._numbers.small * stage.most)
        if stage.follows:
            if self._stalls(stage):
                # For example if all contact slides, neither damage work nor arc length makes
                # progress.
                return limits
            if stage.unloads and not scales.breaking:
                return self._strode(limits, size.stride)
            work = scales.work if scales.breaking else math.inf
            return replace(limits, work=work, arc_length=size.arc_length)
        stride = size.stride
        if self._steps.cyclic and stride == math.inf:
            stride = self._steps.first_stride
        return self._strode(limits, stride)

    def _stalls(self, stage: Stage) -> bool:
        """Whether several steps had hardly any damage or change of the load factor."""
        last, least = self._size.last, self._numbers.small * stage.span
        moves = last is None or last.ahead is None or abs(last.ahead.t) > least
        return not moves and self._size.idle >= self._numbers.patience

    def _strode(self, limits: Limits, stride: float) -> Limits:
        if stride >= limits.length:
            return limits
        return replace(limits, target=limits.start + limits.toward * stride)

    def _shorter(self, stage: Stage, limits: Limits, found: Attempt, late: int) -> Limits:
        """Limits after a failed attempt, ``late`` cuts beyond the maximum."""
        numbers, gone = self._numbers, found.guessed
        if late > 0:
            # With contact and friction, bonds may break without damage work as a suitable control.
            by_load = replace(limits, target=stage.target, work=math.inf, arc_length=math.inf)
            return self._strode(by_load, stage.span * numbers.cut**late)
        small = stage.span * numbers.cut ** (self._options.max_cuts // 2)
        unloads = stage.unloads and limits.by_load_alone and limits.length > small
        if stage.follows and not unloads:
            # Of what the predictor did, bonds that break limit the step by their work, otherwise
            # the arc length does.
            work, way = min(gone.work, limits.work, stage.most), limits.arc_length
            if work <= limits.onset:
                work, way = limits.work, min(way, gone.arc_length or math.inf)
            work, way = max(numbers.cut * work, limits.onset), numbers.cut * way
            limits = replace(limits, work=work, arc_length=way)
            if not limits.by_load_alone:
                return limits
        share = numbers.cut if unloads else 0.5
        if self._steps.cyclic:
            # A step that did not converge was far too long.
            kept = self._options.max_loss / found.lost if found.lost else 0.0
            share = max(kept / 2, numbers.cut)
        return self._strode(limits, limits.length * share)

    def _next_size(self, stage: Stage, limits: Limits, found: Attempt, cuts: int) -> Size:
        numbers, options, size = self._numbers, self._options, self._size
        step, t = self._problem.step, self._problem.t
        slides = self._problem.discretization.slides
        growth = numbers.growth_after(found.iterations, slides)
        way = growth * limits.arc_length
        if not cuts and way > global_norm(self._problem.comm, found.ahead.u) / numbers.cut:
            way = math.inf
        work = max(growth * min(limits.work, step.scales.work), limits.onset)
        if found.onset and self._problem.discretization.bodies.points:
            # Bodies flow or bonds soften: a large step finds the second before its time.
            work = limits.onset / numbers.rest
        unloads = stage.unloads and limits.by_load_alone
        breaks = step.scales.breaking or found.onset or (cuts > 0 and stage.follows and not unloads)
        work, breaks = min(work, stage.most or math.inf), breaks or self._by_work
        step.scales = replace(step.scales, work=work, breaking=breaks)
        stride = math.inf
        if self._steps.cyclic:
            aim = (1 - numbers.missed) * options.max_loss
            room = aim / found.lost if found.lost else math.inf
            stride = min(room, 1 / numbers.cut) * limits.length
        elif cuts or size.stride < math.inf:
            stride = (1 / numbers.cut if unloads else growth) * limits.length
        # Arc-length steps may continue indefinitely without damage or progress.
        nearer = stage.ahead(t, limits.start) > numbers.small * stage.span
        idles = stage.follows and found.work <= limits.onset
        idle = size.idle + (not nearer) if idles else 0
        return Size(way, stride, found.going(None) if found.onset else found, idle)

    def _refusal(self, stage: Stage, limits: Limits, before: Snapshot, found: Attempt) -> str:
        """Why a converged step is rejected; empty if it is accepted."""
        step, numbers = self._problem.step, self._numbers
        t, scales = self._problem.t, step.scales
        if not stage.follows:
            return ""
        # Under load control a step may converge to a state off the path. It then releases energy,
        # or takes it up if it is far, apart from points that begin to yield within the step.
        back = stage.ahead(before.t, t) > 0
        # Where nothing fails the load does not turn, but another onset may be behind the start.
        if found.onset and back and limits.arc_length == math.inf:
            return "JUMPED"
        if found.work <= limits.onset and back and self._retreats(before):
            return "TURNED_BACK"
        far = found.work > stage.most or back
        if found.work > 0 and not found.onset and (far or limits.by_load_alone):
            step.ledger.complete(numbers.released / 2 * found.work)
            released = self._released(before) / found.work
            if max(released, -released if far else 0.0) > numbers.released:
                return "JUMPED"
        if stage.ahead(stage.start, t) > 0:
            if stage.unloads:
                return "TURNED_BACK"
            if not self._problem.loading.as_given(t):
                return "PROGRAMME_LEFT"
        # Breaking bonds are followed by the damage work, and beyond a limit point there are no
        # stable states nearby. Pivots of an unconstrained body are rounding.
        loose = step.rests_on_contact or scales.held
        strays = found.unstable and found.work == 0 and stage.ahead(t, before.t) > 0
        return "UNSTABLE" if strays and not (loose or self._lost) else ""

    def _retreats(self, before: Snapshot) -> bool:
        """Whether bonds that were breaking unload instead, in a step that spends nothing."""
        last, now = self._size.last, self._problem.step.snapshot()
        if last is None or last.work == 0:
            return False
        spent = (now.works.dissipated - before.works.dissipated).sum()
        spent += now.works.plastic - before.works.plastic
        return bool(global_sum(self._problem.comm, spent) <= self._numbers.small * last.work)

    def _released(self, before: Snapshot) -> float:
        """Energy released by a step, up to rounding [N mm]."""
        step, ledger = self._problem.step, self._problem.step.ledger
        now, released = step.snapshot(), ledger.energy().imbalance
        step.return_to(before)
        released -= ledger.energy().imbalance
        released -= global_sum(self._problem.comm, now.works.within)
        step.return_to(now)
        # Rounding of the energy of the bodies, however weak the bonds.
        return math.copysign(max(abs(released) - self._steps.rounding, 0.0), released)

    def _lose(self, t: float) -> None:
        """Warn that the run continues over unstable states."""
        self._lost = True
        warn_together(
            self._problem.comm,
            f"equilibria beyond load factor {t:.6g} are unstable: the tangent has negative "
            "eigenvalues. For a body that would buckle give a small imperfection, a load or an "
            "eigenstrain, and smaller steps there; for a detached piece a support",
        )

    def _complaint(self, limits: Limits, found: Attempt) -> str:
        start, end, failures = limits.start, limits.target, self._result.failures
        norms = ", ".join(f"{norm:.3g}" for norm in found.norms[-4:]) or "none"
        cuts = 0 if start == end else self._options.max_cuts
        attempts = [reason for _, reason in failures[-cuts - 1 :]] or [found.reason]
        although = f" although it was cut {cuts} times" if start != end else ""
        return (
            f"{self._beyond_the_peak(start, end)}the step from load factor {start:.8g} to "
            f"{end:.8g} failed{although}; the problem is in its state at {start:.8g}. In the last "
            f"attempt {explained(attempts)}. (Its last residuals: {norms} N.) "
            f"{hanging_piece(self._problem)}".rstrip()
        )

    def _beyond_the_peak(self, start: float, end: float) -> str:
        """The cause of a failure where the path has turned back from a peak of the load."""
        sense = math.copysign(1.0, end - start)
        history = self._result.history
        loads = history["load"] if len(history) else []
        peak = max(loads, key=lambda t: sense * t, default=start)
        if not sense * start < sense * peak < sense * end:
            return ""
        return (
            f"no equilibrium was found beyond load factor {peak:.6g}, the peak of the load: there "
            "the forces exceed what bonds and bodies carry, and then less. Prescribe "
            f"displacements to follow them further, or end before {peak:.6g}. More exactly: "
        )

    # Snaps

    def _snap(self, stage: Stage, crest: Crest) -> Generator[Part, None, Stage | None]:
        """The row of a jump, or the buffered rows if no jump succeeds.

        Returns:
            The remaining stage; None if there is neither.
        """
        top, found = self._top(stage, crest)
        if found is not None:
            self._problem.step.return_to(top)
            yield Part(top.t, stage.done(top.t), top.t - crest.limit.t, found, 0, 0)
        part = self._leap(stage, crest, top)
        if part is not None:
            yield part
            return stage.behind_jump(part.t, self._numbers)
        yield from self._rows(crest.kept)
        return replace(stage, traces=True) if crest.kept else None

    def _top(self, stage: Stage, crest: Crest) -> tuple[Snapshot, Attempt | None]:
        """The limit point, and the step that ended there if it is not a row."""
        if not crest.kept:
            return crest.limit, None
        part, behind = crest.kept[0]
        way = stage.target - stage.start
        return limit_point(self._steps, crest.last, crest.limit, (behind, part.attempt), way)

    def _leap(self, stage: Stage, crest: Crest, top: Snapshot) -> Part | None:
        """Jump from the limit point to the next equilibrium at its load; None, and undone, if there
        is none.

        Without buffered steps the stable path ended within the smallest attempt: the jump is to its
        end, or to the target.
        """
        limit = crest.limit
        if not crest.kept:
            there = self._result.failures[-1][0]
            return self._jump(stage, there, limit, limit) or self._jump(
                stage, stage.target, limit, limit
            )
        found = self._jump(stage, top.t, top, self._beyond(stage, crest, top))
        if found is None:
            self._problem.step.return_to(crest.kept[-1][1])
        return found

    def _beyond(self, stage: Stage, crest: Crest, top: Snapshot) -> Snapshot:
        """The state from which a jump starts: at the limit point there is no driving force, and far
        beyond it bonds have closed that stay open in a machine; collective."""
        away, way = self._numbers.released * stage.span, stage.target - stage.start
        losses = self._lost_twice(crest)
        whole = [state for (_, state), lost in zip(crest.kept, losses, strict=True) if lost == 0]
        if whole:
            far = (state for state in whole if stage.ahead(top.t, state.t) > away)
            return next(far, whole[-1])
        part, first = crest.kept[0]
        step, work, ahead = self._problem.step, part.attempt.work, top.change_to(first)
        for _ in range(self._numbers.halvings):
            shown, work = Attempt(work=work, ahead=ahead and Direction(*ahead)), work / 2
            step.return_to(top)
            limits = Limits(top.t, top.t + way, abs(way), work=work)
            if self._steps.attempt(limits, shown).converged:
                near = step.snapshot()
                if stage.ahead(top.t, near.t) > 0 and self._lost_twice(crest, [near])[0] == 0:
                    return near
        return first

    def _jump(self, stage: Stage, t: float, limit: Snapshot, start: Snapshot) -> Part | None:
        """Jump to a distant equilibrium, see :func:`.jump`; None, and undone, if there is none."""
        found, count = jump(self._steps, t, stage.most, limit, start)
        if not found.converged:
            self._result.failures.append((t, found.reason))
            return None
        self._size = Size()
        self._peaks.leave()
        return Part(t, stage.done(t), 0.0, found, 0, count)
