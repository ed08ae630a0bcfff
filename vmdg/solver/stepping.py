"""A run: a sequence of load factors, its history and checkpoints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from numpy.typing import ArrayLike

from ..base.texts import in_full
from ..checks.model import check_model, checked_loads
from ..linear.features import switchboard
from ..output.history import History
from ..problem.problem import Problem
from ..problem.step import come_to_rest
from ..sensitivity.checks import check_differentiable
from ..sensitivity.derivatives import Derivatives
from .monitors import Monitor, Until, differentiable_energies, ends, row_of, watched_row
from .options import SolveOptions
from .path import Part, Path
from .result import Result
from .run import agreed, common_columns, run_of
from .steps import Steps


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
            derivatives, an unconstrained body, the softening of a law is too steep for the mesh
            (r <= H), or columns of the history with equal names, changed units, or to be shown that
            do not exist.
        TypeError: ``loads`` is a single number that is not an int, or ``options``, ``history`` or
            the result of the monitor or of ``until`` has the wrong type.
        OSError: a checkpoint or the history could not be written; the problem is in the state to be
            written.
        RuntimeError: called by a monitor of the same problem.
        KeyboardInterrupt: Ctrl-C, between two attempts of a step, or immediately if pressed twice.

    However a run ends, the problem is in the state of its last row, or as left by the last failed
    step, and an exception has the rows so far as ``result``; an error of the monitor, of ``until``
    or of a load on one rank is raised on all.
    """
    functions = {"monitor": monitor, "until": until}
    given = {"loads": in_full(loads), "derivatives": derivatives}
    options = agreed(problem, "solve", options, history, functions, **given)
    loads = checked_loads(loads, problem, None if history is None else history.rows)
    result = Result(
        history=History() if history is None else history, switches=switchboard(problem, options)
    )
    come_to_rest(problem.step)
    carried = None
    if derivatives is not None:
        check_differentiable(problem, options, history is not None)
        carried = Derivatives(problem, derivatives, options.energy)
    if loads.size:
        problem.step.rests_on_contact = check_model(problem, loads, options.unstable == "trace")
    with run_of(problem, options, result, len(loads), history is not None) as run:
        steps = Steps(problem, options, run.progress, run.check, carried)
        run.krylov = lambda: steps.krylov
        path, ended = Path(steps, result), False
        for number, target in enumerate(loads):
            for part in path.advance(float(target)):
                row = _row(part, problem, options, monitor, result, carried)
                run.add(row, part.attempt)
                run.progress.advanced(number + part.done, part.size, part.attempt, result.history)
                ended = ends(problem, until)
                if ended:
                    break
            if run.save(at_end=ended or number == len(loads) - 1):
                steps.restart()
                path.forget()
            if ended:
                break
        # Not after a failure, where a single rank must not wait for the others.
        steps.close()
    return result


def _row(
    part: Part,
    problem: Problem,
    options: SolveOptions,
    monitor: Monitor | None,
    result: Result,
    derivatives: Derivatives | None,
) -> dict[str, Any]:
    number = len(result.history) + 1
    row, more = common_columns(problem, "load [-]", part.attempt, number, part.cuts, options.energy)
    row |= {"jump_steps [-]": part.jumps} | more
    watched = watched_row(problem, monitor)
    row |= watched
    if derivatives is not None:
        energies = partial(differentiable_energies, problem) if options.energy else None
        row |= derivatives.columns(watched, partial(row_of, problem, monitor), energies)
    return row
