"""Where the facets of two surfaces that share no nodes lie opposite each other, cut into segments.

Every facet of the first surface has a plane, through its centre and along its corners, into which
both facets of a pair are projected along its normal. Their intersection, an interval in 2D and a
convex polygon in 3D that is cut into triangles or quadrilaterals, is where a quadrature rule has
polynomials on both sides: the points of one surface alone would integrate those of the other one
across their kinks.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
import scipy
from numpy.typing import NDArray

from ..base.kernels import call, compile_source

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]

#: Cosine of the largest angle between a normal and the reversed normal of a facet opposite to it.
OPPOSITE = 0.5

#: Largest distance of facets that lie opposite each other, relative to the larger one's radius: of
#: polygons along one curve, and of bodies that may be apart or overlap.
REACH, FAR_REACH = 0.5, 2.0

#: Overlap of facets, relative to the larger distance from the middle of a cell, beyond which they
#: turn their backs on each other: twice is a cell.
_THROUGH = 2.0

#: Smallest measure of a segment relative to that of the smaller facet, and smallest distance of its
#: corners relative to their largest coordinate: less is rounding.
_SLIVER, _SAME = 1e-12, 1e-13

#: Distance from a side, relative to the size of the facet, within which a point is on it.
_ALONG = 1e-9

#: Share of a facet that need not be covered before others behind are left out.
_COVERED = 1e-9


#: By how much facets are larger that may soon be paired, relative to their size.
_SOON = 0.25

#: Number of pairs of polygons, and the arrays of segments.c.
_DECLARATIONS = f"""
void clipped(long{", void *" * 5});
void pieces(long{", void *" * 4});
"""


class FlatFacets(NamedTuple):
    """Facets by their corners.

    Attributes:
        corners: In order around each facet (n, c, d) [mm].
        normals: Unit normals, outward (n, d).
        depths: Distances of the middle of their cells (n,) [mm].
    """

    corners: Array
    normals: Array
    depths: Array

    @classmethod
    def of(cls, corners: Array, inside: Array) -> FlatFacets:
        """Facets with these corners, of cells with points ``inside`` (n, d).

        Warped quadrilaterals have the normal of their diagonals.
        """
        if corners.shape[2] == 2:
            edge = corners[:, 1] - corners[:, 0]
            normals = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
        else:
            one, two = ((2, 0), (3, 1)) if corners.shape[1] == 4 else ((1, 0), (2, 0))
            edges = [corners[:, end] - corners[:, start] for end, start in (one, two)]
            normals = np.cross(*edges)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        outward = corners.mean(axis=1) - inside
        depths = np.einsum("fi,fi->f", normals, outward)
        return cls(corners, normals * np.sign(depths)[:, None], np.abs(depths))

    def rows(self, select: NDArray) -> FlatFacets:
        """Some of them."""
        return FlatFacets(*(array[select] for array in self))

    @property
    def centres(self) -> Array:
        """Means of the corners (n, d) [mm]."""
        return self.corners.mean(axis=1)

    def grown(self, factor: float) -> FlatFacets:
        """Facets that are larger by a factor, about their centres."""
        centres = self.centres[:, None]
        return self._replace(corners=centres + factor * (self.corners - centres))

    @property
    def radii(self) -> Array:
        """Distances of the farthest corners from the centre (n,) [mm]."""
        return np.linalg.norm(self.corners - self.centres[:, None], axis=2).max(axis=1)

    @property
    def measures(self) -> Array:
        """Lengths, or areas (n,) [mm; mm2]."""
        axes = plane_axes(self)
        return np.abs(_measures(_projected(self.corners, self.centres, axes)))


class Segments(NamedTuple):
    """Intersections of facets of two surfaces in planes of the first surface.

    Those of quadrilaterals are quadrilaterals, in order around; with a repeated corner triangles.

    Attributes:
        first: Facet of the first surface (n,).
        second: Facet of the second one (n,).
        corners: Corners in the plane (n, c, d - 1) [mm].
        origins: Origin of the plane (n, d) [mm].
        axes: Its orthonormal axes (n, d - 1, d).
        follows: How corners move in the plane where the second facet moves by g relative to the
            first one: by the product with g (n, c, d - 1, d - 1). Corners of the first facet rest,
            those of the second one follow, and intersections of sides move along that of the first.
    """

    first: Numbers
    second: Numbers
    corners: Array
    origins: Array
    axes: Array
    follows: Array

    @property
    def measures(self) -> Array:
        """Lengths, or areas (n,) [mm; mm2]."""
        return np.abs(_measures(self.corners))

    def rows(self, select: NDArray) -> Segments:
        """Some of them."""
        return Segments(*(array[select] for array in self))

    @classmethod
    def joined(cls, parts: Sequence[Segments]) -> Segments:
        """All of these, in their order."""
        return cls(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def cut(first: FlatFacets, second: FlatFacets, reach: float = REACH) -> Segments:
    """The segments of two surfaces, by facets of the first one.

    Facets lie opposite each other where their normals do, within 60 degrees, and their distance is
    at most half the radius of the larger one: more than that of two polygons along one curve. Where
    they overlap by more than the cells of both, they are the backs of thin bodies.

    Args:
        first: Facets whose planes are used.
        second: Those of the other surface.
        reach: Another largest distance, relative to the radius of the larger facet. Where a facet
            then has several others opposite it, one behind the other, the nearest ones count.
    """
    i, j = near_pairs(first, second, reach)
    d = first.corners.shape[2]
    axes, centres = plane_axes(first), first.centres
    one, two = _both_projected(first, second, i, j)
    pair, corners = (_intervals if d == 2 else _polygons)(one, two)
    i, j = i[pair], j[pair]
    follows = _followed(corners, one[pair], two[pair])
    found = Segments(i, j, corners, centres[i], axes[i], follows)
    least = _SLIVER * np.minimum(first.measures[i], second.measures[j])
    # The distance along the normal, at the middle of the segment.
    middle = centres[i] + np.einsum("sk,skd->sd", corners.mean(axis=1), axes[i])
    away = np.einsum("sd,sd->s", second.centres[j] - middle, second.normals[j])
    away /= np.einsum("sd,sd->s", first.normals[i], second.normals[j])
    most, deepest = _limits(first, second, i, j, reach)
    keep = (found.measures > least) & (away <= most) & (-away <= deepest)
    found, away = found.rows(keep), away[keep]
    if reach == REACH:
        return found
    nearest = _nearest(found, np.abs(away), first.measures)
    found, away = found.rows(nearest), away[nearest]
    # Facets that overlap by more than what is covered of them meet with their edges only: where a
    # shaft is about to leave its hole, the ends of both are no pair.
    covered = np.bincount(found.first, found.measures, minlength=len(first.corners))
    return found.rows(-away <= covered[found.first] ** (1 / (d - 1)))


def soon_paired(first: FlatFacets, second: FlatFacets, reach: float) -> tuple[Numbers, Numbers]:
    """Pairs of facets that are or, after a short way, may be in :func:`cut`: those that overlap if
    they are larger by a fraction :data:`_SOON`, by facets of the first surface."""
    one, two = (side.grown(1 + _SOON) for side in (first, second))
    i, j = near_pairs(one, two, reach)
    both = _both_projected(one, two, i, j)
    meet = np.unique((_intervals if first.corners.shape[2] == 2 else _polygons)(*both)[0])
    return i[meet], j[meet]


def _limits(
    first: FlatFacets, second: FlatFacets, i: Numbers, j: Numbers, reach: float
) -> tuple[Array, Array]:
    """Largest distance and largest overlap of facets ``i`` and ``j`` that are a pair (n,) [mm]."""
    most = reach * np.maximum(first.radii[i], second.radii[j])
    return most, np.minimum(most, _THROUGH * np.maximum(first.depths[i], second.depths[j]))


def passed(
    first: FlatFacets, second: FlatFacets, before: tuple[FlatFacets, FlatFacets], reach: float
) -> bool:
    """Whether facets of the first surface are behind ones of the second one, too deep for a pair,
    that they were before or near at the start.

    Args:
        first: Facets that have no partner now.
        second: Those of the other surface.
        before: Both at the start of the step, where they were paired or apart.
        reach: As of :func:`cut`.
    """
    if not len(first.corners) or not len(second.corners):
        return False
    radius = max(first.radii.max(), second.radii.max())
    ways = (
        np.linalg.norm(now.centres - then.centres, axis=1).max()
        for now, then in zip((first, second), before, strict=True)
    )
    i, j = _opposite(first, second, (1 + reach) * radius + sum(ways))
    way, then = first.centres[i] - second.centres[j], before[0].centres[i] - before[1].centres[j]
    depth = -np.einsum("pd,pd->p", way, second.normals[j])
    start = -np.einsum("pd,pd->p", then, before[1].normals[j])
    aside = np.linalg.norm(way + depth[:, None] * second.normals[j], axis=1)
    _, deepest = _limits(first, second, i, j, reach)
    there = (aside <= second.radii[j]) & (depth > deepest)
    return bool((there & (start <= deepest)).any())


def _nearest(segments: Segments, away: Array, measures: Array) -> NDArray[np.bool_]:
    """Which segments remain if every facet of the first surface, with its measure, is covered once,
    by those at the least distance (n,)."""
    order = np.lexsort((away, segments.first))
    covered = np.cumsum(segments.measures[order])
    facet = segments.first[order]
    begins = np.flatnonzero(np.diff(facet, prepend=-1))
    before = covered - segments.measures[order]
    before -= np.repeat(before[begins], np.diff(np.append(begins, len(facet))))
    kept = np.zeros(len(facet), dtype=bool)
    kept[order] = before < (1 - _COVERED) * measures[facet]
    return kept


def plane_axes(facets: FlatFacets) -> Array:
    """Orthonormal axes of the planes of facets (n, d - 1, d)."""
    normals = facets.normals
    if normals.shape[1] == 2:
        return np.stack([-normals[:, 1], normals[:, 0]], axis=1)[:, None]
    edge = facets.corners[:, 1] - facets.corners[:, 0]
    edge -= np.einsum("fi,fi->f", edge, normals)[:, None] * normals
    edge /= np.linalg.norm(edge, axis=1, keepdims=True)
    return np.stack([edge, np.cross(normals, edge)], axis=1)


def _projected(points: Array, origins: Array, axes: Array) -> Array:
    """Coordinates of points (n, c, d) in planes (n, c, d - 1)."""
    return np.einsum("nkd,ncd->nck", axes, points - origins[:, None])


def _both_projected(
    first: FlatFacets, second: FlatFacets, i: Numbers, j: Numbers
) -> tuple[Array, Array]:
    """Facets ``i`` of one surface and ``j`` of another in the planes of the former
    (n, c, d - 1)."""
    axes, centres = plane_axes(first)[i], first.centres[i]
    return _projected(first.corners[i], centres, axes), _projected(second.corners[j], centres, axes)


def _measures(corners: Array) -> Array:
    """Lengths of intervals (n, 2, 1), areas of polygons (n, c, 2), positive counterclockwise."""
    if corners.shape[2] == 1:
        return corners[:, 1, 0] - corners[:, 0, 0]
    x, y = np.moveaxis(corners - corners[:, :1], 2, 0)
    return (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1) / 2


def near_pairs(first: FlatFacets, second: FlatFacets, reach: float) -> tuple[Numbers, Numbers]:
    """Pairs of facets with opposite normals whose spheres are no farther apart than the radius of
    the larger one times ``reach``, and meet in the plane of the first."""
    if not len(first.corners) or not len(second.corners):
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    one, two = first.radii, second.radii
    largest = max(one.max(), two.max())
    i, j = _opposite(first, second, one.max() + two.max() + reach * largest)
    way, both = second.centres[j] - first.centres[i], one[i] + two[j]
    apart = np.einsum("pd,pd->p", way, way)
    along = np.einsum("pd,pd->p", way, first.normals[i])
    meet = apart <= (both + reach * np.maximum(one[i], two[j])) ** 2
    meet &= apart - along**2 <= both**2
    return i[meet], j[meet]


def _opposite(first: FlatFacets, second: FlatFacets, most: float) -> tuple[Numbers, Numbers]:
    """Pairs of facets with opposite normals whose centres are no farther apart than ``most``, by
    facets of the first surface."""
    trees = [scipy.spatial.cKDTree(side.centres) for side in (first, second)]
    near = trees[0].sparse_distance_matrix(trees[1], most, output_type="ndarray")
    i, j = near["i"], near["j"]
    keep = np.einsum("pd,pd->p", first.normals[i], second.normals[j]) < -OPPOSITE
    i, j = i[keep], j[keep]
    order = np.lexsort((j, i))
    return i[order], j[order]


def _intervals(one: Array, two: Array) -> tuple[Numbers, Array]:
    """Intersections of intervals (n, 2, 1): numbers of the pairs, and ends (m, 2, 1)."""
    low = np.maximum(one.min(axis=1), two.min(axis=1))
    high = np.minimum(one.max(axis=1), two.max(axis=1))
    pairs = np.flatnonzero(high[:, 0] > low[:, 0])
    return pairs, np.stack([low, high], axis=1)[pairs]


def _polygons(one: Array, two: Array) -> tuple[Numbers, Array]:
    """Intersections of convex polygons (n, c, 2), cut into triangles or quadrilaterals as they are:
    numbers of the pairs, and corners (m, c, 2).

    The corner whose triangle with its neighbours is the smallest is cut off until as many are left.
    So a polygon that is nearly one of these is integrated nearly like it, as where facets that lie
    on each other begin to slide: a fan of triangles would integrate by another rule.
    """
    count, size = len(one), max(one.shape[1], two.shape[1])
    # With a repeated corner a triangle is a quadrilateral.
    one, two = (p[:, np.minimum(np.arange(size), p.shape[1] - 1)] for p in (one, two))
    polygons, counts = clipped(_counterclockwise(one), _counterclockwise(two))
    most = polygons.shape[1] - size + 1
    found, numbers = np.empty((count, most, size, 2)), np.empty(count, dtype=np.int64)
    call(_module(size), "pieces", polygons, counts, found, numbers)
    return np.repeat(np.arange(count), numbers), found[np.arange(most) < numbers[:, None]]


def _followed(corners: Array, one: Array, two: Array) -> Array:
    """The products of :attr:`Segments.follows` for corners (n, c, d - 1) of intersections of
    polygons (n, k, d - 1)."""
    if corners.shape[2] == 1:
        size = _ALONG * np.abs(one).max(axis=(1, 2), initial=0.0)[:, None, None]
        rests = (np.abs(corners - one.swapaxes(1, 2)) <= size).any(axis=2)
        return np.where(rests, 0.0, 1.0)[..., None, None]
    # Two sides meet at a corner, if possible of the first polygon; with their normals a and b it
    # moves by x with a.x = a.g or 0, b.x = b.g or 0.
    normals = np.concatenate([_side_normals(one), _side_normals(two)], axis=1)
    away = np.einsum("nkd,ncd->nck", normals, corners)
    away -= np.einsum("nkd,nkd->nk", normals, np.concatenate([one, two], axis=1))[:, None]
    on = np.abs(away) <= _ALONG * np.abs(two).max(axis=(1, 2), initial=0.0)[:, None, None]
    moves = np.repeat([0.0, 1.0], [one.shape[1], two.shape[1]])
    first = on.argmax(axis=2)
    a = np.take_along_axis(normals, first[..., None], axis=1)
    x, y = np.moveaxis(normals, 2, 0)[:, :, None]
    across = np.abs(a[..., :1] * y - a[..., 1:] * x)
    second = (on * across * (2.0 - moves)).argmax(axis=2)
    b = np.take_along_axis(normals, second[..., None], axis=1)
    both = np.stack([a, b], axis=2)
    moved = np.stack([moves[first], moves[second]], axis=2)
    x, y = np.moveaxis(both, 3, 0)
    flat = np.abs(x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]) < _ALONG
    both[flat] = np.eye(2)
    moved[flat] = 0.0
    return np.linalg.solve(both, moved[..., None] * both)


def _side_normals(polygons: Array) -> Array:
    """Unit normals of sides (n, k, 2); zero for sides of no length."""
    x, y = np.moveaxis(np.roll(polygons, -1, axis=1) - polygons, 2, 0)
    length = np.hypot(x, y)
    return np.stack([y, -x], axis=2) / np.where(length > 0, length, 1.0)[..., None]


def _counterclockwise(polygons: Array) -> Array:
    clockwise = _measures(polygons) < 0
    return np.where(clockwise[:, None, None], polygons[:, ::-1], polygons)


def clipped(window: Array, polygons: Array) -> tuple[Array, NDArray[np.int64]]:
    """Intersections of convex polygons, by Sutherland and Hodgman.

    Args:
        window: Counterclockwise polygons (n, c, 2).
        polygons: Others (n, c, 2).

    Returns:
        Corners of the intersections (n, 5 c, 2), and their numbers (n,), possibly zero; corners
        beyond these are meaningless.
    """
    count, size = window.shape[:2]
    corners, counts = np.empty((count, 5 * size, 2)), np.empty(count, dtype=np.int64)
    call(_module(size), "clipped", window, polygons, np.array([_SAME]), corners, counts)
    return corners, counts


@cache
def _module(corners: int) -> ModuleType:
    """segments.c for polygons of so many corners, without ranks that wait for each other."""
    source = Path(__file__).with_suffix(".c")
    return compile_source(source, _DECLARATIONS, {"CORNERS": corners}, MPI.COMM_SELF, "segments")
