"""Linear softening: the law of the report (Boxes 2 and 3), completed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .base import Array, Parameter, check_parameters
from .extrinsic import RadialLaw


@dataclass(frozen=True)
class Debonding(RadialLaw):
    """Debonding with linear softening, contact, friction and rate dependence.

    The gap is zeta, the inelastic part of the opening g = phi_2 - phi_1, as in the report; in
    contact mechanics the gap is g.

    R = P_c - Q with Q = min(Q_n + H dgamma, P_c), H = P_c/zeta_c. The overstress is V = c dgamma,
    c = eta R_n/P_c with eta = viscosity/dt and R_n of the start of the step:

    * tension, T_tr.N >= 0: |T| <= R + V; dgamma = (|T_tr| - R_n)/(r - H + c), or |T_tr|/(r + c)
      where the bond breaks within the step, Q = P_c; then T = V in this step and zero afterwards;
    * contact, T_tr.N < 0: the normal gap closes at T_N = 0, then
      |T_T| <= max(R + V, mu |T_N|), and Q grows in friction too; with gradual_friction |T_T| <= R +
      V + (Q/P_c) mu |T_N|: friction on the broken fraction, in parallel to the bond.

    The equation for dgamma has one continuous, strictly decreasing left-hand side in all branches
    (r > H), whatever the viscosity, so T is continuous in all inputs. A step dissipates (R_n^2 -
    R_{n+1}^2)/(2H) in the bond: P_c zeta_c/2 up to separation, in any number of steps. Friction
    does not depend on the rate.

    With unloading="plastic" unloading is as in plasticity and in the report: T falls at constant
    gap, which closes at zero traction once the crack faces are pressed together; reopening is
    damage from the start. Under cycles of constant amplitude such a bond is damaged in every cycle
    and breaks after a few. unloading="secant" returns to the origin, T = R zeta/kappa below the
    largest gap kappa so far, and cycles below it dissipate nothing; under pressure friction acts on
    the fraction Q/P_c of a point (module `secant`). It is rate independent.

    Strength, critical gap and friction may vary along an interface: arrays with one number per
    facet of `Interface(facets=...)`, or f(x) of the midpoints x (3, n) of facets.

    Attributes:
        strength: P_c, MPa.
        critical_gap: zeta_c, mm, at which the bond is broken.
        friction: Coulomb coefficient mu.
        viscosity: MPa s/mm.
        unloading: "plastic" or "secant".
        gradual_friction: whether friction acts on the broken fraction of a point only, parallel to
            the bond; None means only with "secant", which requires it.

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
        """(68), or load/stiffness where the bond breaks within the step."""
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
