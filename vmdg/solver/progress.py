"""Progress output of a run: a bar, and the residuals of every attempt."""

from __future__ import annotations

import numpy as np
from tqdm import tqdm

from ..output.bar import BAR, interval, row_in_words
from ..output.history import History
from ..problem.problem import Problem
from .attempt import Attempt
from .limits import Limits
from .options import SolveOptions


class Progress:
    """The bar of a run and, with ``options.verbose``, its attempts; printed on rank 0."""

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

    def attempted(self, limits: Limits, attempt: Attempt) -> None:
        if not self._speaks:
            return
        if self._options.verbose:
            self.say(described(self._problem.t, limits, attempt))
        jump = limits.jump
        if attempt.converged and not jump:
            return  # a row follows
        note = f"jump, overstress {attempt.end:.3g} H" if jump else f"step to {limits.target:.4g}"
        self._show(self._done, note if attempt.converged else f"{note}: {attempt.reason}")

    def advanced(self, done: float, size: float, attempt: Attempt, history: History) -> None:
        """Report an added row; collective.

        Args:
            done: Number of load factors reached, including a fraction of the current one.
        """
        if not self._options.progress:
            return
        debonded = self._problem.debonded() if self._problem.discretization.can_fail else None
        parts, row = row_in_words(history, self._options.show), history.rows[-1]
        if not self._speaks:
            return
        krylov = f" + {attempt.krylov} Krylov" if attempt.krylov else ""
        if debonded is not None:
            parts.append(f"debonded {debonded:.1%}")
        parts += [f"step {size:.2g}", f"{attempt.iterations} it{krylov}"]
        if self._options.energy:
            self._largest_work = max(self._largest_work, abs(row["external"]))
            share = row["imbalance"] / max(self._largest_work, np.finfo(float).tiny)
            parts.append(f"imbalance {share:.1e}")
        self._state = ", ".join(parts)
        self._show(done, "")

    def _show(self, done: float, note: str) -> None:
        # The current action comes first: narrow terminals truncate the end.
        texts = [text for text in (note, self._state) if text]
        self._bar.set_postfix_str(" | ".join(texts), refresh=False)
        self._bar.update(done - self._done)
        self._done = done

    def say(self, text: str) -> None:
        if self._options.verbose and self._speaks:
            tqdm.write(text)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()


def described(start: float, limits: Limits, attempt: Attempt) -> str:
    jump = limits.jump
    slowed = f" with an overstress of {attempt.end:.3g} H" if jump else ""
    norms = " ".join(f"{norm:.3e}" for norm in attempt.norms)
    krylov = f", {attempt.krylov} Krylov iterations" if attempt.krylov else ""
    failed = f"failed: {attempt.reason}; the problem is "
    return (
        f"step to load {jump.t if jump else limits.target:.8g}, {limits}{slowed}\n"
        f"  residuals {norms} N, {attempt.goal:.3e} N asked for{krylov}\n"
        f"  {'' if attempt.converged else failed}at load {start:.8g}, work {attempt.work:.4g}"
    )
