"""The result of a run, and the error of a run that could not continue."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

from ..base.tables import html_table
from ..base.timers import Timing
from ..linear.features import Switch
from ..output.history import History
from .reasons import explained


@dataclass(frozen=True)
class Counts:
    """Work of a run, failed steps included; the same on every rank.

    Attributes:
        factorizations: Matrices factorized for direct solves.
        preconditioners: Set-ups for Krylov solves: factors for reuse, or multigrid.
        solves: Right-hand sides solved with the tangent.
        krylov: Krylov iterations of both; none where they are solved directly.
        residuals: Residuals of the whole problem.
        tangents: Tangents of the whole problem.
        return_maps: Evaluations of the return maps, of all points at once.
    """

    factorizations: int = 0
    preconditioners: int = 0
    solves: int = 0
    krylov: int = 0
    residuals: int = 0
    tangents: int = 0
    return_maps: int = 0

    @classmethod
    def from_timings(cls, timings: Sequence[Timing], krylov: int) -> Counts:
        """Counts from the timers around the work.

        Args:
            timings: Timings of the run.
            krylov: Krylov iterations of all steps.
        """
        runs = {timing.name: timing.runs for timing in timings}
        counts = {name: sum(runs.get(timer, 0) for timer in of) for name, of in _TIMERS.items()}
        return cls(**counts, krylov=krylov)

    def __str__(self) -> str:
        done = {name.replace("_", " "): number for name, number in asdict(self).items() if number}
        return ", ".join(f"{number} {name}" for name, number in done.items())


#: Timers of each count.
_TIMERS = {
    "factorizations": ("factorize",),
    "preconditioners": ("set up preconditioner",),
    "solves": ("linear solve",),
    "residuals": ("assemble residual",),
    "tangents": ("tangent at points",),
    "return_maps": ("return map",),
}


@dataclass
class Result:
    """The result of a run.

    Attributes:
        history: One row per converged step: step, load, iterations, residual, cuts, number of steps
            of a jump, Krylov iterations (0 for direct solves), with friction the largest slip in
            contact relative to the facet size, energies if requested, and the values of the
            monitor.
        residuals: Residual norms of every converged step.
        failures: Load factor and reason of every step that had to be cut.
        switches: Features that the run used and omitted, with reasons.
        counts: Work of the run.
        timings: Readings of vmdg's timers on this rank during the run, longest first: the run
            itself, then its parts, some of which are nested.
    """

    history: History = field(default_factory=History)
    residuals: list[list[float]] = field(default_factory=list)
    failures: list[tuple[float, str]] = field(default_factory=list)
    switches: list[Switch] = field(default_factory=list)
    counts: Counts = field(default_factory=Counts)
    timings: list[Timing] = field(default_factory=list)

    def summary(self) -> str:
        """Steps, corrections and work of the run, a line for every switch and every timer."""
        width = max((len(switch.name) for switch in self.switches), default=0)
        lines = [
            f"  {switch.name:{width}}  {'on' if switch.on else 'off':3}  {switch.reason}"
            for switch in self.switches
        ]
        return "\n".join([self._head(), f"  {self.counts}", *lines, *self._timing_lines()])

    def _head(self) -> str:
        steps = len(self.residuals)
        corrections = sum(max(len(norms) - 1, 0) for norms in self.residuals)
        return f"{steps} steps, {corrections} corrections, {len(self.failures)} attempts failed"

    def __repr__(self) -> str:
        return f"<Result: {self._head()}; {self.counts}>"

    def _repr_html_(self) -> str:
        failures = html_table(("load", "failed attempt"), self.failures) if self.failures else ""
        return f"<p>{self._head()}; {self.counts}</p>{failures}{self.history._repr_html_()}"

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

    The message contains the reason and remedies, as in "When a step fails" in the guide.

    Args:
        message: What failed.
        result: Results computed before the failure.

    Attributes:
        result: Results computed before the failure.
    """

    def __init__(self, message: str, result: Result):
        super().__init__(message)
        self.result = result

    def __str__(self) -> str:
        """The message, with the last failed jump, which may have been tried after it."""
        jumps = [(t, text) for t, text in self.result.failures if text.startswith("JUMP_FAILED")]
        if not jumps:
            return super().__str__()
        t, text = jumps[-1]
        return f"{super().__str__()} At load factor {t:.8g} {explained([text])}."
