"""When a residual is small: the forces of a run that it is compared with."""

from __future__ import annotations

#: Tolerance of states on the way to an equilibrium, relative to that of the equilibrium.
ROUGH = 1e3

#: Residual relative to the largest reaction or load so far that is never small enough.
LOOSE = 1e-6


class Criterion:
    """The residual norm at which a step has converged.

    The residual is small when its norm on the free dofs is below ``tolerance`` times the largest
    force the run has seen (reactions, loads, or the imbalance a step starts with). Such a scale
    stays when the body has come apart and no force is left. The imbalance of a step that carries a
    weak bond far beyond its strength may be larger than any force the bond can bear by orders of
    magnitude, so that the residual must also be small against forces that were there.

    Args:
        tolerance: Relative to the force scale.
        scale: Largest force seen before [N].
        borne: Largest reaction or load seen before [N].

    Attributes:
        scale: Largest force seen so far [N].
        borne: Largest reaction or load seen so far, borne without the overstress of a jump [N].
        floor: Rounding of the internal forces, below which no residual can come [N].
        slack: Factor on the tolerance of the present step.
    """

    def __init__(self, tolerance: float, scale: float, borne: float = 0.0):
        self._tolerance = tolerance
        self.scale = scale
        self.borne = borne
        self.floor = 0.0
        self.slack = 1.0

    def see(self, imbalance: float = 0.0, borne: float = 0.0) -> None:
        """Take forces into account: an imbalance, and reactions or loads that were borne [N]."""
        self.borne = max(self.borne, borne)
        self.scale = max(self.scale, imbalance, self.borne)

    def goal(self, reaction: float) -> float:
        """Residual norm at which a state with this norm of the reactions has converged [N]."""
        borne = max(self.borne, reaction)
        small = min(self._tolerance * max(self.scale, borne), LOOSE * borne)
        return max(self.slack * small, self.floor)
