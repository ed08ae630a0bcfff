"""The tie: an interface that never opens."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .base import Array, Law, Update


@dataclass(frozen=True)
class Bonded(Law):
    """Perfect bond: zeta = 0 always, no history, tensor tau_s in the residual (27)."""

    inelastic = False
    strength = math.inf

    @property
    def softening_modulus(self) -> float:
        """Zero: a tie does not soften, any positive penalty is admissible."""
        return 0.0

    def _advance(
        self,
        trial: Array,
        normal: Array,
        gap: Array,
        softening: Array,
        penalty: Array,
        eta: float | Array,
    ) -> Update:
        return Update.elastic(trial, gap, softening)
