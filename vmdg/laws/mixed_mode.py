"""Different strengths and energies in opening and shear."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from .base import (
    Array,
    Mode,
    Update,
    add_to_diagonal,
    check_parameters,
    dot,
    outer,
    unit,
)
from .debonding import Debonding
from .extrinsic import ExtrinsicLaw, Points
from .roots import increasing_root


@dataclass(frozen=True)
class MixedModeDebonding(ExtrinsicLaw):
    """Elliptic strength criterion with linear softening, contact, friction and rate dependence.

    Yield (T_N >= 0): sqrt((T_N/P_n)^2 + (|T_T|/P_s)^2) <= rho = 1 - d. With (cos th, sin th) =
    (T_N/P_n, |T_T|/P_s)/rho and critical gaps zeta_n = 2 G_n/P_n, zeta_s = 2 G_s/P_s the flow is

        dzeta = dd (zeta_n cos th N + zeta_s sin th t),  t = T_T/|T_T|.

    Pure opening spends G_n, pure shear G_s. On any path dG_I = 2 G_n rho cos^2 th dd and dG_II = 2
    G_s rho sin^2 th dd are not negative and G_I/G_n + G_II/G_s = 1 at separation: the linear
    interaction criterion, whatever the history of the mixity. At a fixed ratio of tractions the
    energy is `energy_at` th = G_n cos^2 th + G_s sin^2 th. The flow is normal to the yield surface,
    and the tangent symmetric, exactly when G_n = G_s; equal strengths and energies give
    `Debonding`.

    With g = d_{n+1} - d_n, viscosity acts beside the bond, T = T_bond + v (zeta_n cos th N + zeta_s
    sin th t), v = rho min(eta g, p), eta = viscosity/dt, p = (r - H)/2, H = max(H_n, H_s) =
    `softening_modulus`, H_n = P_n/zeta_n, H_s = P_s/zeta_s: the overstress ends with the bond. With
    a = T_tr.N/P_n, b = |T_tr,T|/P_s,

        A = rho_n + (r/H_n - 1) g + v/H_n,  B = rho_n + (r/H_s - 1) g + v/H_s,
        (a/A)^2 + (b/B)^2 = 1

    is one equation for g; cos th = a/A, sin th = b/B. A and B grow with g, by (r + H)/(2 H_n) - 1
    and (r + H)/(2 H_s) - 1 at least, so the root is unique for r > H. In contact the law is
    `Debonding` with P_s, zeta_s and the same p. The history is Q = P_n d (MPa).

    Attributes:
        normal_strength, shear_strength: P_n and P_s, MPa.
        normal_energy, shear_energy: G_n and G_s, N/mm.
        friction: Coulomb coefficient mu.
        viscosity: MPa s/mm.

    Raises:
        ValueError: a parameter is out of range.
    """

    normal_strength: float
    shear_strength: float
    normal_energy: float
    shear_energy: float
    friction: float = 0.0
    viscosity: float = 0.0

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def strength(self) -> float:
        """P_n, MPa."""
        return self.normal_strength

    @cached_property
    def in_opening(self) -> Debonding:
        """The law in pure opening."""
        return Debonding(self.normal_strength, 2.0 * self.normal_energy / self.normal_strength)

    @cached_property
    def in_shear(self) -> Debonding:
        """The law in pure shear."""
        return Debonding(self.shear_strength, 2.0 * self.shear_energy / self.shear_strength)

    @property
    def softening_modulus(self) -> float:
        """max(H_n, H_s), MPa/mm."""
        return max(self.in_opening.softening_modulus, self.in_shear.softening_modulus)

    @property
    def symmetric(self) -> bool:
        """No friction, and flow normal to the yield surface."""
        return self.friction == 0.0 and self.normal_energy == self.shear_energy

    def energy_at(self, mixity: ArrayLike) -> Array:
        """Energy to separation, N/mm.

        Args:
            mixity: th = atan((|T_T|/P_s)/(T_N/P_n)), held fixed, radians.
        """
        mixity = np.asarray(mixity, dtype=float)
        return self.normal_energy * np.cos(mixity) ** 2 + self.shear_energy * np.sin(mixity) ** 2

    def equivalent(self, normal: Array, shear: Array) -> Array:
        """T_eq = sqrt(T_N^2 + (P_n/P_s)^2 |T_T|^2)."""
        weighted = (self.normal_strength / self.shear_strength) * shear
        return np.sqrt(normal * normal + weighted * weighted)

    def _open(self, update: Update, at: Points, eta: float) -> None:
        """The return of the class docstring, for T_tr.N >= 0."""
        rho_n = at.resistance / self.strength
        # dzeta = T_tr/r if the bond fails within the step; d advances by its length in units of the
        # critical gaps.
        opening = at.trial_n / (at.penalty * self.in_opening.critical_gap)
        sliding = at.shear / (at.penalty * self.in_shear.critical_gap)
        # What holds has rho_n > 0, so that A and B are not zero, also where the material of a trial
        # state has no traction (NaN, in a cell turned inside out).
        holds = np.sqrt(opening * opening + sliding * sliding) < rho_n
        gone, left = (Points(*(array[mask] for array in at)) for mask in (~holds, holds))
        if gone.rows.size:
            self._separate(update, gone)
        if left.rows.size:
            self._soften(update, left, eta)

    def _separate(self, update: Update, at: Points) -> None:
        """No bond at the end of the step: dzeta = T_tr/r, T = 0."""
        compliance = 1.0 / at.penalty
        step = compliance[:, None] * at.trial
        # The mixity is that of the moment of failure on the ray of T_tr.
        opening = at.trial_n / self.in_opening.critical_gap
        sliding = at.shear / self.in_shear.critical_gap
        mixity = np.arctan2(sliding, opening)

        rows = at.rows
        update.traction[rows] = 0.0
        update.gap[rows] = at.gap + step
        update.softening[rows] = self.strength
        update.multiplier[rows] = np.sqrt(dot(step, step))
        update.tangent[rows] = compliance[:, None, None] * np.eye(step.shape[1])
        update.mode[rows] = Mode.OPEN
        rho_n = at.resistance / self.strength
        update.damage_work[rows] = rho_n * rho_n * self.energy_at(mixity)

    def _soften(self, update: Update, at: Points, eta: float) -> None:
        """Some bond left at the end of the step."""
        r, p = at.penalty, self._fade(at.penalty)
        h_n, h_s = self.in_opening.softening_modulus, self.in_shear.softening_modulus
        rho_n = at.resistance / self.strength
        a, b = at.trial_n / self.normal_strength, at.shear / self.shear_strength

        def sizes(g: Array) -> tuple[Array, ...]:
            """A and B, and their slopes."""
            bounded = eta * g > p
            share = np.where(bounded, p, eta * g)
            v, v_slope = share * (rho_n - g), np.where(bounded, 0.0, eta * (rho_n - g)) - share
            A = rho_n + (r / h_n - 1.0) * g + v / h_n
            B = rho_n + (r / h_s - 1.0) * g + v / h_s
            return A, B, (r + v_slope) / h_n - 1.0, (r + v_slope) / h_s - 1.0

        def yield_function(g: Array) -> tuple[Array, Array]:
            # 1/|(a/A, b/B)| - 1 is nearly linear in g, where the equation as printed is not
            A, B, slope_a, slope_b = sizes(g)
            cos, sin = a / A, b / B
            inverse = 1.0 / np.sqrt(cos * cos + sin * sin)
            bend = cos * cos * slope_a / A + sin * sin * slope_b / B
            return inverse - 1.0, inverse**3 * bend

        g = increasing_root(yield_function, np.zeros_like(rho_n), rho_n, start=np.zeros_like(rho_n))
        A, B, slope_a, slope_b = sizes(g)
        cos, sin = a / A, b / B
        rho = np.maximum(rho_n - g, 0.0)
        v = rho * np.minimum(eta * g, p)

        # dzeta = (k_n N (x) N + k_t (I - N (x) N)) T_tr
        k_n, k_t = g / (h_n * A), g / (h_s * B)
        trial_normal = at.trial_n[:, None] * at.normal
        trial_shear = at.trial - trial_normal
        direction = unit(trial_shear, at.shear)
        step = k_n[:, None] * trial_normal + k_t[:, None] * trial_shear
        length2 = dot(step, step)

        # d g/d T_tr from the equation, and d(dzeta)/d g
        denominator = cos * cos * slope_a / A + sin * sin * slope_b / B
        g_by_trial = (cos / (A * self.normal_strength))[:, None] * at.normal
        g_by_trial += (sin / (B * self.shear_strength))[:, None] * direction
        g_by_trial /= denominator[:, None]
        # A - g dA/dg = rho_n + (v - g dv/dg)/H_n
        rest = np.where(eta * g > p, p * rho_n, eta * g * g)
        opening_by_g = self.in_opening.critical_gap * cos * (rho_n + rest / h_n) / A
        sliding_by_g = self.in_shear.critical_gap * sin * (rho_n + rest / h_s) / B
        step_by_g = opening_by_g[:, None] * at.normal + sliding_by_g[:, None] * direction

        rows = at.rows
        update.traction[rows] = ((rho + v / h_n) / A)[:, None] * trial_normal + (
            (rho + v / h_s) / B
        )[:, None] * trial_shear
        update.gap[rows] = at.gap + step
        update.softening[rows] = self._softened(at, rho, self.strength * g)
        update.multiplier[rows] = np.sqrt(length2)
        tangent = outer((k_n - k_t)[:, None] * at.normal, at.normal)
        tangent += outer(step_by_g, g_by_trial)
        add_to_diagonal(tangent, k_t)
        update.tangent[rows] = tangent
        update.mode[rows] = np.where(
            update.softening[rows] < self.strength, Mode.TENSION, Mode.OPEN
        )
        spent = (rho_n - rho) * (rho_n + rho)
        update.damage_work[rows] = spent * (
            self.normal_energy * cos * cos + self.shear_energy * sin * sin
        )
        update.viscous_work[rows] = v * length2 / np.where(g > 0.0, g, 1.0)
