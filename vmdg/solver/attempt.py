"""What an attempt of a step is told, and how it ended."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from .limits import Direction, Reach


@dataclass(frozen=True)
class Guess:
    """How the last step went, from which the next one sets out.

    Attributes:
        ahead: Its change; None where the next one does not go on as it did.
        work: Its work on bonds; 0 where none broke [N mm].
        most: Largest work on bonds of a step [N mm].
        goes_on: Whether the path goes on from it, so that what was breaking breaks further; False
            where a run begins, is resumed, or its loads have turned.
    """

    ahead: Direction | None = None
    work: float = 0.0
    most: float = 0.0
    goes_on: bool = False


@dataclass(frozen=True)
class Attempt:
    """How an attempt of a step ended.

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
        ahead: Change of displacement and load factor, as the next step may go on; None where it
            failed.
        lost: Largest share of its strength that a point has lost in a step with cycles.
    """

    converged: bool
    norms: list[float]
    reason: str
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
