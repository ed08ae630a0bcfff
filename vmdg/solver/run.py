"""What all runs have in common: arguments, rows, files, and the state in which they end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any
from weakref import WeakSet

from petsc4py import PETSc

from ..assembly.means import lattice_of
from ..base.agreement import Interrupt, leave_together, same_arguments
from ..base.parallel import global_max
from ..base.timers import timer, timings, timings_since
from ..checkpoint.checkpoint import claim_checkpoint, warn_of_replacement, write_checkpoint
from ..checks.zone import ZoneWatch
from ..output.cell import AxialMotion, PeriodicCell
from ..output.history import History, HistoryFile
from ..problem.problem import Problem
from ..problem.states import RunScales, Snapshot
from .attempt import Attempt
from .monitors import check_functions, energy_columns, sliding_column
from .options import SolveOptions, silent
from .progress import Progress
from .result import Counts, Result, StepFailure

#: Problems that are being solved.
_running: WeakSet[Problem] = WeakSet()


def agreed(
    problem: Problem,
    call: str,
    options: SolveOptions | None,
    history: History | None,
    functions: Mapping[str, Callable[..., Any] | None],
    **given: Any,
) -> SolveOptions:
    """Check the arguments that all runs have; collective.

    Returns:
        Options of rank 0 for all ranks.

    Raises:
        TypeError: one has the wrong type.
        RuntimeError: the problem is being solved.
        ValueError: not all ranks make this call, or with other arguments.
    """
    if not isinstance(problem, Problem):
        raise TypeError(
            f"{call}: problem = {problem!r} must be a vmdg.Problem: {call}(problem, ...)"
        )
    same_arguments(
        problem.comm,
        call,
        **given,
        **{name: value and "given" for name, value in functions.items()},
        options=silent(options),
        history=len(history) if isinstance(history, History) else history,
    )
    options = SolveOptions() if options is None else options
    if not isinstance(options, SolveOptions):
        raise TypeError(f"{call}: options = {options!r} must be SolveOptions(...)")
    if history is not None and not isinstance(history, History):
        raise TypeError(f"{call}: history = {history!r} must be a History, such as result.history")
    check_functions(**functions)
    if problem in _running:
        raise RuntimeError(
            f"{call}: the problem is being solved: its monitor must not solve it. End the run by "
            "until=, or after fewer load factors, and solve again after it"
        )
    return problem.comm.bcast(options)


class Run:
    """A run within :func:`run_of`.

    Attributes:
        check: Called before every attempt; may raise to end the run; collective.
    """

    def __init__(
        self,
        problem: Problem,
        options: SolveOptions,
        result: Result,
        interrupted: Callable[[], None],
        progress: Progress,
        file: HistoryFile,
        rows: _Rows,
    ):
        self.progress, self.krylov = progress, lambda: 0
        self._zones = zones = ZoneWatch(problem)

        # Not a method: what calls it would keep the problem.
        def check() -> None:
            interrupted()
            zones.look()

        self.check = check
        self._problem, self._options, self._result = problem, options, result
        self._file, self._rows, self._written = file, rows, len(result.history)

    def add(self, row: Mapping[str, Any], found: Attempt) -> None:
        """Add a row for the current state, to which exceptions return from now on; collective."""
        self._zones.look()
        self._rows.hold_next()
        self._result.history.append(row)
        self._result.residuals.append(found.norms)
        self._file.update()

    def back(self) -> None:
        """Return to the state of the last row, or to that of the start."""
        self._rows.back()

    def save(self, at_end: bool = False) -> bool:
        """Write a checkpoint if it is due, and return whether; collective."""
        folder, unsaved = self._options.checkpoint, len(self._result.history) - self._written
        if not unsaved or not (at_end or unsaved >= self._options.checkpoint_every):
            return False
        self._written += unsaved
        if folder is not None:
            write_checkpoint(self._problem, folder, self._result.history)
        return folder is not None


@contextmanager
def run_of(
    problem: Problem, options: SolveOptions, result: Result, count: int, continued: bool
) -> Iterator[Run]:
    """A run of a problem; however it ends, the problem is in the state of its last row, or as left
    by a failed step; collective.
    """
    if options.checkpoint is not None and not continued:
        warn_of_replacement(problem.comm, options.checkpoint)
    before, run = timings(), None
    _running.add(problem)
    try:
        with (
            timer("solve"),
            Interrupt(problem.comm) as interrupt,
            _claimed(problem, options),
            HistoryFile(problem.comm, options.csv, result.history) as file,
            Progress(problem, count, options) as progress,
            _Rows(problem, result.history) as rows,
        ):
            run = Run(problem, options, result, interrupt.check, progress, file, rows)
            yield run
    except BaseException as error:
        error.result = result  # type: ignore[attr-defined]
        raise
    finally:
        _running.discard(problem)
        problem.loading.clear_ray()
        result.timings = timings_since(before)
        result.counts = Counts.from_timings(result.timings, run.krylov() if run else 0)
    if (options.progress or options.verbose) and problem.comm.rank == 0:
        print(result.summary())


class _Rows:
    """The state of the last row, restored after an error within a step; collective.

    An error may come from anywhere, also between a row and the note of its state, and on one rank
    only: states have the number of rows that belongs to them.
    """

    def __init__(self, problem: Problem, history: History):
        self._comm, self._step, self._history = problem.comm, problem.step, history
        self._states = [(len(history), self._here())]

    def _here(self) -> tuple[Snapshot, RunScales]:
        return self._step.snapshot(), self._step.scales

    def hold_next(self) -> None:
        """Note the current state as that of the next row."""
        self._states = [self._states[-1], (len(self._history) + 1, self._here())]

    def back(self) -> None:
        """Return to the state of the last row that all ranks have."""
        count = -int(global_max(self._comm, -len(self._history)))
        del self._history.rows[count:]
        state, self._step.scales = next(one for n, one in self._states[::-1] if n <= count)
        self._step.return_to(state)

    def __enter__(self) -> _Rows:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None or isinstance(error, StepFailure):
            return
        leave_together(self._comm, error)
        self.back()
        if isinstance(error, PETSc.Error) and error.__cause__ is not None:
            # Raised in a function called by PETSc.
            raise error.__cause__


def _claimed(problem: Problem, options: SolveOptions) -> AbstractContextManager:
    """The exclusive right to write checkpoints, if requested; collective."""
    if options.checkpoint is None:
        return nullcontext()
    return claim_checkpoint(problem.comm, options.checkpoint)


def common_columns(
    problem: Problem, name: str, found: Attempt, number: int, cuts: int, energy: bool
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The columns of a converged step that all runs have, in two parts; collective."""
    row = {
        "step [-]": number,
        name: problem.t,
        "iterations [-]": found.iterations,
        "residual [N]": found.norms[-1],
        "cuts [-]": cuts,
    }
    more: dict[str, Any] = {"krylov [-]": found.krylov} | sliding_column(problem)
    if problem.step.damage is not None:
        more |= {"passes [-]": found.passes}
    if lattice_of(problem.discretization.means) is not None:
        more |= PeriodicCell(problem).row()
    elif problem.discretization.means is not None:
        more |= AxialMotion(problem).row()
    if energy:
        more |= energy_columns(problem)
    return row, more
