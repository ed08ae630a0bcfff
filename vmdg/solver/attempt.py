"""How an attempt of a step ended."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from .limits import Direction, Reach


@dataclass(frozen=True)
class Attempt:
    """Outcome of an attempt of a step, from which the next one starts.

    Attributes:
        converged: Whether the residual met the tolerance at the end of the step.
        norms: Residual norms on the free dofs, before every correction and at the end [N].
        goal: Residual norm at which the step has converged [N].
        krylov: Krylov iterations of all linear systems of the step, the predictor's included; 0
            where they were solved directly.
        end: Load factor, or overstress in a jump, at its end.
        slope: dD/dlambda at its end, D the damage work; 0 if D does not grow [N mm].
        onset: Whether the step ends at the onset of damage, a kink of the path.
        passed: Force on the supports at an onset that it passes [N]; -inf for none.
        unstable: Whether the tangent near its end is known to have negative eigenvalues.
        work: Damage work in the step, 0 if it failed [N mm].
        ahead: Change of displacement and load factor; None if it failed, or if the next step does
            not continue it.
        lost: Largest fraction of the strength lost at a point in a step with cycles.
    """

    converged: bool = True
    norms: list[float] = field(default_factory=list)
    reason: str = ""
    goal: float = math.nan
    krylov: int = 0
    guessed: Reach = field(default_factory=Reach)
    end: float = math.nan
    slope: float = 0.0
    onset: bool = False
    passed: float = -math.inf
    unstable: bool = False
    work: float = 0.0
    ahead: Direction | None = None
    lost: float = 0.0

    @property
    def iterations(self) -> int:
        return max(len(self.norms) - 1, 0)

    def failed(self, reason: str) -> Attempt:
        return replace(self, converged=False, reason=reason)

    def going(self, ahead: Direction | None) -> Attempt:
        return replace(self, ahead=ahead)
