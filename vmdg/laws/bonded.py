"""The tie: an interface that never opens."""

from __future__ import annotations

import math
from dataclasses import dataclass

from numpy.typing import ArrayLike

from .base import Law, Update


@dataclass(frozen=True)
class Bonded(Law):
    """Perfect bond: zeta = 0 for ever, no history, tensor tau_s in the residual (27)."""

    inelastic = False
    strength = math.inf

    @property
    def softening_modulus(self) -> float:
        """Zero: a tie does not soften, any positive penalty will do."""
        return 0.0

    def return_map(
        self,
        trial: ArrayLike,
        normal: ArrayLike,
        gap: ArrayLike,
        softening: ArrayLike,
        penalty: ArrayLike,
        dt: float = 1.0,
    ) -> Update:
        """Every point is elastic; arguments and errors as in `Law.return_map`."""
        trial, _, gap, softening, _ = self._checked(trial, normal, gap, softening, penalty, dt)
        return Update.elastic(trial, gap, softening)
