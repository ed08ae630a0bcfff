"""Runs stress cases one after the other, examines how they end, and counts."""

from __future__ import annotations

import csv
import signal
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

import vmdg
from parts.stability.checks import Run, finite
from parts.stability.execution import Refused, execute
from parts.stability.families import draw
from parts.stability.scenes import Case
from parts.tables import markdown
from parts.vtx import read_vtx

#: How a run may end, and how it must not.
GOOD = ("correct", "refused", "stopped")
BAD = ("wrong", "not finite", "hang", "crash")

#: Seconds after which a run hangs; compiling on a cold cache counts.
PATIENCE = 300

#: Every so many runs fields are written to files and read again.
FILES_EVERY = 10


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
    """How a run ended.

    Attributes:
        number: Of the run.
        family: What it was to stress.
        verdict: One of GOOD or BAD.
        steps: Converged steps.
        cuts: Steps that had to be cut.
        residuals: Assembled by the solver.
        seconds: Time it took, checks included.
        case: What was drawn.
        detail: Message of the error, or what was found wrong.
    """

    number: int
    family: str
    verdict: str
    steps: int
    cuts: int
    residuals: int
    seconds: float
    case: str
    detail: str


def examine(run: Run, files: bool = False) -> tuple[str, str]:
    """Verdict and detail of a run that has ended.

    Args:
        run: The run.
        files: Also write table and fields, and look for NaN in the files.
    """
    if faults := finite(run):
        return "not finite", faults[0]
    faults = run.faults()
    if run.case.must_refuse:
        faults.append("went through")
    if faults:
        return "wrong", "; ".join([*faults, run.stopped])
    if files:
        with TemporaryDirectory() as folder:
            if faults := files_finite(run, Path(folder)):
                return "not finite", faults[0]
    return ("stopped", run.stopped) if run.stopped else ("correct", "")


def stress(
    number: int,
    patience: float = PATIENCE,
    execute: Callable[[Case], Run] = execute,
    draw: Callable[[int], Case] = draw,
) -> Outcome:
    """Draw, run and examine one case.

    Args:
        number: Of the case.
        patience: Seconds after which it hangs.
        execute: Runs a case.
        draw: Case of a number.
    """
    start = perf_counter()
    case = draw(number)
    run: Run | None = None
    with warnings.catch_warnings():
        # As in the test suite: an overflow or a NaN in the engine is a failure.
        warnings.filterwarnings("error", category=RuntimeWarning, module="vmdg")
        try:
            with time_limit(patience):
                run = execute(case)
                verdict, detail = examine(run, files=number % FILES_EVERY == 0)
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


def files_finite(run: Run, folder: Path) -> list[str]:
    """Write the table and the fields of a run, read them, and look for what is not finite."""
    run.history.to_csv(folder / "history.csv")
    with (folder / "history.csv").open() as file:
        found = [row for row in csv.DictReader(file) if not _finite_row(row)]
    with vmdg.FieldWriter(run.problem, folder / "fields") as writer:
        writer.write(run.problem.t)
    count = 0
    for path in sorted((folder / "fields").glob("*.bp")):
        for name, values in read_vtx(path).items():
            count += 1
            if not np.isfinite(values).all():
                found.append(f"{path.name}: {name}")
    if not count:
        found.append("no field was written")
    return [f"not finite in a file: {item}" for item in found]


def _finite_row(row: Mapping[str, str]) -> bool:
    return all(np.isfinite(float(value)) for value in row.values() if value)


def families(outcomes: Sequence[Outcome]) -> list[str]:
    """Names of the families, in the order they came."""
    return list(dict.fromkeys(outcome.family for outcome in outcomes))


def counts(outcomes: Sequence[Outcome], family: str | None = None) -> Counter:
    """Outcomes by verdict, of one family or of all."""
    return Counter(o.verdict for o in outcomes if family in (None, o.family))


def table(outcomes: Sequence[Outcome]) -> str:
    """Counts by family as a Markdown table."""
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


def write_csv(outcomes: Sequence[Outcome], path: Path) -> None:
    """One line a run."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([field.name for field in fields(Outcome)])
        for outcome in outcomes:
            writer.writerow([round(v, 2) if isinstance(v, float) else v for v in astuple(outcome)])


def chart(outcomes: Sequence[Outcome]) -> Figure:
    """Outcomes by family as stacked bars."""
    names = families(outcomes)
    figure, ax = plt.subplots(figsize=(9, 0.34 * len(names) + 1.6), layout="constrained")
    colours = dict(
        zip((*GOOD, *BAD), ("#4c9f70", "#6c8ebf", "#e0a83c", *["#c0392b"] * len(BAD)), strict=True)
    )
    start = np.zeros(len(names))
    for verdict, colour in colours.items():
        share = np.array([counts(outcomes, name)[verdict] for name in names], dtype=float)
        if verdict in GOOD or share.any():
            bars = ax.barh(names, share, left=start, color=colour, label=verdict)
            ax.bar_label(bars, [f"{n:.0f}" if n else "" for n in share], label_type="center")
        start += share
    ax.invert_yaxis()
    ax.set(xlabel="runs", title=f"{len(outcomes)} random stress runs")
    ax.legend(ncols=len(GOOD) + len(BAD), loc="upper center", bbox_to_anchor=(0.5, -0.12))
    ax.spines[["top", "right"]].set_visible(False)
    return figure
