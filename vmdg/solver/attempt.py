"""How an attempt of a step ended."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from .limits import Direction, Reach


@dataclass(frozen=True)
class Attempt:
    """Outcome of an attempt of a step, from which the next one starts."""

    converged: bool = True  # Whether the residual met the tolerance at the end of the step
    # Residual norms on the free dofs, before every correction and at the end [N]
    norms: list[float] = field(default_factory=list)
    reason: str = ""
    goal: float = math.nan  # Residual norm at which the step has converged [N]
    # Krylov iterations of all linear systems of the step, the predictor's included; 0 where they
    # were solved directly
    krylov: int = 0
    guessed: Reach = field(default_factory=Reach)
    end: float = math.nan  # Load factor, or overstress in a jump, at its end
    slope: float = 0.0  # dD/dlambda at its end, D the damage work; 0 if D does not grow [N mm]
    onset: bool = False  # Whether the step ends at the onset of damage, a kink of the path
    passed: float = -math.inf  # Force on the supports at an onset that it passes [N]; -inf for none
    unstable: bool = False  # Whether the tangent near its end is known to have negative eigenvalues
    work: float = 0.0  # Damage work in the step, 0 if it failed [N mm]
    # Change of displacement and load factor; None if it failed, or if the next step does not
    # continue it
    ahead: Direction | None = None
    lost: float = 0.0  # Largest fraction of the strength lost at a point in a step with cycles
    passes: int = 1  # Number of equilibria until the damage of bodies had converged

    @property
    def iterations(self) -> int:
        return max(len(self.norms) - 1, 0)

    def failed(self, reason: str) -> Attempt:
        return replace(self, converged=False, reason=reason)

    def going(self, ahead: Direction | None) -> Attempt:
        return replace(self, ahead=ahead)
