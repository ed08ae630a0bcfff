"""Random properties as functions of position: the same on any number of ranks."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from typing import Any

import numpy as np
from dolfinx.mesh import Mesh
from numpy.typing import ArrayLike, NDArray

from .topology import box_sides

# Origin of the boxes, not a round number: round coordinates would lie on the edge between two boxes
# and be assigned to either by rounding.
_OFFSET = 1 / math.pi

# Step, shifts and multipliers of SplitMix64 (Steele, Lea and Flood 2014, OOPSLA), which turns
# counters into independent random numbers.
_STEP, _MIX, _LAST = 0x9E3779B97F4A7C15, ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)), 31

# Resolution relative to the largest side of the bounding box of a mesh.
_SHARE = 1e-9

# Largest admissible rounding of coordinates relative to the resolution.
_ROUNDING = 1e-3


@dataclass(frozen=True)
class Weibull:
    """A spatially random property, P(X < x) = 1 - exp(-(x/scale)^modulus).

    It is a function f(x) and can be used wherever a parameter may be one, for example for strengths
    and energies of laws, with one value per facet. The value depends on the seed and the midpoint
    alone, not on the ranks, on the order of the facets or on which of them are open. Two properties
    with the same seed and modulus are proportional.

    The values of two facets are independent however small the facets are, so that a finer mesh has
    more weak facets. By weakest-link theory, facets of size A have (A_0/A)^(1/modulus) times the
    scale of facets of size A_0. With ``section`` all points of a section share one value, whatever
    the mesh: a bar, a weld, a strip of adhesive.

    Args:
        scale: Scale of the distribution, in the unit of the property: 63.2 % of all values are
            below.
        modulus: Weibull's modulus; 5 for scattered, 20 for uniform materials.
        seed: Number of the sample.
        resolution: Size of the boxes in which the value is constant [mm]; far below the size of the
            facets, and far above the rounding of coordinates. By default it follows from the size
            of the mesh, so that a sample is the same in any unit of length; required to call f(x)
            without a mesh.
        section: f(x) with the integer number of the section for each of the points x (3, n), for
            example ``lambda x: x[0] // 5.0``. Its borders should lie between the midpoints of
            facets, not on them, where rounding would decide. None for a separate value at every
            point.

    Raises:
        ValueError: scale, modulus or resolution is not positive, or the seed is not an integer.
        TypeError: section is not a function.
    """

    scale: float
    modulus: float
    seed: int = 0
    resolution: float | None = None
    section: Callable[[NDArray[np.float64]], ArrayLike] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for name in ("scale", "modulus", "resolution"):
            value: Any = getattr(self, name)
            if name == "resolution" and value is None:
                continue
            if not (isinstance(value, Real) and 0 < float(value) < math.inf):
                raise ValueError(f"Weibull: {name} = {value!r} must be a positive, finite number")
        if not isinstance(self.seed, Integral) or self.seed < 0:
            raise ValueError(f"Weibull: seed = {self.seed!r} must be an integer, zero or more")
        if self.section is not None and not callable(self.section):
            raise TypeError(
                f"Weibull: section = {self.section!r} must be a function of points x (3, n) that "
                "returns the number of the section of each, for example lambda x: x[0] // 5.0"
            )

    @property
    def mean(self) -> float:
        """scale Gamma(1 + 1/modulus)."""
        return self.scale * math.gamma(1 + 1 / self.modulus)

    @property
    def deviation(self) -> float:
        """Standard deviation."""
        square = math.gamma(1 + 2 / self.modulus) - math.gamma(1 + 1 / self.modulus) ** 2
        return self.scale * math.sqrt(square)

    def on(self, mesh: Mesh) -> Weibull:
        """The same with a resolution from the size of a mesh, unless one is given; collective."""
        found = _SHARE * float(box_sides(mesh).max())
        return replace(self, resolution=found) if self.resolution is None else self

    def __call__(self, x: ArrayLike) -> NDArray[np.float64]:
        """Values at points (n,)."""
        x = np.asarray(x, dtype=float)
        boxes = self._boxes(x) if self.section is None else self._sections(x)
        number = np.full(x.shape[1], self.seed, dtype=np.uint64)
        for position in boxes.view(np.uint64):
            number = _mixed(number + position)
        # in (0, 1), with the 53 digits of a double
        share = ((number >> np.uint64(11)).astype(float) + 0.5) / 2.0**53
        return self.scale * (-np.log1p(-share)) ** (1 / self.modulus)

    def _sections(self, x: NDArray[np.float64]) -> NDArray[np.int64]:
        """Numbers of the sections of points (1, n)."""
        assert self.section is not None
        found = np.asarray(self.section(x))
        if found.shape != x.shape[1:] or not (found == np.rint(found)).all():
            raise ValueError(
                "Weibull: section must return one integer for each of the points x (3, "
                f"{x.shape[1]}), not {found!r:.80}"
            )
        return found.astype(np.int64)[None]

    def _boxes(self, x: NDArray[np.float64]) -> NDArray[np.int64]:
        """Boxes of the resolution in which points lie (d, n)."""
        if self.resolution is None:
            raise ValueError(
                "Weibull: outside of a problem the size of the mesh is unknown; give resolution=, "
                "about 1e-6 of the size of the facets"
            )
        farthest, remedy = np.abs(x).max(initial=0.0), "about 1e-6 of the size of the facets"
        if farthest * np.finfo(float).eps > _ROUNDING * self.resolution:
            raise ValueError(
                f"Weibull: resolution = {self.resolution:g} is close to the rounding of "
                f"coordinates of {farthest:g}; use one of {remedy}"
            )
        boxes = np.floor(x / self.resolution + _OFFSET).astype(np.int64)
        if np.unique(boxes, axis=1).shape[1] < x.shape[1]:
            raise ValueError(
                f"Weibull: points are closer together than resolution = {self.resolution:g} and "
                f"would have the same value; use one of {remedy}"
            )
        return boxes


def _mixed(number: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """The output of SplitMix64 for each state."""
    number = number + np.uint64(_STEP)
    for shift, factor in _MIX:
        number = (number ^ (number >> np.uint64(shift))) * np.uint64(factor)
    return number ^ (number >> np.uint64(_LAST))
