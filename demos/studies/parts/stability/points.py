"""A point of an interface between elastic bodies, by hand: implicit steps, or a rate equation.

Nothing here comes from the solver: a point is given by the opening ``way`` that its bodies would
have without stress and by their stiffness, T = K (way - gap), or by any decreasing function of the
gap where only the normal component counts. Components are (normal, shear ..).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import vmdg
from parts.stability.scenes import Array

#: Share of the strength below which a bond does not fail.
ONSET = 1e-9


def resistance(law: vmdg.Law, length: float) -> float:
    """R after a gap of this length, for linear and exponential softening and contact [MPa]."""
    if isinstance(law, vmdg.ExponentialDebonding):
        return law.strength * np.exp(-length * law.strength / law.fracture_energy)
    if isinstance(law, vmdg.Contact):
        return 0.0
    return max(law.strength * (1 - length / law.critical_gap), 0.0)


class Point:
    """A point that starts intact.

    Args:
        law: Debonding, ExponentialDebonding or Contact.
        d: Number of components.

    Attributes:
        gap: zeta (d,) [mm].
        length: Of the way of the gap, or the largest gap with unloading to the origin [mm].
        rubbed: Least and largest work of friction of a point without a bond, by the smaller and the
            larger of the pressures at both ends of every step [N/mm].
    """

    def __init__(self, law: vmdg.Law, d: int):
        self.law, self.gap, self.length = law, np.zeros(d), 0.0
        self.rubbed, self._cap = np.zeros(2), 0.0
        self.plastic = law.unloading == "plastic"

    @property
    def damage(self) -> float:
        """Q/P_c, 0 without a bond."""
        if not self.law.strength:
            return 0.0
        return 1 - resistance(self.law, self.length) / self.law.strength

    def _limit(self, more: float, dt: float) -> float:
        """R + V at the end of a step in which the gap grows by ``more`` [MPa]."""
        overstress = 0.0
        if self.law.viscosity > 0:
            share = resistance(self.law, self.length) / self.law.strength
            overstress = self.law.viscosity * more / dt * share
        return resistance(self.law, self.length + more) + overstress

    def move(self, way: Array, K: Array, dt: float = 1.0) -> Array:
        """Traction (d,) at the end of an implicit step to ``way`` (d,), stiffness ``K`` (d,)."""
        if not self.plastic:
            return self._secant(way, K)
        before, cap = self.gap, self._cap
        traction = self._plastic(way, K, dt)
        self._cap = self.law.friction * max(-traction[0], 0.0)
        slip = np.linalg.norm((self.gap - before)[1:])
        self.rubbed += slip * np.sort([cap, self._cap])
        return traction

    def _plastic(self, way: Array, K: Array, dt: float) -> Array:
        off = way - self.gap
        if off[0] >= 0:
            if np.linalg.norm(K * off) > self._limit(0.0, dt):

                def excess(more: float) -> float:
                    return float(np.linalg.norm(K * off / (self._limit(more, dt) + K * more)) - 1)

                size = float(np.linalg.norm(off))
                more = size
                if self._limit(0.0, dt) > 0 > excess(size):
                    more = brentq(excess, 0.0, size, xtol=1e-16 * size)
                self.gap = self.gap + off * K * more / (self._limit(more, dt) + K * more)
                # What is carried is carried by the bond as it was: T = K (way - gap).
                self.length += more
            return K * (way - self.gap)
        self.gap = np.append(np.clip(way[0], 0.0, self.gap[0]), self.gap[1:])
        pressure = max(K[0] * (self.gap[0] - way[0]), 0.0)
        cap, size = self.law.friction * pressure, float(np.linalg.norm(off[1:]))

        def slides(more: float) -> float:
            return float(K[1] * (size - more)) - max(self._limit(more, dt), cap)

        if size > 0 and slides(0.0) > 0:
            more = brentq(slides, 0.0, size, xtol=1e-16 * size) if slides(size) < 0 else size
            self.gap[1:] += more * off[1:] / size
            self.length += more
        return K * (way - self.gap)

    def _secant(self, way: Array, K: Array) -> Array:
        """T = R(kappa)/kappa zeta below the largest gap kappa; no friction."""
        way, pressed = way.copy(), min(way[0], 0.0)
        way[0] -= pressed

        def excess(kappa: float) -> float:
            return float(np.linalg.norm(K * way / (resistance(self.law, kappa) + K * kappa)) - 1)

        size = float(np.linalg.norm(way))
        if excess(self.length) > 0:
            self.length = brentq(excess, self.length, size, xtol=1e-16 * size)
        R, kappa = resistance(self.law, self.length), self.length
        self.gap = K * kappa * way / (R + K * kappa) if kappa > 0 else 0 * way
        traction = K * (way - self.gap)
        traction[0] += K[0] * pressed
        return traction

    def pull(self, carried: Callable[[float], float], dt: float = 1.0) -> float:
        """Normal traction at the end of an implicit step.

        Args:
            carried: Traction of the bodies at a gap, decreasing.
            dt: Duration of the step.
        """
        start, base = float(self.gap[0]), self.length
        if self.plastic:

            def excess(gap: float) -> float:
                return carried(gap) - self._limit(gap - start, dt)

        else:
            start = base

            def excess(gap: float) -> float:
                return carried(gap) - resistance(self.law, gap)

        free = _free(carried, start)
        # A step ends where the bond begins to fail; from there plastic bodies could relax instead.
        if carried(start) > 0 and excess(start) > ONSET * self.law.strength:
            gap = brentq(excess, start, free, xtol=1e-16 * free) if excess(free) < 0 else free
            self.length = base + gap - start
        elif self.plastic:
            gap = start if carried(start) >= 0 else free
        elif base > 0 and carried(0.0) > 0:
            slope = resistance(self.law, base) / base
            end = _free(carried, base)
            gap = (
                brentq(lambda gap: carried(gap) - slope * gap, 0.0, max(end, base))
                if slope
                else end
            )
        else:
            gap = 0.0
        self.gap = np.append(gap, self.gap[1:])
        return carried(gap)


def _free(carried: Callable[[float], float], start: float) -> float:
    """Gap at which the bodies are free of stress, 0 under pressure."""
    if carried(0.0) <= 0:
        return 0.0
    high = max(start, 1e-300)
    while carried(high) > 0:
        high *= 2
    return brentq(carried, 0.0, high, xtol=1e-16 * high)


def rate_bounds(
    law: vmdg.Law, carried: Callable[[float], Callable[[float], float]], t: Array, late: int
) -> tuple[Array, Array]:
    """Least and largest traction (n,) within ``late`` steps of the rows at ``t``.

    The gap grows by (T/R - 1) P_c/viscosity while the traction T of the bodies exceeds R.

    Args:
        law: With linear softening and viscosity.
        carried: Traction of the bodies at a time, as a function of the gap.
        t: Times of the rows (n,).
        late: Number of steps.
    """

    P, end = law.strength, law.critical_gap
    tractions, length, closed = [0.0], 0.0, 0.0

    def grows(time: float, y: Array) -> list[float]:
        R = max(P * (1 - y[0] / end), 1e-9 * P)
        return [max(carried(time)(y[0] - closed) / R - 1, 0.0) * P / law.viscosity]

    def gone(time: float, y: Array) -> float:
        return 1 - 1e-6 - y[0] / end

    gone.terminal = True
    for start, stop in pairwise(t):
        fine = np.linspace(start, stop, 5)
        lengths = np.full(5, end)
        if length < end:
            done = solve_ivp(
                grows,
                (start, stop),
                [length],
                "LSODA",
                fine,
                events=gone,
                rtol=1e-9,
                atol=1e-12 * end,
            )
            lengths[: len(done.t)] = done.y[0]
            length = lengths[-1]
        for time, x in zip(fine[1:], lengths[1:], strict=True):
            tractions.append(max(carried(time)(x - closed), 0.0) if x < end else 0.0)
        # Closed by bodies that push: the gap shrinks at zero traction, the damage stays.
        closed = length - min(length - closed, _free(carried(stop), length - closed))
    n = 4 * late
    padded = np.pad(np.array(tractions), n, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * n + 1)[::4]
    return windows.min(axis=1), windows.max(axis=1)
