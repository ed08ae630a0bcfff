"""A run: a sequence of load factors, its history and checkpoints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from weakref import WeakSet

from petsc4py import PETSc

from numpy.typing import ArrayLike

from ..assembly.means import lattice_of
from ..base.agreement import Interrupt, leave_together, same_arguments
from ..base.texts import in_full
from ..base.timers import timer, timings, timings_since
from ..checkpoint.checkpoint import claim_checkpoint, warn_of_replacement, write_checkpoint
from ..linear.features import switchboard
from ..output.axial import AxialMotion
from ..output.cell import PeriodicCell
from ..output.history import History, HistoryFile
from ..problem.checks import check_model, checked_loads
from ..problem.problem import Problem
from ..sensitivity.checks import check_differentiable
from ..sensitivity.derivatives import Derivatives
from .monitors import (
    Monitor,
    Until,
    check_functions,
    differentiable_energies,
    ends,
    energy_columns,
    row_of,
    sliding_column,
    watched_row,
)
from .options import SolveOptions, silent
from .path import Part, Path
from .progress import Progress
from .result import Counts, Result, StepFailure
from .steps import Steps

#: Problems that are being solved.
_running: WeakSet[Problem] = WeakSet()


def solve(
    problem: Problem,
    loads: ArrayLike,
    options: SolveOptions | None = None,
    monitor: Monitor | None = None,
    history: History | None = None,
    until: Until | None = None,
    derivatives: Sequence[str] | Mapping[str, float] | None = None,
) -> Result:
    """Solve for a sequence of load factors.

    Args:
        problem: Changed in place; ends in the state of the last load factor. Bodies that move after
            :func:`vmdg.solve_dynamics` are brought to rest.
        loads: Load factors to reach in sequence; an int is a number of equal steps to 1.
        options: See :class:`SolveOptions`; equal on all ranks but for what is printed, where those
            of rank 0 apply.
        monitor: Called after every converged step, on all ranks; it returns numbers for the history
            row, by names that may include a unit: "force [N]" is column "force". They must be equal
            on every rank, and the problem must not be changed.
        history: History of an earlier run to continue.
        until: Called after every row; the run ends when it returns True on any rank. For example
            for dead loads beyond the peak, which may never reach the next load factor:
            ``until=lambda problem: abs(problem.u.x.array).max() > 9``.
        derivatives: Parameters by which columns of the history are differentiated: "bond.strength"
            of the law of an interface, "matrix.E" of the material of a group, by name or tag,
            "matrix.eigenstrain", or "Debonding.strength" of all laws of a class. There is a column
            "d force/d bond.strength" for the load factor, for every column of floats of the
            monitor, and for energies with ``SolveOptions(energy=True)``. The monitor is called
            again at neighbouring states, with ``problem.loading.nearby``. The column "frozen"
            counts jumps: they have no derivative, NaN in their row, and history counts as fixed in
            them. A parameter that varies in space and an eigenstrain are differentiated by a common
            factor, or, with a dict, by the value that it has there.

    Raises:
        StepFailure: a step fails after ``max_cuts`` reductions.
        ValueError: no load factors (and no history), an unknown parameter or a problem without
            derivatives, an unconstrained body, the softening of a law
            is too steep for the mesh (r <= H), ``condensed=True`` where it is not possible, or
            columns of the history with equal names, changed units, or to be shown that do not
            exist.
        TypeError: ``loads`` is a single number that is not an int, or ``options``, ``history`` or
            the result of the monitor or of ``until`` has the wrong type.
        OSError: a checkpoint or the history could not be written; the problem is in the state to be
            written.
        RuntimeError: called by a monitor of the same problem.
        KeyboardInterrupt: Ctrl-C, between two attempts of a step, or immediately if pressed twice.

    However a run ends, the problem is in the state of its last row, or as left by the last failed
    step; an error of the monitor, of ``until`` or of a load on one rank is raised on all.
    """
    options = SolveOptions() if options is None else options
    if not isinstance(problem, Problem):
        raise TypeError(
            f"solve: problem = {problem!r} must be a vmdg.Problem: solve(problem, loads)"
        )
    same_arguments(
        problem.comm,
        "solve",
        loads=in_full(loads),
        monitor=monitor and "given",
        until=until and "given",
        derivatives=derivatives,
        history=len(history) if isinstance(history, History) else history,
        options=silent(options),
    )
    if not isinstance(options, SolveOptions):
        raise TypeError(f"solve: options = {options!r} must be SolveOptions(...)")
    if history is not None and not isinstance(history, History):
        raise TypeError(f"solve: history = {history!r} must be a History, such as result.history")
    functions = {"monitor": monitor, "until": until}
    check_functions(**functions)
    _refuse_nested(problem)
    loads = checked_loads(loads, problem, None if history is None else history.rows)
    # Options of rank 0 for bars apply to all.
    options = problem.comm.bcast(options)
    result = Result(
        history=History() if history is None else history, switches=switchboard(problem, options)
    )
    problem.step.come_to_rest()
    carried = None
    if derivatives is not None:
        if isinstance(derivatives, str) or not len(derivatives):
            raise ValueError(
                f"solve: derivatives = {derivatives!r} must be one or more names of parameters, "
                'such as ["bond.strength"]'
            )
        check_differentiable(problem, options, history is not None)
        carried = Derivatives(problem, derivatives, options.energy)
    if loads.size:
        problem.step.rests_on_contact = check_model(problem, loads, options.unstable == "trace")
    if options.checkpoint is not None and history is None:
        warn_of_replacement(problem.comm, options.checkpoint)
    before, written, steps = timings(), len(result.history), None
    _running.add(problem)
    try:
        with (
            timer("solve"),
            Interrupt(problem.comm) as interrupt,
            claimed(problem, options),
            HistoryFile(problem.comm, options.csv, result.history) as file,
            Progress(problem, len(loads), options) as progress,
            _Rows(problem) as rows,
        ):
            steps = Steps(problem, options, progress, interrupt.check, carried)
            path = Path(steps, result)
            for number, target in enumerate(loads):
                ended = False
                for part in path.advance(float(target)):
                    _add_row(part, problem, options, monitor, result, carried)
                    rows.hold()
                    file.update()
                    progress.advanced(number + part.done, part.size, part.attempt, result.history)
                    ended = ends(problem, until)
                    if ended:
                        break
                if ended:
                    break
                if len(result.history) - written >= options.checkpoint_every:
                    written = _write_checkpoint(steps, path, result)
            if len(result.history) > written:
                _write_checkpoint(steps, path, result)
            # Not after a failure, where a single rank must not wait for the others.
            steps.close()
    finally:
        _running.discard(problem)
        problem.loading.clear_ray()
        result.timings = timings_since(before)
        result.counts = Counts.from_timings(result.timings, steps.krylov if steps else 0)
    if (options.progress or options.verbose) and problem.comm.rank == 0:
        print(result.summary())
    return result


def _refuse_nested(problem: Problem) -> None:
    """Refuse nested runs of a problem, which would share its state; on every rank."""
    if problem in _running:
        raise RuntimeError(
            "solve: the problem is being solved: its monitor must not solve it. End the run by "
            "until=, and solve again after it"
        )


class _Rows:
    """The state of the last row, restored after an error within a step; collective.

    Args:
        problem: The problem, in a converged state.
    """

    def __init__(self, problem: Problem):
        self._comm, self._step = problem.comm, problem.step
        self._state, self._scales = problem.step.snapshot(), problem.step.scales

    def hold(self) -> None:
        """Mark the current state as that of a row."""
        self._state, self._scales = self._step.snapshot(), self._step.scales

    def __enter__(self) -> _Rows:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None or isinstance(error, StepFailure):
            return
        leave_together(self._comm, error)
        self._step.return_to(self._state)
        self._step.scales = self._scales
        if isinstance(error, PETSc.Error) and error.__cause__ is not None:
            # Raised in a function called by PETSc.
            raise error.__cause__


def claimed(problem: Problem, options: SolveOptions) -> AbstractContextManager:
    """The exclusive right to write checkpoints, if requested; collective."""
    if options.checkpoint is None:
        return nullcontext()
    return claim_checkpoint(problem.comm, options.checkpoint)


def _write_checkpoint(steps: Steps, path: Path, result: Result) -> int:
    """Write a checkpoint if requested; return the number of saved rows."""
    folder = steps.options.checkpoint
    if folder is not None:
        write_checkpoint(steps.problem, folder, result.history)
        steps.restart()
        path.forget()
    return len(result.history)


def _add_row(
    part: Part,
    problem: Problem,
    options: SolveOptions,
    monitor: Monitor | None,
    result: Result,
    derivatives: Derivatives | None,
) -> None:
    """Add the row of a converged step."""
    row = {
        "step [-]": len(result.history) + 1,
        "load [-]": part.t,
        "iterations [-]": part.attempt.iterations,
        "residual [N]": part.attempt.norms[-1],
        "cuts [-]": part.cuts,
        "jump_steps [-]": part.jumps,
        "krylov [-]": part.attempt.krylov,
    }
    row |= sliding_column(problem)
    if lattice_of(problem.discretization.means) is not None:
        row |= PeriodicCell(problem).row()
    elif problem.discretization.means is not None:
        row |= AxialMotion(problem).row()
    if options.energy:
        row |= energy_columns(problem)
    watched = watched_row(problem, monitor)
    row |= watched
    if derivatives is not None:
        energies = partial(differentiable_energies, problem) if options.energy else None
        row |= derivatives.columns(watched, partial(row_of, problem, monitor), energies)
    result.history.append(row)
    result.residuals.append(part.attempt.norms)
