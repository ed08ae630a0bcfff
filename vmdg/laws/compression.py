"""Softening curves, and points under compression, for laws that start from a bonded interface.

Compression has two mechanisms in this order: the normal inelastic gap closes at zero normal
traction, then shear is resisted by the larger of bond and friction (Box 3 of the report, completed:
see `slide`), or by the bond and friction on its broken fraction (`slide_gradually`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .base import Array, dot
from .roots import increasing_root

#: A closure below this, relative to the load over r and to the gap, is round-off of a closed gap.
ROUND_OFF = 1e-12


class SofteningCurve(ABC):
    """Resistance R (MPa) of a bond as a function of the gap increment x (mm) of a step.

    The remaining strength is strength - Q_n. It equals R_n, unless R has a plateau; then
    `resistance` and `remaining` relate the two.
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
        """strength - Q after the gap increment x (m,), MPa.

        Args:
            left: strength - Q_n (m,), MPa.
            slip: x (m,), mm.
        """
        return self.soften(left, slip)[0]

    @abstractmethod
    def slip(self, load: Array, left: Array, stiffness: Array) -> Array:
        """Root x (m,), mm, of load - stiffness x = R(x), (64), for any curve.

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
        """Gap increment x, mm, at which R(x) has fallen to a target; 0 where R_n <= target.

        Args:
            left: strength - Q_n (m,), MPa.
            target: R (m,), MPa.
        """

    @abstractmethod
    def bond_energy(self, left: Array) -> Array:
        """Remaining energy of the bond, N/mm: the integral of R(x) up to separation.

        Args:
            left: strength - Q_n (m,), MPa.
        """

    def damage(self, extent: Array) -> Array:
        """History Q/strength of an initially intact bond after the gap g P/H.

        Args:
            extent: g (m,).
        """
        left = self.remaining(np.full_like(extent, self.strength), extent * self._scale)
        return 1.0 - left / self.strength

    def extent(self, damage: Array) -> Array:
        """Inverse of `damage`: g (m,).

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
    """Response of a bond to a load in one step."""

    slip: Array  #: x, mm
    resistance: Array  #: R(x), MPa
    overstress: Array  #: V, MPa
    slope: Array  #: dx/d load, mm/MPa


def give(
    bond: SofteningCurve, load: Array, left: Array, penalty: Array, damping: Array
) -> Yielding:
    """Root x of load - r x = R(x) + V, with the overstress V = damping x.

    The damping is that of the bond at the start of the step, `Law.damping` R_n/P_c. It is constant
    in the step, so that r + damping replaces r, and there is a unique root for r > H whatever the
    viscosity. V grows with x, also where the bond breaks, x = load/(r + damping), and vanishes with
    it in the next step.

    Args:
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
    """Close the normal inelastic gap at zero normal traction, then compress.

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


def closes(length: Array, gap: Array, penalty: Array, load: Array) -> NDArray[np.bool_]:
    """Whether the closure of a normal gap is more than round-off (m,)."""
    return length > ROUND_OFF * (load / penalty + np.sqrt(dot(gap, gap)))


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
    by_friction: NDArray[np.bool_]  #: slipping, and friction resists more
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
    """Shear return (75)-(83): |T_T| = |T_tr,T| - r dgamma equals max(R + V, mu |T_N|), V as in
    `give`.

    Yields along T_tr,T (73), only if f_d = |T_tr,T| - R_n (72) and f_mu = |T_tr,T| - mu |T_N| (74)
    are both positive. The smaller of the roots (80) and (79) is that of the larger resistance. The
    bond softens with x in friction too. Only the bond is rate dependent: sliding under pressure
    tends to mu |T_N| whatever the viscosity.

    The work is the integral of max(R(x) + V, mu |T_N|) over x from 0 to dgamma, with V of the end.
    The integral of R is damage work. The rest is viscous, with V, as long as the bond governs (x <
    x*, R(x*) + V = mu |T_N|), and friction work, with mu |T_N| - R(x), after that.

    Args:
        shear: |T_tr,T| (n,), MPa.
        cap: mu |T_N| (n,), MPa.
        left: strength - Q_n (n,), MPa.
        penalty: r (n,), MPa/mm.
        damping: V/dgamma (n,), MPa/mm, as of `give`.
    """
    # A debonded point without pressure slips freely even at zero load: its tangent is not the
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
    """Shear return with friction on the broken fraction, parallel to the bond: |T_T| <= R + V + d
    mu |T_N|.

    d = 1 - R/P is the lost fraction of the strength (Alfano and Sacco 2006, Int. J. Numer. Meth.
    Engng 68). The slip is the root of |T_tr,T| - r x = R (1 - mu |T_N|/P) + V + mu |T_N|; its
    left-hand side falls faster than for the bond alone, so that r > H is enough. With a linear
    curve and without viscosity it is f/(r - H + H mu |T_N|/P), f = |T_tr,T| - R_n - d_n mu |T_N|,
    until the bond is broken.
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
