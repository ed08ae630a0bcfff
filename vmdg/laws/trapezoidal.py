"""Softening after a plateau, for ductile adhesives."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .base import Array, Parameter, check_parameters
from .extrinsic import RadialLaw


@dataclass(frozen=True)
class TrapezoidalDebonding(RadialLaw):
    """Rigid bond that yields at its strength before it softens linearly.

    R(kappa) = P_c up to `plateau_gap` zeta_p, then H (zeta_c - kappa), H = P_c/(zeta_c - zeta_p),
    the curve of Tvergaard and Hutchinson (1992, J. Mech. Phys. Solids 40) with a rigid start; kappa
    is the accumulated length of the inelastic gap, or the largest gap with unloading="secant". The
    area under it is P_c (zeta_p + zeta_c)/2. The history is Q = P_c kappa/zeta_c: on the plateau it
    grows at constant R. Otherwise as `Debonding`, the special case zeta_p = 0; gradual friction
    starts only when R falls.

    Attributes:
        strength: P_c, MPa.
        plateau_gap: zeta_p, mm, up to which R is P_c.
        critical_gap: zeta_c, mm, at which the bond is broken.
        friction: Coulomb coefficient mu.
        viscosity: MPa s/mm.
        unloading, gradual_friction: as in `Debonding`.

    Raises:
        ValueError: a parameter is out of range.
    """

    strength: Parameter
    plateau_gap: Parameter
    critical_gap: Parameter
    friction: Parameter = 0.0
    viscosity: float = 0.0
    unloading: str = field(default="plastic", kw_only=True)
    gradual_friction: bool | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        check_parameters(self)
        if self.resolved and not np.all(np.less(self.plateau_gap, self.critical_gap)):
            raise ValueError(
                f"plateau_gap = {self.plateau_gap}: must be less than critical_gap = "
                f"{self.critical_gap}, at which the bond is broken"
            )

    @property
    def softening_modulus(self) -> float:
        """H = P_c/(zeta_c - zeta_p) of the descent, MPa/mm."""
        return self.strength / (self.critical_gap - self.plateau_gap)

    def resistance(self, left: Array) -> Array:
        """min(P_c, H (zeta_c - kappa)), kappa of the history."""
        return np.minimum(self.softening_modulus * self._room(left), self.strength)

    def remaining(self, left: Array, slip: Array) -> Array:
        """P_c - Q = P_c (1 - kappa/zeta_c)."""
        return np.maximum(left - self.strength / self.critical_gap * slip, 0.0)

    def soften(self, left: Array, slip: Array) -> tuple[Array, Array]:
        """R at kappa increased by x."""
        rest = self.remaining(left, slip)
        R = self.resistance(rest)
        falls = (rest > 0.0) & (R < self.strength)
        return R, np.where(falls, -self.softening_modulus, 0.0)

    def slip(self, load: Array, left: Array, stiffness: Array) -> Array:
        """On the plateau, on the descent, or load/stiffness where the bond breaks within the
        step."""
        H, room = self.softening_modulus, self._room(left)
        plateau = np.maximum(room - self.strength / H, 0.0)
        level, free = (load - self.strength) / stiffness, load / stiffness
        descent = (load - H * room) / (stiffness - H)
        holds = (plateau > 0.0) & (level <= plateau)
        return np.where(free >= room, free, np.where(holds, level, descent))

    def slip_to(self, left: Array, target: Array) -> Array:
        """Gap increment to the kappa of R on the descent."""
        reached = self._room(left) - np.maximum(target, 0.0) / self.softening_modulus
        return np.where(self.resistance(left) > target, np.maximum(reached, 0.0), 0.0)

    def bond_energy(self, left: Array) -> Array:
        """R^2/(2H), plus P_c times the rest of the plateau."""
        R, H = self.resistance(left), self.softening_modulus
        plateau = np.maximum(self._room(left) - self.strength / H, 0.0)
        return 0.5 * R * (R / H) + self.strength * plateau

    def extent(self, damage: Array) -> Array:
        """kappa H/P_c, kappa = zeta_c Q/P_c."""
        return self.critical_gap * damage / self._scale

    def _room(self, left: Array) -> Array:
        """zeta_c - kappa, mm."""
        return self.critical_gap * (left / self.strength)
