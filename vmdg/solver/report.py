"""How the iteration of a step went."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from .control import Direction


@dataclass(frozen=True)
class StepReport:
    """How the iteration of a step went.

    Attributes:
        converged: Whether the residual met the tolerance.
        norms: Residual norms on the free dofs, before every correction and at the end [N].
        reason: PETSc's word for how it ended, or one of vmdg.solver.reasons.
        goal: Residual norm at which the step has converged [N].
        krylov: Krylov iterations of all linear systems of the step, the predictor's included; 0
            where they were solved directly.
        work: Work on bonds in the step, 0 where it failed [N mm].
        change: Of displacement (owned dofs) and load factor; None where it failed or facets opened.
        ahead: The same, where facets have opened too: how the next step may go on.
        onset: Whether the step ends where damage begins, at a kink of the path.
        arc: Size of the change of displacement that was to end the step; None where something else
            was [mm].
        gradient: Change of the work on bonds with the load factor at its end; 0 where it is not
            known [N mm].
        unstable: Whether the tangent near its end is known to have negative eigenvalues.
        lost: Largest share of its strength that a point has lost in a step with cycles.
    """

    converged: bool
    norms: list[float]
    reason: str
    goal: float = math.nan
    krylov: int = 0
    work: float = 0.0
    change: Direction | None = None
    ahead: Direction | None = None
    onset: bool = False
    arc: float | None = None
    gradient: float = 0.0
    unstable: bool = False
    lost: float = 0.0

    @property
    def iterations(self) -> int:
        """Newton corrections after the predictor."""
        return max(len(self.norms) - 1, 0)

    def failed(self, reason: str) -> StepReport:
        """The same step, given up for another reason."""
        return replace(self, converged=False, reason=reason)
