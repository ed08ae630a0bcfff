"""Runs stress cases one after the other, examines how they end, and counts."""

from __future__ import annotations

import csv
import re
import signal
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import astuple, dataclass, fields
from itertools import chain
from pathlib import Path
from time import perf_counter

from mpi4py import MPI

import numpy as np
from numpy.random import Generator
from parts.stability import cases
from parts.stability.checks import Record, Run, finite
from parts.stability.scenes import Case
from parts.tables import markdown, progress

import vmdg

#: How a run may end, and how it must not.
GOOD = ("correct", "refused", "stopped")
BAD = ("wrong", "not finite", "hang", "crash")

#: Seconds after which a run hangs; compiling on a cold cache counts.
PATIENCE = 300


Family = Callable[[Generator], Case]

#: Families by the number of their first run, which each keeps: they take turns from there.
FAMILIES: dict[int, tuple[Family, ...]] = {
    0: (
        cases.aspect_ratio, cases.contrast, cases.incompressible, cases.distortion, cases.inverted,
        cases.steep_softening, cases.step_sizes, cases.large_strain, cases.weak_bond,
        cases.polycrystal, cases.crack_tip, cases.random_facets, cases.inclined,
        cases.corner_cells,
    ),
    420: (cases.on_demand, cases.viscous),
}  # fmt: skip


def numbers(each: int) -> list[int]:
    """Numbers of the first runs of every family, 30 at most."""
    return [
        n
        for first, some in FAMILIES.items()
        for n in range(first, first + min(each, 30) * len(some))
    ]


def draw(number: int) -> Case:
    first = max(start for start in FAMILIES if start <= number)
    some = FAMILIES[first]
    return some[(number - first) % len(some)](np.random.default_rng(number))


class Refused(Exception):
    """A clear error on input where one was due."""


def execute(case: Case, comm: MPI.Comm = MPI.COMM_SELF) -> Run:
    """Solve, up to the end or to the error that stops it."""
    try:
        problem = case.problem(comm=comm)
    except ValueError as error:
        if case.refusal and re.search(case.refusal, str(error)):
            raise Refused(str(error)) from None
        raise
    run = Run(case, problem, [Record.of(problem, case)])

    def monitor(problem: vmdg.Problem) -> None:
        run.records.append(Record.of(problem, case))

    history = vmdg.History()
    try:
        for result in solves(problem, case, monitor, history):
            run.failures += result.failures
            run.residuals += result.counts.residuals
            history = result.history
    except vmdg.StepFailure as error:
        run.stopped = str(error)
        run.failures += error.result.failures
        run.residuals += error.result.counts.residuals
    except ValueError as error:
        if not (case.refusal and re.search(case.refusal, str(error))):
            raise
        run.stopped = str(error)
    run.history = history
    return run


def solves(
    problem: vmdg.Problem, case: Case, monitor: Callable, history: vmdg.History
) -> Iterator[vmdg.Result]:
    """Solve for the loads of a case.

    Where facets open on demand, until none opens at the last load: a step that opens facets leaves
    them bonded, not yet balanced.
    """
    yield vmdg.solve(problem, case.loads, case.options, monitor, history)
    before = 0
    while case.on_demand and before < (before := len(problem.u.x.array)):
        yield vmdg.solve(problem, case.loads[-1:], case.options, monitor, history)


class Hang(BaseException):
    """The time of a run is over. No Exception, so that nothing on the way takes it for one."""


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise :class:`Hang` in the block after this time [s]."""

    def ring(*_: object) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    number: int  # Of the run
    family: str  # What it was to stress
    verdict: str  # One of GOOD or BAD
    steps: int  # Converged steps
    cuts: int  # Steps that had to be cut
    residuals: int  # Assembled by the solver
    seconds: float  # Time it took, checks included
    case: str  # What was drawn
    detail: str  # Message of the error, or what was found wrong


def examine(run: Run) -> tuple[str, str]:
    if faults := finite(run):
        return "not finite", faults[0]
    faults = run.faults()
    if run.case.must_refuse:
        faults.append("went through")
    if faults:
        return "wrong", "; ".join([*faults, run.stopped])
    return ("stopped", run.stopped) if run.stopped else ("correct", "")


def stress(
    number: int,
    patience: float = PATIENCE,
    execute: Callable[[Case], Run] = execute,
    draw: Callable[[int], Case] = draw,
) -> Outcome:
    start = perf_counter()
    case = draw(number)
    run: Run | None = None
    with warnings.catch_warnings():
        # As in the test suite: an overflow or a NaN in the engine is a failure.
        warnings.filterwarnings("error", category=RuntimeWarning, module="vmdg")
        try:
            with time_limit(patience):
                run = execute(case)
                verdict, detail = examine(run)
        except Refused as refusal:
            verdict, detail = "refused", str(refusal)
        except Hang:
            verdict, detail = "hang", traceback.format_exc(limit=-3)
        except Exception:
            # A library that was interrupted may report an error of its own.
            late = perf_counter() - start >= patience
            verdict, detail = "hang" if late else "crash", traceback.format_exc()
    steps = len(run.records) - 1 if run else 0
    cuts = len(run.failures) if run else 0
    residuals = run.residuals if run else 0
    seconds = perf_counter() - start
    return Outcome(number, case.family, verdict, steps, cuts, residuals, seconds, str(case), detail)


def families(outcomes: Sequence[Outcome]) -> list[str]:
    return list(dict.fromkeys(outcome.family for outcome in outcomes))


def counts(outcomes: Sequence[Outcome], family: str | None = None) -> Counter:
    return Counter(o.verdict for o in outcomes if family in (None, o.family))


def table(outcomes: Sequence[Outcome]) -> str:
    rows = []
    for name, family in [*((f, f) for f in families(outcomes)), ("all", None)]:
        mine = [o for o in outcomes if family in (None, o.family)]
        number = counts(mine)
        cells = [
            *(name, len(mine)),
            *(number[verdict] for verdict in (*GOOD, *BAD)),
            sum(o.steps for o in mine),
            sum(o.cuts for o in mine),
            sum(o.residuals for o in mine),
            f"{max(o.seconds for o in mine):.1f}",
        ]
        rows.append(cells)
    return markdown(["family", "runs", *GOOD, *BAD, "steps", "cut", "residuals", "s"], rows)


def run_all(
    numbers: Sequence[int],
    judge: Callable[[int], Outcome],
    name: str,
    out: str,
    only: int | None = None,
    shown: Sequence[str] = BAD,
    together: bool = False,
) -> list[Outcome]:
    """Judge runs, or the ``only`` one of a number; table and list of a study go to ``out``.

    Those whose verdict is among ``shown`` are printed. Ranks take turns, unless they judge every
    run ``together``.
    """
    comm, outcomes = MPI.COMM_WORLD, []
    chosen = numbers if only is None else [only]
    if not together:
        chosen = chosen[comm.rank :: comm.size]
    bar = progress(chosen, "run", shown=comm.rank == 0)
    for number in bar:
        outcomes.append(outcome := judge(number))
        if (outcome.verdict in shown or only is not None) and not (together and comm.rank):
            lines = (f"run {number}, {outcome.family}: {outcome.verdict}", outcome.case)
            bar.write("\n".join((*lines, outcome.detail)))
    if not together:
        outcomes = sorted(chain(*comm.allgather(outcomes)), key=lambda outcome: outcome.number)
    if comm.rank == 0 and only is None:
        folder = Path(out)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.md").write_text(table(outcomes) + "\n")
        write_csv(outcomes, folder / f"{name}.csv")
        print(table(outcomes))
        print(f"results are in {out}")
    return outcomes


def write_csv(outcomes: Sequence[Outcome], path: Path) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([field.name for field in fields(Outcome)])
        for outcome in outcomes:
            writer.writerow([round(v, 2) if isinstance(v, float) else v for v in astuple(outcome)])
