"""Contact without a bond: an interface that was never bonded, or a pre-existing crack."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .base import Array, Parameter, check_parameters
from .extrinsic import RadialLaw


@dataclass(frozen=True)
class Contact(RadialLaw):
    """Unilateral contact with Coulomb friction: the limit of any other law without its bond.

    T = 0 where the interface is open; in contact T_N <= 0, zeta_N = 0 and |T_T| <= mu |T_N|. At
    rest the tangent does not couple the two sides: constrain both bodies or press them together.

    Attributes:
        friction: Coulomb coefficient mu.

    Raises:
        ValueError: the coefficient is out of range.
    """

    friction: Parameter = 0.0
    strength = 0.0

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def softening_modulus(self) -> float:
        """Zero: nothing softens."""
        return 0.0

    def utilization(self, normal: Array, shear: Array) -> Array:
        """Infinite: there is no strength."""
        return np.full_like(normal, np.inf)

    def slip(self, load: Array, resistance: Array, stiffness: Array) -> Array:
        """The free slip load/stiffness."""
        return load / stiffness

    def soften(self, resistance: Array, slip: Array) -> tuple[Array, Array]:
        """R = 0."""
        return np.zeros_like(resistance), np.zeros_like(resistance)

    def slip_to(self, resistance: Array, target: Array) -> Array:
        """Zero."""
        return np.zeros_like(resistance)

    def bond_energy(self, resistance: Array) -> Array:
        """None."""
        return np.zeros_like(resistance)
