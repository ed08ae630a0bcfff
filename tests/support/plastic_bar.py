"""A bar of two plastic parts with a bond, in uniaxial stress: hardens, then debonds and unloads."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from scipy.optimize import brentq

import vmdg

E, NU, SIGMA, H = 4000.0, 0.3, 60.0, 200.0
BAR = vmdg.J2(E, NU, SIGMA, hardening=H)
BOND = vmdg.Debonding(strength=70.0, critical_gap=0.5)
LENGTH = 2.0
#: Elongations: loading, flow, debonding with elastic unloading, unloading and reloading [mm].
LOADS = [0.01, 0.02, 0.05, 0.1, 0.11, 0.2, 0.4, 0.55, 0.549, 0.57]


def series(loads: Sequence[float], small: bool) -> Iterator[float]:
    """Nominal stress P of the bar in series with its bond at these elongations.

    The bar: P l = E (ln l - eps_p) with Hencky's energy, E (l - 1 - eps_p) at small strain; it
    flows at SIGMA + H eps_p. The bond: P = T_c (1 - zeta/zeta_c) once it fails.
    """

    def elastic(elongation: float, plastic: float) -> float:
        """P of the bar without further flow."""
        if small:
            return E * (elongation / LENGTH - plastic)
        x = np.log1p(elongation / LENGTH)
        return E * (x - plastic) * np.exp(-x)

    def flowing(plastic: float) -> tuple[float, float]:
        """P and elongation of the bar that flows."""
        stress = SIGMA + H * plastic
        x = plastic + stress / E
        return (stress, LENGTH * x) if small else (stress * np.exp(-x), LENGTH * np.expm1(x))

    def root(function: Callable[[float], float], low: float, high: float) -> float:
        return brentq(function, low, high, xtol=1e-15)

    T, slope = BOND.strength, BOND.strength / BOND.critical_gap
    onset = root(lambda p: flowing(p)[0] - T, 0.0, 0.1)
    plastic = gap = 0.0
    for u in loads:
        P = elastic(u - gap, plastic)
        if P > flowing(plastic)[0] and gap == 0.0:
            further = u < flowing(onset)[1]
            plastic = root(lambda p, u=u: flowing(p)[1] - u, 0.0, onset) if further else onset
            P = elastic(u, plastic)
        if P > T - slope * gap:
            known = u, plastic
            gap = root(
                lambda g, k=known: T - slope * g - elastic(k[0] - g, k[1]), gap, BOND.critical_gap
            )
            P = T - slope * gap
        yield P
