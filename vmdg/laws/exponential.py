"""Exponential softening, from a rigid bond and from an elastic one."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from .base import (
    Array,
    Law,
    Mode,
    Parameter,
    Update,
    add_to_diagonal,
    check_parameters,
    dot,
    is_number,
    outer,
)
from .extrinsic import RadialLaw
from .roots import increasing_root

#: g with exp(-g) = 0 in floating point, and the smallest argument of a logarithm.
_GONE, _TINY = 800.0, float(np.finfo(float).tiny)


@dataclass(frozen=True)
class ExponentialDebonding(RadialLaw):
    """Rigid bond with exponential softening, contact, friction and rate dependence.

    R(kappa) = P_c exp(-kappa P_c/G_c), with kappa the accumulated length of the inelastic gap; the
    area under the curve is G_c. Otherwise as `Debonding`; dgamma is the root of |T_tr| - r dgamma =
    R + V, R = R_n exp(-dgamma P_c/G_c), V = eta dgamma R_n/P_c. The bond is broken (Q = P_c) when
    R/P_c falls to round-off.

    Attributes:
        strength: P_c, MPa.
        fracture_energy: G_c, N/mm.
        friction: Coulomb coefficient mu.
        viscosity: MPa s/mm.
        unloading, gradual_friction: as in `Debonding`.

    Raises:
        ValueError: a parameter is out of range.
    """

    strength: Parameter
    fracture_energy: Parameter
    friction: Parameter = 0.0
    viscosity: float = 0.0
    unloading: str = field(default="plastic", kw_only=True)
    gradual_friction: bool | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def gap_scale(self) -> float:
        """G_c/P_c, mm: the gap over which R falls by a factor e."""
        return self.fracture_energy / self.strength

    @property
    def softening_modulus(self) -> float:
        """H = P_c^2/G_c, MPa/mm: the slope at first yield, the steepest."""
        return self.strength / self.gap_scale

    def slip(self, load: Array, resistance: Array, stiffness: Array) -> Array:
        """Root x of stiffness x + R_n (exp(-x/scale) - 1) = load - R_n (left-hand side convex,
        increasing)."""
        excess = load - resistance

        def imbalance(x: Array) -> tuple[Array, Array]:
            decay = np.expm1(-x / self.gap_scale)
            slope = stiffness - resistance / self.gap_scale * (1.0 + decay)
            return stiffness * x + resistance * decay - excess, slope

        free = load / stiffness
        return increasing_root(imbalance, excess / stiffness, free, start=free)

    def soften(self, resistance: Array, slip: Array) -> tuple[Array, Array]:
        """R(x) = R_n exp(-x/scale)."""
        left = resistance * np.exp(-slip / self.gap_scale)
        return left, -left / self.gap_scale

    def slip_to(self, resistance: Array, target: Array) -> Array:
        """x = scale ln(R_n/R), infinite for R = 0."""
        target = np.maximum(target, 0.0)
        softens, some = resistance > target, target > 0.0
        fall = np.divide(resistance, target, out=np.ones_like(target), where=softens & some)
        return np.where(softens & ~some, np.inf, self.gap_scale * np.log(fall))

    def bond_energy(self, resistance: Array) -> Array:
        """R scale, N/mm."""
        return resistance * self.gap_scale

    def damage(self, extent: Array) -> Array:
        """1 - exp(-g), accurate also where it is small."""
        return -np.expm1(-extent)

    def extent(self, damage: Array) -> Array:
        """g = -ln(1 - damage); for a broken bond one at which R underflows."""
        left = damage < 1.0
        return np.where(left, -np.log1p(-np.where(left, damage, 0.0)), _GONE)


@dataclass(frozen=True)
class IntrinsicExponential(Law):
    """Exponential law with an elastic branch, as in intrinsic cohesive elements: all opening is
    zeta.

    T = K (1 - d) zeta with K = G_c/delta_0^2, delta_0 = G_c/(e strength), and d the largest value
    so far of 1 - exp(-delta/delta_0), delta^2 = zeta_N^2 + beta^2 |zeta_T|^2. In pure opening the
    peak is `strength` at delta_0 and the area G_c; in pure shear they are strength/beta and
    G_c/beta^2. Unloading goes to the origin. Contact instead of penetration: zeta_N >= 0, with T_N
    <= 0 free where zeta_N = 0; no friction.

    Viscosity resists the growth of damage: with y = delta/delta_0, y_n the y of d_n and eta =
    viscosity/dt, T has the additional part V = eta (1 - d_n) (1 - y_n/y) zeta while y > y_n, which
    vanishes with the bond.

    With b = T_tr + r zeta_n (without its normal part in contact, b.N < 0) zeta_{n+1} is parallel to
    b, and one equation is left:

        r y + K exp(-y) y + eta (1 - d_n) (y - y_n) = delta(b)/delta_0.

    K exp(-y) y falls by H = K/e^2 = strength^2/G_c at most (the inflection at y = 2), which is
    `softening_modulus`. So the left-hand side increases for all y if r > H, whatever the viscosity.

    The history Q = strength d (MPa) corresponds to P_c - R of the other laws. `Update.damage_work`
    is the dissipation, the integral of K |zeta|^2/2 over d by the mean of |zeta|^2/delta^2 at both
    ends of the step; the rest of T . dzeta is recoverable: `stored_energy`.

    Attributes:
        strength: peak traction in pure opening, MPa.
        fracture_energy: G_c in pure opening, N/mm.
        shear_weight: beta.
        viscosity: MPa s/mm.

    Raises:
        ValueError: a parameter is out of range.
    """

    strength: Parameter
    fracture_energy: Parameter
    shear_weight: Parameter = 2.0
    viscosity: float = 0.0

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def gap_scale(self) -> float:
        """delta_0 = G_c/(e strength), mm: opening at the peak."""
        return self.fracture_energy / (math.e * self.strength)

    @property
    def stiffness(self) -> float:
        """K = G_c/delta_0^2, MPa/mm, of the undamaged bond."""
        return self.fracture_energy / (self.gap_scale * self.gap_scale)

    @property
    def softening_modulus(self) -> float:
        """K/e^2 = strength^2/G_c, MPa/mm: the steepest descent, at delta = 2 delta_0."""
        return self.stiffness / math.e**2

    @property
    def unloads_to_origin(self) -> bool:
        """Always."""
        return True

    @property
    def symmetric(self) -> bool:
        """Only with equal weights: otherwise T has no potential in zeta while damage grows."""
        return is_number(self.shear_weight, 1.0)

    def stored_energy(self, gap: Array, normal: Array, softening: Array) -> Array:
        """K (1 - d) |zeta|^2/2 (n,), N/mm."""
        return 0.5 * self.stiffness * self._integrity(softening) * dot(gap, gap)

    def _advance(
        self,
        trial: Array,
        normal: Array,
        gap: Array,
        softening: Array,
        penalty: Array,
        eta: float | Array,
    ) -> Update:
        """Solve T_tr - r (zeta - zeta_n) = T(zeta)."""
        r, stiffness, scale = penalty, self.stiffness, self.gap_scale

        b = trial + r[:, None] * gap
        b_n = dot(b, normal)
        pressed = b_n < 0.0
        contact = np.minimum(b_n, 0.0)[:, None] * normal
        b = b - contact
        b_n = np.maximum(b_n, 0.0)
        # Half the derivative of delta(b)^2
        weighted = self._weighted(b, normal)
        delta_b = np.sqrt(dot(b, weighted))

        integrity_n = self._integrity(softening)
        load = delta_b / scale
        y = load / (r + stiffness * integrity_n)
        # exp(-y) < 1 - d_n, written without round-off at the first small openings
        growing = -np.expm1(-y) > softening / self.strength
        rows = np.flatnonzero(growing)
        part = self.at(rows)
        y_n = part._opening_of(integrity_n[rows])
        damping = (eta * integrity_n)[rows]
        y[rows] = part._grown_opening(load[rows], r[rows], y_n, damping)
        decay = np.exp(-y[rows])
        integrity = integrity_n.copy()
        integrity[rows] = np.minimum(decay, integrity_n[rows])
        # V relative to zeta
        rated = damping * (1.0 - y_n / y[rows])

        bonded = stiffness * integrity
        bonded[rows] += rated
        secant = r + bonded
        new_gap = b / secant[:, None]
        update = Update.elastic(trial, new_gap, softening)
        update.traction[:] = contact + bonded[:, None] * new_gap
        update.softening[rows] = np.maximum(softening[rows], -part.strength * np.expm1(-y[rows]))
        step = new_gap[rows] - gap[rows]
        update.multiplier[rows] = np.sqrt(dot(step, step))

        # d zeta/d b = I/secant - b (x) d(secant)/secant^2; in contact only the tangential part of b
        # counts
        add_to_diagonal(update.tangent, 1.0 / secant)
        held = normal[pressed]
        update.tangent[pressed] -= outer(held / secant[pressed, None], held)
        elastic, scale = part.stiffness * decay, part.gap_scale
        steepening = elastic - damping * y_n / y[rows] ** 2
        slope = r[rows] + damping + elastic * (1.0 - y[rows])
        growth = steepening / (scale * secant[rows] ** 2 * slope * delta_b[rows])
        update.tangent[rows] += outer(growth[:, None] * b[rows], weighted[rows])

        update.mode[rows] = np.where(pressed[rows], Mode.SHEAR, Mode.TENSION)
        update.mode[(integrity_n == 0.0) & ~pressed] = Mode.OPEN
        # |zeta| = ray delta along the ray of b
        ray2 = dot(b[rows], b[rows]) / delta_b[rows] ** 2
        spent = part._undissipated(integrity_n[rows]) - part._undissipated(integrity[rows])
        ray2_n = part._squared_ray(gap[rows], normal[rows], otherwise=ray2)
        update.damage_work[rows] = np.maximum((ray2_n + ray2) / 2 * spent, 0.0)
        by_y = (ray2_n + ray2) / 2 * part.fracture_energy * decay * y[rows] ** 2 / 2
        # ray2 counts twice where there was no gap
        by_ray2 = np.where(gap[rows].any(axis=1), 0.5, 1.0) * spent
        turned = b[rows] - ray2[:, None] * weighted[rows]
        assert update.overstress is not None and update.work_gradient is not None
        update.work_gradient[rows] = (by_y / (scale * slope * delta_b[rows]))[:, None] * weighted[
            rows
        ]
        update.work_gradient[rows] += (2.0 * by_ray2 / delta_b[rows] ** 2)[:, None] * turned
        update.overstress[rows] = rated[:, None] * new_gap[rows]
        update.viscous_work[rows] = rated * ray2 * scale * scale * y[rows] * (y[rows] - y_n)
        return update

    def _weighted(self, gap: Array, normal: Array) -> Array:
        """(N (x) N + beta^2 (I - N (x) N)) zeta (n, d)."""
        weight = np.broadcast_to(np.square(self.shear_weight), len(gap))
        return weight[:, None] * gap + ((1.0 - weight) * dot(gap, normal))[:, None] * normal

    def _squared_ray(self, gap: Array, normal: Array, otherwise: Array) -> Array:
        """|zeta|^2/delta^2 (n,); ``otherwise`` where there is no gap."""
        delta2 = dot(gap, self._weighted(gap, normal))
        return np.divide(dot(gap, gap), delta2, out=otherwise.copy(), where=delta2 > 0.0)

    def _integrity(self, softening: Array) -> Array:
        """1 - d = 1 - Q/strength."""
        return np.maximum(1.0 - softening / self.strength, 0.0)

    def _opening_of(self, integrity: Array) -> Array:
        """y with exp(-y) = 1 - d."""
        return -np.log(np.maximum(integrity, _TINY))

    def _grown_opening(self, load: Array, r: Array, y_n: Array, damping: Array) -> Array:
        """Root y of the equation of the class docstring, where damage grows."""
        K, stiffness, load = self.stiffness, r + damping, load + damping * y_n

        def imbalance(y: Array) -> tuple[Array, Array]:
            elastic = K * np.exp(-y)
            return (stiffness + elastic) * y - load, stiffness + elastic * (1.0 - y)

        upper = load / stiffness
        return increasing_root(imbalance, load / (stiffness + K), upper, start=upper)

    def _undissipated(self, integrity: Array) -> Array:
        """Energy still to dissipate in opening, N/mm: G_c (1 - d) (y^2/2 + y + 1), e^-y = 1 - d."""
        y = self._opening_of(integrity)
        return self.fracture_energy * integrity * (0.5 * y * y + y + 1.0)
