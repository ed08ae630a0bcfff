"""Fracture energy of a bond at a fixed mode of opening: how opening and shear interact."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .base import Array


@dataclass(frozen=True)
class Criterion(ABC):
    """G_c(phi), phi the shear fraction of the dissipated energy; G_n in opening, G_s in shear.

    With (cos th, sin th) the direction of the traction relative to the strengths, of which
    phi = G_s sin^2 th/(G_n cos^2 th + G_s sin^2 th) follows, the flow of the linear criterion is
    scaled by m = G_c(phi)/(G_n cos^2 th + G_s sin^2 th).
    """

    shear_ratio: float
    exponent: float

    @abstractmethod
    def energy(self, share: Array) -> tuple[Array, Array]:
        """G_c/G_n (n,) and its derivative by phi (n,)."""

    def flow_factor(self, cos: Array, sin: Array) -> tuple[Array, Array]:
        """m (n,) and dm/dth, of th in [0, pi/2] (n,)."""
        k = self.shear_ratio
        linear = cos * cos + k * sin * sin
        share = k * sin * sin / linear
        energy, slope = self.energy(share)
        by_angle = 2.0 * sin * cos * (k * slope / linear - (k - 1.0) * energy) / linear
        return energy / linear, by_angle / linear


class Linear(Criterion):
    """G_I/G_n + G_II/G_s = 1: the m = 1."""

    def energy(self, share: Array) -> tuple[Array, Array]:
        """1/(1 - phi + phi G_n/G_s)."""
        inverse = 1.0 - share + share / self.shear_ratio
        return 1.0 / inverse, (1.0 - 1.0 / self.shear_ratio) / inverse**2

    def flow_factor(self, cos: Array, sin: Array) -> tuple[Array, Array]:
        """1 and 0."""
        return np.ones_like(cos), np.zeros_like(cos)


class PowerLaw(Criterion):
    """(G_I/G_n)^alpha + (G_II/G_s)^alpha = 1 (Wu and Reuter 1965)."""

    def energy(self, share: Array) -> tuple[Array, Array]:
        """(p^alpha + q^alpha)^(-1/alpha), p = 1 - phi, q = phi G_n/G_s."""
        p, q = 1.0 - share, share / self.shear_ratio
        larger = np.maximum(p, q)
        p, q = p / larger, q / larger
        total = p**self.exponent + q**self.exponent
        energy = total ** (-1.0 / self.exponent) / larger
        by_share = p ** (self.exponent - 1.0) - q ** (self.exponent - 1.0) / self.shear_ratio
        return energy, energy * by_share / (total * larger)


class BenzeggaghKenane(Criterion):
    """G_c = G_n + (G_s - G_n) phi^eta (Benzeggagh and Kenane 1996)."""

    def energy(self, share: Array) -> tuple[Array, Array]:
        """1 + (G_s/G_n - 1) phi^eta."""
        more = self.shear_ratio - 1.0
        slope = more * self.exponent * share ** (self.exponent - 1.0)
        return 1.0 + more * share**self.exponent, slope


#: Criteria by name.
CRITERIA: dict[str, Callable[[float, float], Criterion]] = {
    "linear": Linear,
    "power": PowerLaw,
    "BK": BenzeggaghKenane,
}


def criterion_of(name: str, exponent: float | None, shear_ratio: float) -> Criterion:
    if name not in CRITERIA:
        raise ValueError(f"criterion = {name!r}: must be one of {tuple(CRITERIA)}")
    if name == "linear":
        if exponent is not None:
            raise ValueError(
                f'exponent = {exponent}: the linear criterion has none; give criterion="power" or '
                '"BK" with it'
            )
        exponent = 1.0
    elif exponent is None:
        raise ValueError(
            f'exponent is missing: criterion="{name}" requires it; it is fitted to tests at '
            "several mode ratios, for carbon/epoxy 1 to 3"
        )
    if isinstance(exponent, str) or not 1.0 <= exponent < math.inf:
        raise ValueError(
            f"exponent = {exponent!r}: must be at least 1 and finite, or the energy would have an "
            "infinite slope at a pure mode"
        )
    return CRITERIA[name](shear_ratio, float(exponent))
