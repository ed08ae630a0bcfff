"""Laws of an interface that is rigid until its strength is reached."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import secant
from .base import Array, Law, Mode, Update, add_to_diagonal, dot, outer, unit
from .compression import (
    Closure,
    Slide,
    SofteningCurve,
    close,
    closes,
    give,
    slide,
    slide_gradually,
)


class Points(NamedTuple):
    """Points of one branch; `rows` are their positions in the `Update`."""

    rows: NDArray[np.intp]
    trial: Array  #: T_tr (m, d)
    normal: Array  #: N (m, d)
    trial_n: Array  #: T_tr.N (m,)
    shear: Array  #: |T_tr,T| (m,)
    gap: Array  #: zeta_n (m, d)
    softening: Array  #: Q_n (m,)
    left: Array  #: max(strength - Q_n, 0) (m,), which determines R_n
    penalty: Array  #: r (m,)
    damping: Array  #: V/dgamma of the bond at the start (m,), MPa/mm


class ExtrinsicLaw(Law):
    """Elastic domain (33): T_eq(T) <= R = strength - Q, T_eq the equivalent traction of the law.

    T_tr.N >= 0: `_open`, the law's own return. T_tr.N < 0: the normal gap closes, then the shear
    curve `in_shear` acts with friction (module `compression`). Both agree at T_tr.N = 0, so T is
    continuous across the switch. With unloading="secant" module `secant` replaces both.

    The overstress is V = eta dgamma R_n/P_c, eta = viscosity/dt, parallel to the bond and along its
    flow. R_n is that of the start of the step, so that r + eta R_n/P_c replaces r, with first-order
    accuracy like backward Euler.
    """

    unloading: str = "plastic"  #: or "secant": unloading of the gap
    gradual_friction: bool | None = None  #: whether friction acts on the broken fraction only

    @property
    @abstractmethod
    def in_opening(self) -> SofteningCurve:
        """Softening curve in pure opening."""

    @property
    @abstractmethod
    def in_shear(self) -> SofteningCurve:
        """Softening curve in pure shear; its `strength` is reached at T_eq = `self.strength`."""

    @abstractmethod
    def equivalent(self, normal: Array, shear: Array) -> Array:
        """T_eq (n,), MPa; it is T_N in pure tension.

        Args:
            normal: T_N >= 0 (n,), MPa.
            shear: |T_T| (n,), MPa.
        """

    def utilization(self, normal: Array, shear: Array) -> Array:
        """T_eq/P_c."""
        return self.equivalent(np.maximum(normal, 0.0), shear) / self.strength

    @abstractmethod
    def first_step(self, normal: Array, shear: Array, penalty: Array) -> Array:
        """g (n,) of module `secant` after the first step of an intact bond, beyond its strength.

        Args:
            normal: T_tr.N >= 0 (n,), MPa.
            shear: |T_tr,T| (n,), MPa.
            penalty: r (n,), MPa/mm.
        """

    def flow_factor(self, cos: Array, sin: Array) -> tuple[Array, Array]:
        """m of a criterion and dm/dth; 1 and 0 where the energy does not depend on the mode.

        Args:
            cos, sin: of th (n,).
        """
        return np.ones_like(cos), np.zeros_like(cos)

    def with_factor(self, g: Array, m: Array) -> Array:
        """The g' of s(g')/(g' m) = s(g)/g: from the history to the gap at the mode of m.

        Args:
            g: (n,).
            m: (n,).
        """
        return g

    @property
    def unloads_to_origin(self) -> bool:
        """With secant unloading."""
        return self.unloading == "secant"

    def stored_energy(self, gap: Array, normal: Array, softening: Array) -> Array:
        """As in `secant`; zero with plastic unloading."""
        if self.unloading == "plastic":
            return super().stored_energy(gap, normal, softening)
        return secant.stored_energy(self, gap, normal, softening)

    def rubbing(self, softening: Array) -> Array:
        """The lost fraction of the shear strength, if friction is gradual."""
        if self.unloading == "secant":
            return secant.rubbing(self, softening)
        if self.gradual_friction:
            left = np.maximum(self.strength - softening, 0.0)
            return 1.0 - self.in_opening.resistance(left) / self.strength
        return super().rubbing(softening)

    @abstractmethod
    def _open(self, update: Update, at: Points) -> None:
        """Write the return of points with T_tr.N >= 0, T_eq >= R_n into the rows of `update`."""

    def _advance(
        self,
        trial: Array,
        normal: Array,
        gap: Array,
        softening: Array,
        penalty: Array,
        eta: float | Array,
    ) -> Update:
        """Boxes 2 and 3, completed.

        A point yields where (67) is positive, so that (55) holds at the end.
        """
        if self.unloading == "secant":
            return secant.advance(self, trial, normal, gap, softening, penalty)
        update = Update.elastic(trial, gap, softening)

        trial_n = dot(trial, normal)
        tangential = trial - trial_n[:, None] * normal
        shear = np.sqrt(dot(tangential, tangential))
        left = np.maximum(self.strength - softening, 0.0)
        resistance = self.in_opening.resistance(left)
        damping = eta * (resistance / self.strength) if self.viscosity else np.zeros_like(left)
        # A point without bond yields even at zero traction; its tangent is not the bonded one.
        yielding = self.equivalent(np.maximum(trial_n, 0.0), shear) > resistance
        yielding |= resistance == 0.0
        pressed = trial_n < 0.0
        closing = pressed & (dot(gap, normal) > 0.0)

        for branch, mask in (
            (type(self)._open, yielding & ~pressed),
            (type(self)._pressed, (yielding & pressed) | closing),
        ):
            rows = np.flatnonzero(mask)
            if rows.size:
                everywhere = (trial, normal, trial_n, shear, gap, softening, left, penalty, damping)
                points = Points(rows, *(array[rows] for array in everywhere))
                branch(self.at(rows), update, points)
        return update

    def _softened(self, at: Points, left: Array, lost: Array) -> Array:
        """Q_{n+1} = Q_n + lost, (54), MPa; exactly the strength for a broken bond."""
        return np.where(left > 0.0, np.minimum(at.softening + lost, self.strength), self.strength)

    def _pressed(self, update: Update, at: Points) -> None:
        """Closing, then bond or friction in shear, (81): points with T_tr.N < 0."""
        bond = self.in_shear
        ratio = 1.0 if bond is self else bond.strength / self.strength
        closure = close(at.trial_n, dot(at.gap, at.normal), at.penalty)
        sliding = self._slide(at, ratio * at.left, -closure.traction)

        direction = unit(at.trial - at.trial_n[:, None] * at.normal, at.shear)

        rows = at.rows
        update.traction[rows] = (
            closure.traction[:, None] * at.normal + sliding.traction[:, None] * direction
        )
        update.gap[rows] = (
            at.gap - closure.length[:, None] * at.normal + sliding.slip[:, None] * direction
        )
        update.softening[rows] = self._softened(at, sliding.left, sliding.lost / ratio)
        update.multiplier[rows] = sliding.slip
        update.tangent[rows] = self._pressed_tangent(at, closure, sliding, direction)
        mode = np.where(sliding.slipping, Mode.SHEAR, Mode.ELASTIC)
        mode = np.where(sliding.by_friction, Mode.FRICTION, mode)
        load = np.maximum(-at.trial_n, self.strength)
        closing = closes(closure.length, at.gap, at.penalty, load)
        update.mode[rows] = np.where(closing, Mode.CLOSING, mode)
        update.damage_work[rows] = sliding.damage_work
        assert update.overstress is not None and update.work_gradient is not None
        update.work_gradient[rows] = sliding.resistance[:, None] * self._slip_gradient(
            at, closure, sliding, direction
        )
        update.friction_work[rows] = sliding.friction_work
        update.viscous_work[rows] = sliding.viscous_work
        update.overstress[rows] = sliding.overstress[:, None] * direction

    def _slide(self, at: Points, left: Array, pressure: Array) -> Slide:
        """Shear part of points under a pressure (m,), with the remaining shear strength `left`."""
        resisted = slide_gradually if self.gradual_friction else slide
        cap = self.friction * pressure
        return resisted(self.in_shear, at.shear, cap, left, at.penalty, at.damping)

    def _pressed_tangent(
        self, at: Points, closure: Closure, sliding: Slide, direction: Array
    ) -> Array:
        """(91) for any slope of dgamma, with the sign of its second term corrected.

        q (I - N (x) N - t (x) t) + slope t (x) t + v (x) N, with t the `direction` of slip,
        q = dgamma/|T_tr,T| and v = d zeta/d T_tr.N: mu t/r in friction, N/r while the gap closes.
        """
        q = _per_load(sliding.slip, at.shear, sliding.slope)
        tangent = outer(direction, self._slip_gradient(at, closure, sliding, direction))
        tangent -= outer(q[:, None] * direction, direction)
        # a closed gap does not depend on T_tr.N
        closing = closure.still_open / at.penalty
        tangent += outer((closing - q)[:, None] * at.normal, at.normal)
        add_to_diagonal(tangent, q)
        return tangent

    def _slip_gradient(
        self, at: Points, closure: Closure, sliding: Slide, direction: Array
    ) -> Array:
        """d dgamma/d T_tr (m, d), mm/MPa."""
        # T_N does not depend on T_tr.N while the gap is open.
        cap_by_trial = np.where(closure.still_open, 0.0, -self.friction)
        gradient = sliding.slope[:, None] * direction
        return gradient + (sliding.cap_slope * cap_by_trial)[:, None] * at.normal


class RadialLaw(ExtrinsicLaw, SofteningCurve):
    """Law with one softening curve R(x) for all directions: |T| <= R, flow along T (53).

    A new law of this kind is a frozen dataclass with ``strength`` among its fields. It supplies the
    property ``softening_modulus`` and four methods of :class:`SofteningCurve`: ``slip``,
    ``soften``, ``slip_to`` and ``bond_energy``; if R has a plateau, ``resistance`` and
    ``remaining`` too.
    """

    @property
    def in_shear(self) -> SofteningCurve:
        """The law itself: its curve does not depend on the direction."""
        return self

    @property
    def in_opening(self) -> SofteningCurve:
        """The law itself."""
        return self

    def first_step(self, normal: Array, shear: Array, penalty: Array) -> Array:
        """The root of (64)."""
        load = self.equivalent(normal, shear)
        return self.slip(load, np.full_like(load, self.strength), penalty) / self._scale

    def equivalent(self, normal: Array, shear: Array) -> Array:
        """T_eq = |T|, so that the yield function is (56)."""
        return np.sqrt(normal * normal + shear * shear)

    def _open(self, update: Update, at: Points) -> None:
        """Box 2, (66)-(71): dgamma is the root of |T_tr| - r dgamma = R + V, V of `give`.

        The tangent is (90) for any slope of R: there slope = 1/(r - H) and per_load = slope (1 -
        R_n/|T_tr|).
        """
        load = self.equivalent(at.trial_n, at.shear)
        dgamma, R, V, slope = give(self, load, at.left, at.penalty, at.damping)
        left = self.remaining(at.left, dgamma)
        per_load = _per_load(dgamma, load, slope)
        n = unit(at.trial, load)

        rows = at.rows
        update.traction[rows] = (R + V)[:, None] * n
        update.gap[rows] = at.gap + dgamma[:, None] * n
        update.softening[rows] = self._softened(at, left, at.left - left)
        update.multiplier[rows] = dgamma
        tangent = outer((slope - per_load)[:, None] * n, n)
        add_to_diagonal(tangent, per_load)
        update.tangent[rows] = tangent
        update.mode[rows] = np.where(
            update.softening[rows] < self.strength, Mode.TENSION, Mode.OPEN
        )
        update.damage_work[rows] = self.bond_energy(at.left) - self.bond_energy(left)
        assert update.overstress is not None and update.work_gradient is not None
        update.work_gradient[rows] = (R * slope)[:, None] * n
        update.viscous_work[rows] = V * dgamma
        update.overstress[rows] = V[:, None] * n


def _per_load(slip: Array, load: Array, slope: Array) -> Array:
    """slip/load, and its limit where there is no load."""
    return np.where(load > 0.0, slip / np.where(load > 0.0, load, 1.0), slope)
