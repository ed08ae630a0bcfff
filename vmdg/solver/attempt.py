"""How an attempt of a step ended."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from .limits import Direction, Reach


@dataclass(frozen=True)
class Attempt:
    """How an attempt of a step ended; the next one sets out from it.

    Attributes:
        converged: Whether the residual met the tolerance where the step was to end.
        norms: Residual norms on the free dofs, before every correction and at the end [N].
        reason: PETSc's word for how it ended, or one of vmdg.solver.reasons.
        goal: Residual norm at which the step has converged [N].
        krylov: Krylov iterations of all linear systems of the step, the predictor's included; 0
            where they were solved directly.
        guessed: Where the first guess led.
        end: Load factor, or overstress in a jump, that it came to.
        slope: dD/dlambda at its end, D the work on bonds; 0 where D does not grow [N mm].
        onset: Whether the step ends where damage begins, at a kink of the path.
        unstable: Whether the tangent near its end is known to have negative eigenvalues.
        work: Work on bonds in the step, 0 where it failed [N mm].
        ahead: Change of displacement and load factor; None where it failed, or where the next step
            does not go on as it did.
        lost: Largest share of its strength that a point has lost in a step with cycles.
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
    unstable: bool = False
    work: float = 0.0
    ahead: Direction | None = None
    lost: float = 0.0

    @property
    def iterations(self) -> int:
        """Newton corrections after the first guess."""
        return max(len(self.norms) - 1, 0)

    def failed(self, reason: str) -> Attempt:
        """The same attempt, given up for a reason."""
        return replace(self, converged=False, reason=reason)

    def going(self, ahead: Direction | None) -> Attempt:
        """The same attempt, as if its change had been another one."""
        return replace(self, ahead=ahead)
