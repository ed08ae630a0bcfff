"""What a run says while it goes on: a bar, and tables of residuals."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from tqdm import tqdm

from ..output.history import History, split_unit
from ..problem.problem import Problem
from .control import Control
from .options import SolveOptions
from .report import StepReport

#: Seconds between two states of the bar on a terminal, and in a file, where each is a new line.
TERMINAL, FILE = 0.1, 30.0

#: Columns that are forces by their names, and how many of them the bar shows.
FORCES, MOST = ("force", "reaction"), 3

BAR = "{desc}{percentage:3.0f}%|{bar:8}| {n:.4g}/{total:.0f} [{elapsed}<{remaining}]{postfix}"


def interval() -> float:
    """Seconds between two states of a bar: a line now and then where the output is a file."""
    return TERMINAL if sys.stderr.isatty() else FILE


class Progress:
    """The bar of a run and, with ``options.verbose``, its tables; on rank 0, the others are quiet.

    Args:
        problem: The problem.
        count: Number of load factors to reach.
        options: Of the solver.
    """

    def __init__(self, problem: Problem, count: int, options: SolveOptions):
        self._problem = problem
        self._options = options
        self._speaks = problem.comm.rank == 0
        self._state = ""
        self._done = 0.0
        self._largest_work = 0.0
        self._bar = tqdm(
            total=count,
            bar_format=BAR,
            dynamic_ncols=True,
            mininterval=interval() if options.progress is True else float(options.progress),
            miniters=0,
            disable=not (options.progress and self._speaks and count),
        )

    def attempted(self, control: Control, overstress: float, report: StepReport) -> None:
        """A step has converged or failed."""
        if not self._speaks:
            return
        if self._options.verbose:
            self.say(described(self._problem.t, control, overstress, report))
        if report.converged and not overstress:
            return  # a row follows
        jump = f"jump, overstress {overstress:.3g} H"
        note = jump if overstress else f"step to {control.target:.4g}"
        self._show(self._done, note if report.converged else f"{note}: {report.reason}")

    def advanced(self, done: float, size: float, report: StepReport, history: History) -> None:
        """A row has been added; collective.

        Args:
            done: Number of load factors that are reached, the present one in part.
            size: Of the step.
            report: How it went.
            history: The table of the run.
        """
        if not self._options.progress:
            return
        debonded = self._problem.debonded() if self._problem.discretization.can_fail else None
        row, columns = history.rows[-1], shown(history, self._options.show)
        if not self._speaks:
            return
        krylov = f" + {report.krylov} Krylov" if report.krylov else ""
        parts = [f"load {row['load']:.4g}"]
        for name in columns:
            parts.append(f"{name} {_text(row[name])}{_unit(history, name)}")
        if debonded is not None:
            parts.append(f"debonded {debonded:.1%}")
        parts += [f"step {size:.2g}", f"{report.iterations} it{krylov}"]
        if self._options.energy:
            self._largest_work = max(self._largest_work, abs(row["external"]))
            share = row["imbalance"] / max(self._largest_work, np.finfo(float).tiny)
            parts.append(f"imbalance {share:.1e}")
        self._state = ", ".join(parts)
        self._show(done, "")

    def _show(self, done: float, note: str) -> None:
        # What is going on comes first: narrow terminals cut the end.
        texts = [text for text in (note, self._state) if text]
        self._bar.set_postfix_str(" | ".join(texts), refresh=False)
        self._bar.update(done - self._done)
        self._done = done

    def say(self, text: str) -> None:
        """A line beside the tables."""
        if self._options.verbose and self._speaks:
            tqdm.write(text)

    def close(self) -> None:
        """Leave the last state of the bar."""
        self._bar.close()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def shown(history: History, wanted: Sequence[str] | str | None) -> list[str]:
    """Columns of the last row that the bar shows.

    Args:
        history: The table.
        wanted: Their names, or one name; None for the first ones called force or reaction, alone or
            with more words, as in "force_x".

    Raises:
        ValueError: a wanted column is none of the row.
    """
    row = history.rows[-1]
    if wanted is None:
        forces = [name for name in row if set(name.lower().split("_")) & set(FORCES)]
        return [name for name in forces if np.ndim(row[name]) == 0][:MOST]
    names = [split_unit(name)[0] for name in ([wanted] if isinstance(wanted, str) else wanted)]
    if missing := [name for name in names if name not in row]:
        raise ValueError(
            f"SolveOptions: show = {wanted!r}: the history has no column {missing[0]!r}, only "
            f"{', '.join(row)}"
        )
    return names


def described(start: float, control: Control, overstress: float, report: StepReport) -> str:
    """A table of the attempts of a step: residual norms and how each of them was reached.

    Args:
        start: Load factor where the problem is now.
        step: The step.
        report: How it went.
    """
    regularised = f" with overstress {overstress:.3g} H" if overstress else ""
    target = start if control.brakes else control.target
    lines = [f"step to load {target:.8g}, {control}{regularised}"]
    lines += _table(report)
    if report.converged:
        lines.append(f"  at load {start:.8g}, work {report.work:.4g}")
    if not report.converged:
        lines.append(f"  failed: {report.reason}; the problem is at load {start:.8g}")
    return "\n".join(lines)


def _table(attempt: StepReport) -> list[str]:
    head = f"{'it':>4} {'residual [N]':>14} {'ratio':>9} {'trials':>6} {'Krylov':>6} {'to':>8}"
    lines, former = [head], None
    for i, (norm, solve) in enumerate(zip(attempt.norms, attempt.solves, strict=True)):
        ratio = f"{norm / former:.1e}" if former else ""
        krylov = f"{solve.krylov:6d} {solve.tolerance:8.1e}" if solve.krylov else "-"
        trials = solve.trials or ""
        lines.append(f"{i:4d} {norm:14.6e} {ratio:>9} {trials:>6} {krylov:>6}".rstrip())
        former = norm
    lines.append(f"     {attempt.goal:14.6e} asked for, {attempt.reason}")
    return lines


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float | np.floating) else str(value)


def _unit(history: History, name: str) -> str:
    unit = history.units.get(name, "-")
    return "" if unit == "-" else f" {unit}"
