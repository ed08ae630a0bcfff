"""Facets of a surface in a tree of boxes: what lies along a line, and what is nearest."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Protocol

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ..base.kernels import call, compile_source

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]

#: By how much boxes exceed their facets, relative to the largest coordinate: rounding.
_ROUNDING = 1e-12

#: Bits of a coordinate in the order of facets along a curve that fills space.
_BITS = 20

#: Rows, and the arrays of facet_tree.c.
_DECLARATIONS = f"""
void first_along(long{", void *" * 12});
void nearest(long{", void *" * 10});
void opposite(long{", void *" * 16});
"""


class Facets(Protocol):
    """What is known of facets: see :class:`.FlatFacets`."""

    @property
    def corners(self) -> Array: ...
    @property
    def normals(self) -> Array: ...
    @property
    def centres(self) -> Array: ...
    @property
    def radii(self) -> Array: ...


class FacetTree:
    """Facets in the leaves of a binary tree, in Morton's order."""

    def __init__(self, facets: Facets):
        self.facets, corners = facets, facets.corners
        count, _, d = corners.shape
        levels = int(np.ceil(np.log2(max(count, 1))))
        self._leaves = 2**levels
        self._order = np.full(self._leaves, -1, dtype=np.int64)
        self._order[:count] = np.argsort(_morton(facets.centres), kind="stable")
        room = _ROUNDING * np.abs(corners).max(initial=0.0)
        # For none, boxes from the largest to the smallest number.
        ends = np.full((2, 2 * self._leaves - 1, d), np.finfo(float).max / 4)
        ordered = corners[self._order[:count]]
        first = self._leaves - 1
        ends[0, first : first + count] = ordered.min(axis=1) - room
        ends[1, first : first + count] = -ordered.max(axis=1) - room
        for level in range(levels - 1, -1, -1):
            start = 2**level - 1
            below = ends[:, 2 * start + 1 : 4 * start + 3]
            ends[:, start : 2 * start + 1] = np.minimum(below[:, ::2], below[:, 1::2])
        self._tree = np.array([self._leaves]), ends[0], -ends[1], self._order
        middles, half = (ends[0] - ends[1]) / 2, -(ends[0] + ends[1]) / 2
        none = half[:, 0] < 0
        half[none] = 0.0
        around = np.where(none, -1.0, np.linalg.norm(half, axis=1))
        self._spheres = self._tree[0], middles, around, self._order
        self._kernels = _module(d, corners.shape[1])

    def first_along(
        self, x: Array, way: Array, start: Array, end: Array, skip: Numbers | int = -1
    ) -> tuple[Array, Numbers]:
        """The first facets but ``skip`` that lines x + t way (n, d) meet, start < t < end (n,): t,
        which is ``end`` for none, and the facets, -1 for none (n,)."""
        t, which = np.empty(len(x)), np.empty(len(x), dtype=np.int64)
        skipped = np.full(len(x), skip, dtype=np.int64)
        arrays = x, way, start, end, skipped, *self._tree, self.facets.corners, t, which
        call(self._kernels, "first_along", *arrays)
        return t, which

    def nearest(self, x: Array, most: Array | float = np.inf) -> tuple[Array, Array, Numbers]:
        """The nearest points of facets no farther than ``most`` (n,) from points (n, d): places,
        distances, and facets, -1 for none."""
        places, away = np.zeros_like(x), np.empty(len(x))
        which, limit = np.empty(len(x), dtype=np.int64), np.full(len(x), most, dtype=float)
        arrays = x, limit, *self._tree, self.facets.corners, places, away, which
        call(self._kernels, "nearest", *arrays)
        return places, away, which

    def opposite(
        self, others: Facets, ahead: Array, behind: Array, angle: float
    ) -> tuple[Numbers, Numbers]:
        """Others and facets with opposite normals that are not next to each other seen along those
        of the others, by the others.

        Args:
            ahead, behind: Largest distances along their normals, and against them (n,) [mm].
            angle: Cosine of the largest angle between a normal and the reversed other one.
        """
        numbers, mine = np.empty(len(others.corners), dtype=np.int64), self.facets
        given = others.centres, others.normals, others.radii, ahead, behind, np.array([angle])
        given = *given, *self._spheres, mine.centres, mine.normals, mine.radii
        call(self._kernels, "opposite", *given, None, numbers, None)
        found = np.empty(numbers.sum(), dtype=np.int64)
        call(self._kernels, "opposite", *given, np.cumsum(numbers) - numbers, numbers, found)
        i = np.repeat(np.arange(len(numbers)), numbers)
        return i, found[np.lexsort((found, i))]


def _morton(points: Array) -> NDArray[np.int64]:
    """Numbers of points (n, d) along a curve that fills their box."""
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    low, size = points.min(axis=0), np.ptp(points, axis=0).max()
    steps = ((points - low) / (size or 1.0) * (2**_BITS - 1)).astype(np.int64)
    bits = steps[:, :, None] >> np.arange(_BITS) & 1
    d = points.shape[1]
    places = d * np.arange(_BITS) + np.arange(d)[:, None]
    return (bits << places).sum(axis=(1, 2))


@cache
def _module(d: int, corners: int) -> ModuleType:
    """facet_tree.c, without ranks that wait for each other."""
    source, sizes = Path(__file__).with_suffix(".c"), {"DIM": d, "CORNERS": corners}
    return compile_source(source, _DECLARATIONS, sizes, MPI.COMM_SELF, "facets in a tree")
