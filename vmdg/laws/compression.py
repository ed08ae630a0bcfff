"""Softening curves, and points under compression, for laws that start from a bonded interface.

Compression has two mechanisms in this order: the normal residual gap closes at zero normal
traction, then shear meets the stronger of bond and friction (Box 3 of the report, completed: see
`slide`), or the bond and the friction of the share that has parted (`slide_gradually`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .base import Array
from .roots import increasing_root

#: A closure this small against the load over r is what round-off left of a closed gap, no branch.
ROUND_OFF = 1e-12


class SofteningCurve(ABC):
    """Resistance R (MPa) of a bond against the slip x (mm) since the start of a step.

    What is left of the bond is told by strength - Q_n. It is R_n, unless R does not fall all the
    way; then `resistance` and `remaining` say how they belong together.
    """

    strength: float  #: R of the intact bond, MPa

    @property
    @abstractmethod
    def softening_modulus(self) -> float:
        """H, the steepest descent of the curve, MPa/mm."""

    def resistance(self, left: Array) -> Array:
        """R_n (m,), MPa.

        Args:
            left: strength - Q_n (m,), MPa.
        """
        return left

    def remaining(self, left: Array, slip: Array) -> Array:
        """strength - Q after the slip x (m,), MPa.

        Args:
            left: strength - Q_n (m,), MPa.
            slip: x (m,), mm.
        """
        return self.soften(left, slip)[0]

    @abstractmethod
    def slip(self, load: Array, left: Array, stiffness: Array) -> Array:
        """Root x (m,), mm, of load - stiffness x = R(x), (64) for any curve.

        Args:
            load: |T_tr| (m,), MPa, not less than R_n.
            left: strength - Q_n (m,), MPa.
            stiffness: r and damping (m,), MPa/mm, more than H.
        """

    @abstractmethod
    def soften(self, left: Array, slip: Array) -> tuple[Array, Array]:
        """R(x), MPa, and its slope dR/dx, MPa/mm.

        Args:
            left: strength - Q_n (m,), MPa.
            slip: x (m,), mm, since R was R_n.
        """

    @abstractmethod
    def slip_to(self, left: Array, target: Array) -> Array:
        """Slip x, mm, at which R(x) has fallen to a target; 0 where R_n <= target.

        Args:
            left: strength - Q_n (m,), MPa.
            target: R (m,), MPa.
        """

    @abstractmethod
    def bond_energy(self, left: Array) -> Array:
        """Energy left in the bond, N/mm: the integral of R(x) from here to separation.

        Args:
            left: strength - Q_n (m,), MPa.
        """

    def damage(self, extent: Array) -> Array:
        """History Q/strength of an intact bond after the slip g P/H.

        Args:
            extent: g (m,).
        """
        left = self.remaining(np.full_like(extent, self.strength), extent * self._scale)
        return 1.0 - left / self.strength

    def extent(self, damage: Array) -> Array:
        """g (m,) of `damage`.

        Args:
            damage: Q/strength (m,), at most 1.
        """
        whole = np.full_like(damage, self.strength)
        return self.slip_to(whole, self.strength * (1.0 - damage)) / self._scale

    @property
    def _scale(self) -> float:
        """P/H, mm."""
        return self.strength / self.softening_modulus


class Yielding(NamedTuple):
    """What a load does to a bond in one step."""

    slip: Array  #: x, mm
    resistance: Array  #: R(x), MPa
    overstress: Array  #: V, MPa
    slope: Array  #: dx/d load, mm/MPa


def give(
    bond: SofteningCurve, load: Array, left: Array, penalty: Array, damping: Array
) -> Yielding:
    """Root x of load - r x = R(x) + V, with the overstress V = damping x.

    The damping is that of the bond at the start of the step, `Law.damping` R_n/P_c: a number in the
    step, so that r + damping takes the place of r, and there is one root for r > H whatever the
    viscosity. V grows with x, also where the bond is gone, x = load/(r + damping), and ends with it
    in the next step.

    Args:
        bond: softening curve.
        load: trial traction (m,), MPa, not less than R_n.
        left: strength - Q_n (m,), MPa.
        penalty: r (m,), MPa/mm.
        damping: V/x (m,), MPa/mm.
    """
    stiffness = penalty + damping
    slip = bond.slip(load, left, stiffness)
    R, descent = bond.soften(left, slip)
    return Yielding(slip, R, damping * slip, 1.0 / (stiffness + descent))


class Closure(NamedTuple):
    """Normal part of a compressed point."""

    length: Array  #: zeta_N,n - zeta_N,n+1 >= 0, mm
    traction: Array  #: T_N <= 0, MPa
    still_open: NDArray[np.bool_]  #: zeta_N > 0 remains, hence T_N = 0


def close(trial_n: Array, gap_n: Array, penalty: Array) -> Closure:
    """Close the normal residual gap at zero normal traction, then press.

    zeta_N = max(0, zeta_N,n + T_tr.N / r) and T_N = T_tr.N + r (zeta_N,n - zeta_N); for zeta_N = 0
    this is (76).
    """
    needed = -trial_n / penalty
    available = np.maximum(gap_n, 0.0)
    still_open = needed < available
    return Closure(
        length=np.where(still_open, needed, available),
        traction=np.where(still_open, 0.0, np.minimum(trial_n + penalty * available, 0.0)),
        still_open=still_open,
    )


class Slide(NamedTuple):
    """Shear part of a compressed point."""

    slip: Array  #: dgamma, mm
    traction: Array  #: |T_T|, MPa
    resistance: Array  #: R(dgamma), MPa
    overstress: Array  #: V, part of the traction, MPa
    left: Array  #: strength - Q_{n+1} of the bond, MPa
    lost: Array  #: Q_{n+1} - Q_n, MPa
    slope: Array  #: d dgamma / d |T_tr,T|, mm/MPa
    cap_slope: Array  #: d dgamma / d (mu |T_N|), mm/MPa
    slipping: NDArray[np.bool_]
    by_friction: NDArray[np.bool_]  #: slipping, and friction is the stronger
    damage_work: Array
    friction_work: Array
    viscous_work: Array


def slide(
    bond: SofteningCurve,
    shear: Array,
    cap: Array,
    left: Array,
    penalty: Array,
    damping: Array,
) -> Slide:
    """Shear return (75)-(83): |T_T| = |T_tr,T| - r dgamma meets max(R + V, mu |T_N|), V of `give`.

    Yields along T_tr,T (73), only if f_d = |T_tr,T| - R_n (72) and f_mu = |T_tr,T| - mu |T_N| (74)
    are both positive; of the two roots (80) and (79) the smaller is taken, which is the root for
    the larger resistance. The bond wears along x in friction too. Rate dependence belongs to the
    bond: friction is rate independent, so that sliding under pressure settles at mu |T_N| whatever
    the viscosity.

    The work is the integral of max(R(x) + V, mu |T_N|) over x from 0 to dgamma, with V of the end.
    The bond takes the integral of R; of the rest, viscosity takes V as long as the bond holds (x <
    x*, R(x*) + V = mu |T_N|) and friction takes mu |T_N| - R(x) after it.

    Args:
        bond: softening curve in shear.
        shear: |T_tr,T| (n,), MPa.
        cap: mu |T_N| (n,), MPa.
        left: strength - Q_n (n,), MPa.
        penalty: r (n,), MPa/mm.
        damping: V/dgamma (n,), MPa/mm, as of `give`.
    """
    # A debonded point without pressure slips freely even at zero load: its tangent must not be the
    # bonded one.
    R_n = bond.resistance(left)
    slipping = ((shear > R_n) | (R_n == 0.0)) & ((shear > cap) | (cap == 0.0))
    by_bond = give(bond, np.maximum(shear, R_n), left, penalty, damping)
    by_cap = np.maximum(shear - cap, 0.0) / penalty
    by_friction = slipping & (by_cap <= by_bond.slip)
    slip = np.where(slipping, np.minimum(by_bond.slip, by_cap), 0.0)
    R, _ = bond.soften(left, slip)
    V = damping * slip

    held_by_bond = np.where(by_friction, np.clip(bond.slip_to(left, cap - V), 0.0, slip), slip)
    at_hand_over, at_end = bond.remaining(left, held_by_bond), bond.remaining(left, slip)
    after_hand_over = bond.bond_energy(at_hand_over) - bond.bond_energy(at_end)
    return Slide(
        slip=slip,
        traction=np.where(slipping, np.where(by_friction, cap, R + V), shear),
        resistance=R,
        overstress=np.where(by_friction, 0.0, V),
        left=at_end,
        lost=left - at_end,
        slope=slipping * np.where(by_friction, 1.0 / penalty, by_bond.slope),
        cap_slope=-(by_friction / penalty),
        slipping=slipping,
        by_friction=by_friction,
        damage_work=bond.bond_energy(left) - bond.bond_energy(at_end),
        friction_work=np.maximum(cap * (slip - held_by_bond) - after_hand_over, 0.0),
        viscous_work=V * held_by_bond,
    )


def slide_gradually(
    bond: SofteningCurve,
    shear: Array,
    cap: Array,
    left: Array,
    penalty: Array,
    damping: Array,
) -> Slide:
    """Shear return where the parted share rubs beside the bond: |T_T| <= R + V + d mu |T_N|.

    d = 1 - R/P is the share of the strength that is lost (Alfano and Sacco 2006, Int. J. Numer.
    Meth. Engng 68). The slip is the root of |T_tr,T| - r x = R (1 - mu |T_N|/P) + V + mu |T_N|; its
    left-hand side falls faster than for the bond alone, so that r > H is enough. With a linear
    curve and without viscosity it is f/(r - H + H mu |T_N|/P), f = |T_tr,T| - R_n - d_n mu |T_N|,
    until the bond is gone.

    Args:
        bond, shear, cap, left, penalty, damping: As of `slide`.
    """
    part = 1.0 - cap / bond.strength
    R_n = bond.resistance(left)
    held = R_n + (1.0 - R_n / bond.strength) * cap
    slipping = (shear > held) | ((R_n == 0.0) & (cap == 0.0))
    load, stiffness = np.maximum(shear, held), penalty + damping

    def imbalance(x: Array) -> tuple[Array, Array]:
        R, descent = bond.soften(left, x)
        return stiffness * x + part * R + cap - load, stiffness + part * descent

    upper = load / stiffness
    slip = increasing_root(imbalance, np.zeros_like(load), upper, start=np.zeros_like(load))
    slip = np.where(slipping, slip, 0.0)
    R, descent = bond.soften(left, slip)
    V = damping * slip
    slope = slipping / (stiffness + part * descent)
    at_end, rubs = bond.remaining(left, slip), 1.0 - R / bond.strength
    spent = bond.bond_energy(left) - bond.bond_energy(at_end)
    return Slide(
        slip=slip,
        traction=np.where(slipping, R + V + rubs * cap, shear),
        resistance=R,
        overstress=V,
        left=at_end,
        lost=left - at_end,
        slope=slope,
        cap_slope=-rubs * slope,
        slipping=slipping,
        by_friction=slipping & (R == 0.0),
        damage_work=spent,
        friction_work=np.maximum(cap * (slip - spent / bond.strength), 0.0),
        viscous_work=V * slip,
    )
