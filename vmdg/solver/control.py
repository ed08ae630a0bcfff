"""Steps to a given load factor: cut and retried where the iteration fails, with jumps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from .iteration import LoadStep, StepReport
from .jump import jump
from .result import Result, StepFailure
from .stepper import Stepper


class Part(NamedTuple):
    """A converged step on the way to a given load factor.

    Attributes:
        t: Load factor.
        done: Share of the way that is done.
        size: Change of the load factor in the step.
        report: How it went.
        cuts: How often the way had been halved.
        jumps: Steps with overstress of a jump.
    """

    t: float
    done: float
    size: float
    report: StepReport
    cuts: int
    jumps: int


def advance(stepper: Stepper, target: float, result: Result) -> Iterator[Part]:
    """Reach ``target``, in several steps where one does not converge; failures join the result."""
    problem, options = stepper.problem, stepper.options
    start = problem.t
    done, size, cuts, failed = 0.0, 1.0, 0, False
    jumped_from = math.nan
    while done < 1.0:
        end = min(done + size, 1.0)
        t = target if end == 1.0 else start + end * (target - start)
        # A smaller step is the cheaper second attempt, as long as there are some left.
        last = cuts >= min(options.jump_after, options.max_cuts)
        report, jumps = stepper.step(LoadStep(t, second=last)), 0
        # From the same state to the same load a jump fails again.
        if not report.converged and last and options.jump and problem.t != jumped_from:
            jumped_from = problem.t
            result.failures.append((t, report.reason))
            # Beyond the limit point by as much as the step allows: near it a jump starts slowly.
            report, jumps = jump(stepper, target)
            if report.converged:
                end, t = 1.0, target
        if not report.converged:
            result.failures.append((t, report.reason))
            cuts, failed = cuts + 1, True
            size = (end - done) / 2
            if cuts > options.max_cuts:
                norms = ", ".join(f"{norm:.3g}" for norm in report.norms[-4:]) or "none"
                raise StepFailure(
                    f"the step from load factor {problem.t:.8g} to {t:.8g} failed "
                    f"({report.reason}, residuals {norms}) although it was cut "
                    f"{options.max_cuts} times; the problem is in its state at {problem.t:.8g}",
                    result,
                )
            continue
        yield Part(t, end, (end - done) * (target - start), report, cuts, jumps)
        done = end
        if not failed:
            size, cuts = 2 * size, max(cuts - 1, 0)
        failed = False
