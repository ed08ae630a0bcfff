"""Linear softening: the law of the report (Boxes 2 and 3), completed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .base import Array, Parameter, check_parameters
from .extrinsic import RadialLaw


@dataclass(frozen=True)
class Debonding(RadialLaw):
    """Debonding with linear softening, contact, friction and rate dependence.

    The gap is zeta, the inelastic part of the opening g = phi_2 - phi_1, as in the report; what
    contact mechanics calls the gap is g.

    R = P_c - Q with Q = min(Q_n + H dgamma, P_c), H = P_c/zeta_c. The overstress is V = c dgamma,
    c = eta R_n/P_c with eta = viscosity/dt and R_n of the start of the step:

    * tension, T_tr.N >= 0: |T| <= R + V; dgamma = (|T_tr| - R_n)/(r - H + c), or |T_tr|/(r + c)
      where the bond fails on the way, Q = P_c; then T = V in this step and nothing from the next
      one on;
    * contact, T_tr.N < 0: the normal gap closes at T_N = 0, then
      |T_T| <= max(R + V, mu |T_N|), and Q advances in friction too; with gradual_friction
      |T_T| <= R + V + (Q/P_c) mu |T_N|, the share that has parted rubs while the rest holds.

    The equation for dgamma is one continuous, strictly decreasing function in all branches
    (r > H), whatever the viscosity, so T is continuous in all inputs. A step spends (R_n^2 -
    R_{n+1}^2)/(2H) on the bond: P_c zeta_c/2 to separation in any number of steps. Friction does
    not depend on the rate.

    With unloading="plastic" it is like that of plasticity, as in the report: T falls at once, the
    gap stays until the lips are pressed together, closes without traction, and to open it anew is
    damage from the start. So a bond that opens and closes between two openings of constant
    amplitude loses more in every cycle and is gone after a few. unloading="secant" goes back to the
    origin, T = R zeta/kappa below the largest gap kappa so far, and cycles below it cost nothing;
    under pressure the share Q/P_c of a point rubs while the rest holds (module `secant`). It does
    not depend on the rate.

    Strength, critical gap and friction may vary along an interface: arrays, one number for every
    facet of `Interface(facets=...)`, or f(x) of the midpoints x (3, n) of facets.

    Attributes:
        strength: P_c, MPa.
        critical_gap: zeta_c, mm, at which the bond is gone.
        friction: Coulomb coefficient mu.
        viscosity: MPa s/mm.
        unloading: "plastic" or "secant".
        gradual_friction: whether only the share of a point that has parted rubs, beside the bond;
            None is so with "secant" alone, which cannot do otherwise.

    Raises:
        ValueError: a parameter is out of range.
    """

    strength: Parameter
    critical_gap: Parameter
    friction: Parameter = 0.0
    viscosity: float = 0.0
    unloading: str = field(default="plastic", kw_only=True)
    gradual_friction: bool | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def softening_modulus(self) -> float:
        """H = P_c/zeta_c of (58), MPa/mm."""
        return self.strength / self.critical_gap

    def slip(self, load: Array, resistance: Array, stiffness: Array) -> Array:
        """(68), or the free slip load/stiffness where the bond fails on the way."""
        free = load / stiffness
        fails = self.softening_modulus * free >= resistance
        return np.where(fails, free, (load - resistance) / (stiffness - self.softening_modulus))

    def soften(self, resistance: Array, slip: Array) -> tuple[Array, Array]:
        """R(x) = max(R_n - H x, 0), from (70)."""
        left = np.maximum(resistance - self.softening_modulus * slip, 0.0)
        return left, np.where(left > 0.0, -self.softening_modulus, 0.0)

    def slip_to(self, resistance: Array, target: Array) -> Array:
        """x = (R_n - R)/H."""
        return np.maximum(resistance - target, 0.0) / self.softening_modulus

    def bond_energy(self, resistance: Array) -> Array:
        """R^2/(2H), N/mm, written so that tiny strengths do not underflow."""
        return 0.5 * self.critical_gap * resistance * (resistance / self.strength)
