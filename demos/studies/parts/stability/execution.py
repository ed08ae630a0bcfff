"""Runs one case to its end, or to the error that stops it."""

from __future__ import annotations

import re
from collections.abc import Iterator

from mpi4py import MPI

import vmdg
from parts.stability.checks import Record, Run
from parts.stability.scenes import Case
from vmdg.solver.stepping import Monitor


class Refused(Exception):
    """A clear error on input where one was due."""


def execute(case: Case, comm: MPI.Comm = MPI.COMM_SELF) -> Run:
    """Solve, up to the end or to the error that stops it.

    Raises:
        Refused: the input cannot work, and the message says why.
    """
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
    problem: vmdg.Problem, case: Case, monitor: Monitor, history: vmdg.History
) -> Iterator[vmdg.Result]:
    """Solve for the loads of a case, or the times of its motion.

    Where facets open on demand, until none opens at the last load: a step that opens facets leaves
    them bonded, not yet balanced.

    Raises:
        vmdg.StepFailure: a step fails.
    """
    if case.motion:
        scheme, velocity = case.motion.scheme, case.motion.velocity
        yield vmdg.solve_dynamics(problem, case.loads, scheme, velocity, monitor, case.options)
        return
    yield vmdg.solve(problem, case.loads, case.options, monitor, history)
    before = 0
    while case.on_demand and before < (before := len(problem.u.x.array)):
        yield vmdg.solve(problem, case.loads[-1:], case.options, monitor, history)
