"""When the iteration of a step has converged."""

from __future__ import annotations

from dataclasses import replace

from ..problem.step import Step

#: Residual relative to the largest reaction or load so far that is never small enough.
MAX_RESIDUAL = 1e-6


class Criterion:
    """The residual norm at which a step has converged.

    The residual is small when its norm on the free dofs is below ``tolerance`` times the largest
    force the run has seen (reactions, loads, or the imbalance a step starts with). Such a scale
    stays when the body has come apart and no force is left. The imbalance of a step that carries a
    weak bond far beyond its strength may be larger than any force the bond can bear by orders of
    magnitude, so that the residual must also be small against forces that were there.

    Args:
        tolerance: Relative to the largest force.
        step: Holds the largest forces of the run, which this updates.

    Attributes:
        floor: Rounding of the internal forces, below which no residual can come [N].
    """

    def __init__(self, tolerance: float, step: Step):
        self._tolerance = tolerance
        self._step = step
        self.floor = 0.0

    def update(self, imbalance: float = 0.0, reaction: float = 0.0) -> None:
        """Take forces into account: an imbalance, and reactions or loads [N]."""
        scales = self._step.scales
        reaction = max(scales.reaction, reaction)
        force = max(scales.force, imbalance, reaction)
        self._step.scales = replace(scales, force=force, reaction=reaction)

    def goal(self, reaction: float) -> float:
        """Residual norm at which a state with this norm of the reactions has converged [N]."""
        scales = self._step.scales
        reaction = max(scales.reaction, reaction)
        small = min(self._tolerance * max(scales.force, reaction), MAX_RESIDUAL * reaction)
        return max(small, self.floor)
