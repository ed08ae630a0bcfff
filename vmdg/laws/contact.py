"""Contact without a bond: an interface that was never bonded, or a pre-existing crack."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .base import Array, Parameter, check_parameters
from .compression import Slide
from .extrinsic import Points, RadialLaw


@dataclass(frozen=True)
class Contact(RadialLaw):
    """Unilateral contact with Coulomb friction: the limit of any other law without its bond.

    T = 0 where the interface is open; in contact T_N <= 0, zeta_N = 0 and |T_T| <= mu |T_N|. At
    rest the tangent does not couple the two sides: constrain both bodies or press them together.

    With slip_distance friction weakens with slip, as on faults: along the path s of the slip
    (Ida 1972, J. Geophys. Res. 77; Andrews 1976, J. Geophys. Res. 81)

        mu(s) = mu_s - (mu_s - mu_d) min(s/D_c, 1).

    It does not recover. `softening` is then s in mm: there is no bond to soften. T is continuous
    where r > (mu_s - mu_d) |T_N|/D_c, which holds on fine meshes; otherwise a point that begins to
    slip falls to mu_d within a step.

    Attributes:
        friction: Coulomb coefficient mu, or the static one mu_s.
        dynamic_friction: mu_d <= mu_s after the slip D_c; None for constant friction.
        slip_distance: D_c, mm; None for constant friction.

    Raises:
        ValueError: a coefficient is out of range, or only one of the last two is given.
    """

    friction: Parameter = 0.0
    dynamic_friction: Parameter = field(default=None, kw_only=True)
    slip_distance: Parameter = field(default=None, kw_only=True)
    strength = 0.0

    def __post_init__(self) -> None:
        check_parameters(self)
        if (self.dynamic_friction is None) != (self.slip_distance is None):
            raise ValueError(
                "Contact: friction that weakens has both dynamic_friction= and slip_distance="
            )
        if self.weakens and self.resolved and np.any(self.dynamic_friction > self.friction):
            raise ValueError(
                f"Contact: dynamic_friction = {self.dynamic_friction} exceeds friction = "
                f"{self.friction}: friction can weaken only"
            )

    @property
    def weakens(self) -> bool:
        """Whether friction weakens with slip."""
        return self.slip_distance is not None

    @property
    def softening_modulus(self) -> float:
        """Zero: nothing softens without pressure."""
        return 0.0

    def coefficient(self, path: Array) -> Array:
        """mu (n,) after the slip path s (n,), mm."""
        if not self.weakens:
            return self.friction + np.zeros_like(path)
        lost = self.friction - self.dynamic_friction
        return self.friction - lost * np.minimum(path / self.slip_distance, 1.0)

    def rubbing(self, softening: Array) -> Array:
        """mu relative to that at first."""
        if not self.weakens:
            return super().rubbing(softening)
        most = np.where(np.greater(self.friction, 0.0), self.friction, 1.0)
        return self.coefficient(softening) / most

    def _softened(self, at: Points, left: Array, lost: Array) -> Array:
        return at.softening + lost if self.weakens else super()._softened(at, left, lost)

    def _slide(self, at: Points, left: Array, pressure: Array) -> Slide:
        """|T_tr,T| - r x = mu(s_n + x) |T_N|: x on the falling branch, or beyond D_c."""
        if not self.weakens:
            return super()._slide(at, left, pressure)
        s, D = at.softening, self.slip_distance
        cap = self.coefficient(s) * pressure
        slipping = (at.shear > cap) | (cap == 0.0)
        descent = np.where(s < D, (self.friction - self.dynamic_friction) / D * pressure, 0.0)
        stiffness = np.where(at.penalty > descent, at.penalty - descent, at.penalty)
        slip = (at.shear - cap) / stiffness
        past = (at.penalty <= descent) | (s + slip >= D)
        slip = np.where(past, (at.shear - self.dynamic_friction * pressure) / at.penalty, slip)
        slip, stiffness = np.where(slipping, slip, 0.0), np.where(past, at.penalty, stiffness)
        mu, zero = self.coefficient(s + slip), np.zeros_like(slip)
        most = np.where(np.greater(self.friction, 0.0), self.friction, 1.0)
        return Slide(
            slip=slip,
            traction=np.where(slipping, mu * pressure, at.shear),
            resistance=zero,
            overstress=zero,
            left=zero,
            lost=slip,
            slope=slipping / stiffness,
            cap_slope=-(slipping * mu) / most / stiffness,
            slipping=slipping,
            by_friction=slipping,
            damage_work=zero,
            friction_work=pressure * (self._impulse(s + slip) - self._impulse(s)),
            viscous_work=zero,
        )

    def _impulse(self, path: Array) -> Array:
        """Integral of mu over the slip path, mm."""
        weak = np.minimum(path, self.slip_distance)
        lost = self.friction - self.dynamic_friction
        return self.dynamic_friction * path + lost * weak * (1.0 - weak / self.slip_distance / 2)

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
