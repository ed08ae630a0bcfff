"""The two plates of the tearing demo: Table 3 of the report, and what to show of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import vmdg

WIDTH, HEIGHT, PRECRACK = 1.62, 1.35, 0.405  # mm; HEIGHT of the soft plate
MESHES = {"coarse": 1, "medium": 2, "fine": 4}  # times 24 x 20 under 24 x 10 quadrilaterals
STIFF = vmdg.NeoHookean(E=16000.0, nu=0.44)
C, KAPPA = (6.3, 0.012, -0.010), 4000.0 / (3 * (1 - 2 * 0.44))  # MPa


@dataclass(frozen=True)
class Case:
    """A soft plate and what to show of it, at which strains."""

    soft: vmdg.Material
    strength: float  # MPa
    volumetric: str
    contours: tuple[float, ...]
    profiles: tuple[float, ...]
    limits: tuple[float, float]  # of the colours, MPa
    stages: tuple[tuple[float, float], ...]  # end of a stage, its share of --steps

    def strains(self, steps: int) -> NDArray[np.float64]:
        """Load factors: the stages in even steps, and every strain that is shown."""
        parts, start = [self.contours, self.profiles], 0.0
        for end, share in self.stages:
            parts.append(np.linspace(start, end, round(share * steps) + 1)[1:])
            start = end
        return np.unique(np.concatenate(parts).round(9))


CASES = {
    "neo-hookean": Case(
        vmdg.NeoHookean(E=4000.0, nu=0.44), 200.0, "pointwise",
        (0.04, 0.10, 0.14, 0.147), (0.026, 0.10, 0.14), (0, 250),
        ((0.05, 1.0), (0.145, 0.76), (0.15, 0.4)),
    ),
    "ogden": Case(
        vmdg.Ogden(c=C, m=(1.3, 5.0, -2.0), kappa=KAPPA), 20.0, "mean",
        (0.04, 0.10, 0.16, 0.19), (0.04, 0.10, 0.19), (0, 6),
        ((0.19, 0.76),),
    ),
}  # fmt: skip
