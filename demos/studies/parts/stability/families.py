"""Families of cases and the numbers of their runs. A case depends on its number only."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from parts.stability import apart, cases, plastic
from parts.stability.links import bundles, rows
from parts.stability.motions import motion
from parts.stability.pieces import films, loose
from parts.stability.programmes import coatings, directions, friction, programmes, rates
from parts.stability.scenes import Case
from parts.stability.units import units

Family = Callable[[Generator], Case]

#: Families by the number of their first run, which each keeps: they take turns from there.
FAMILIES: dict[int, tuple[Family, ...]] = {
    0: (
        cases.aspect_ratio,
        cases.contrast,
        cases.incompressible,
        cases.distortion,
        cases.inverted,
        cases.steep_softening,
        cases.step_sizes,
        cases.load_cycles,
        cases.dead_loads,
        cases.large_rotation,
        cases.large_strain,
        cases.weak_bond,
        cases.polycrystal,
        cases.crack_tip,
        cases.random_facets,
        cases.inclined,
        cases.corner_cells,
        cases.axisymmetric,
    ),
    540: (cases.on_demand, cases.ogden, cases.viscous),
    630: (programmes, directions, coatings, rates, friction, bundles, rows, films, loose, units),
    930: (plastic.bars, plastic.cells),
    990: (motion,),
    1020: (apart.bonded, apart.sliding),
}


def numbers(each: int) -> list[int]:
    """Numbers of the first runs of every family, 30 at most."""
    return [
        n
        for first, some in FAMILIES.items()
        for n in range(first, first + min(each, 30) * len(some))
    ]


def draw(number: int) -> Case:
    """Case of a number."""
    first = max(start for start in FAMILIES if start <= number)
    some = FAMILIES[first]
    return some[(number - first) % len(some)](np.random.default_rng(number))
