"""What a run has produced, and the error of one that could not go on."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..base.timers import Timing
from ..output.history import History
from .features import Switch


@dataclass(frozen=True)
class Result:
    """What a run produced.

    Attributes:
        history: One row a converged step: step, load, iterations, residual, cuts, the number of
            steps a jump took, Krylov iterations (0 where systems are solved directly), energies if
            asked for, and what the monitor returned.
        residuals: Residual norms of every converged step.
        failures: Load factor and reason of every step that had to be cut.
        switches: What the run has used and what it could do without, with reasons.
        timings: What the timers of vmdg have measured on this rank during the run, longest first:
            the run itself, then its parts, of which some contain others.
    """

    history: History = field(default_factory=History)
    residuals: list[list[float]] = field(default_factory=list)
    failures: list[tuple[float, str]] = field(default_factory=list)
    switches: list[Switch] = field(default_factory=list)
    timings: list[Timing] = field(default_factory=list)

    def summary(self) -> str:
        """Steps and corrections of the run, a line for every switch, and one for every timer."""
        steps = len(self.residuals)
        corrections = sum(max(len(norms) - 1, 0) for norms in self.residuals)
        head = f"{steps} steps, {corrections} corrections, {len(self.failures)} attempts failed"
        width = max((len(switch.name) for switch in self.switches), default=0)
        lines = [
            f"  {switch.name:{width}}  {'on' if switch.on else 'off':3}  {switch.reason}"
            for switch in self.switches
        ]
        return "\n".join([head, *lines, *self._timing_lines()])

    def _timing_lines(self) -> list[str]:
        if not self.timings:
            return []
        whole = self.timings[0].seconds
        width = max(len(timing.name) for timing in self.timings)
        head = f"  {'timer':{width}}  {'runs':>7}  {'seconds':>9}  share (parts may overlap)"
        return [head] + [
            f"  {name:{width}}  {runs:7d}  {seconds:9.2f}  {seconds / whole if whole else 0:5.0%}"
            for name, runs, seconds in self.timings
        ]


class StepFailure(RuntimeError):
    """A step failed at the smallest size; the problem is in its last converged state.

    Args:
        message: What failed.
        result: What was computed before.

    Attributes:
        result: What was computed before.
    """

    def __init__(self, message: str, result: Result):
        super().__init__(message)
        self.result = result
