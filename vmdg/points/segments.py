"""Where the facets of two surfaces that share no nodes lie opposite each other, cut into segments.

Every facet of the first surface has a plane, through its centre and along its corners, into which
both facets of a pair are projected along its normal. Their intersection, an interval in 2D and a
convex polygon in 3D that is cut into triangles or quadrilaterals, is where a quadrature rule has
polynomials on both sides: the points of one surface alone would integrate those of the other one
across their kinks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
import scipy
from numpy.typing import NDArray

from ..base.kernels import call, compile_source
from .facet_tree import FacetTree

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]

#: Cosine of the largest angle between a normal and the reversed normal of a facet opposite to it:
#: 60 degrees, rounding included.
OPPOSITE = 0.5 - 1e-9

#: Distance beyond which open pairs are left out where surfaces are paired again in every state,
#: relative to the larger facet's radius: they exert nothing, so that it decides nothing.
OPEN_REACH = 2.0

#: Distances from a facet and from its partner within which others are on them, relative to the
#: radius, and to their distance.
_ON, _BETWEEN = 1e-9, 1e-6

#: Smallest measure of a segment relative to that of the smaller facet, and smallest distance of its
#: corners relative to their largest coordinate: less is rounding.
_SLIVER, _SAME = 1e-12, 1e-13

#: Differences of areas, relative to the square of the largest coordinate, below which they are
#: equal.
_EQUAL = 1e-9

#: Distance from a side, relative to the size of the facet, within which a point is on it.
_ALONG = 1e-9

#: By how much facets are larger that may soon be paired, relative to their size.
_SOON = 0.25

#: Number of pairs of polygons, and the arrays of segments.c.
_DECLARATIONS = f"""
void clipped(long{", void *" * 5});
void pieces(long{", void *" * 6});
"""


@dataclass(frozen=True, eq=False)
class FlatFacets:
    """Facets by their corners."""

    corners: Array  # In order around each facet (n, c, d) [mm]
    normals: Array  # Unit normals, outward (n, d)

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
        turns = np.sign(np.einsum("fi,fi->f", normals, outward))
        return cls(corners, normals * turns[:, None])

    def rows(self, select: NDArray) -> FlatFacets:
        return FlatFacets(self.corners[select], self.normals[select])

    @cached_property
    def centres(self) -> Array:
        """Means of the corners (n, d) [mm]."""
        return self.corners.mean(axis=1)

    def grown(self, factor: float) -> FlatFacets:
        """Facets that are larger by a factor, about their centres."""
        centres = self.centres[:, None]
        return replace(self, corners=centres + factor * (self.corners - centres))

    @cached_property
    def radii(self) -> Array:
        """Distances of the farthest corners from the centre (n,) [mm]."""
        return np.linalg.norm(self.corners - self.centres[:, None], axis=2).max(axis=1)

    @cached_property
    def axes(self) -> Array:
        """Orthonormal axes of the planes (n, d - 1, d)."""
        normals = self.normals
        if normals.shape[1] == 2:
            return np.stack([-normals[:, 1], normals[:, 0]], axis=1)[:, None]
        edge = self.corners[:, 1] - self.corners[:, 0]
        edge -= np.einsum("fi,fi->f", edge, normals)[:, None] * normals
        edge /= np.linalg.norm(edge, axis=1, keepdims=True)
        return np.stack([edge, np.cross(normals, edge)], axis=1)

    @cached_property
    def measures(self) -> Array:
        """Lengths, or areas (n,) [mm; mm2]."""
        return np.abs(_measures(_projected(self.corners, self.centres, self.axes)))

    @cached_property
    def tree(self) -> FacetTree:
        return FacetTree(self)


class Segments(NamedTuple):
    """Intersections of facets of two surfaces in planes of the first surface.

    Those of quadrilaterals are quadrilaterals, in order around; with a repeated corner triangles.
    """

    first: Numbers  # Facet of the first surface (n,)
    second: Numbers  # Facet of the second one (n,)
    corners: Array  # Corners in the plane (n, c, d - 1) [mm]
    origins: Array  # Origin of the plane (n, d) [mm]
    axes: Array  # Its orthonormal axes (n, d - 1, d)
    # one, two: The whole facets in the plane (n, k, d - 1) [mm]
    one: Array
    two: Array
    # Distance of the second facet along the normal of the first, at the middle (n,), negative where
    # bodies overlap [mm]
    away: Array

    @property
    def measures(self) -> Array:
        return np.abs(_measures(self.corners))

    def follows(self) -> Array:
        """How corners move in the plane where the second facet moves by g relative to the first
        one: by the product with g (n, c, d - 1, d - 1). Corners of the first facet rest, those of
        the second one follow, and intersections of sides move along that of the first."""
        return _followed(self.corners, self.one, self.two)

    def rows(self, select: NDArray) -> Segments:
        return Segments(*(array[select] for array in self))

    @classmethod
    def joined(cls, parts: Sequence[Segments]) -> Segments:
        return cls(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def cut(
    first: FlatFacets,
    second: FlatFacets,
    most: float = np.inf,
    reach: float = np.inf,
    whole: tuple[FlatFacets, Numbers] | None = None,
) -> Segments:
    """The segments of two surfaces, by facets of the first one.

    Facets lie opposite each other where their normals do, within 60 degrees, and where no other
    facet of either body is between them, see :func:`_facing`.

    Args:
        reach: Largest distance, not overlap, relative to the radius of the larger facet.
        whole: The first surface, and which of its facets ``first`` are.
    """
    limit = np.minimum(most, reach * (first.radii + second.radii.max(initial=0.0)))
    behind = np.full(len(limit), most)
    i, j = second.tree.opposite(first, limit, behind, OPPOSITE)
    d = first.corners.shape[2]
    axes, centres = first.axes, first.centres
    one, two = _both_projected(first, second, i, j)
    pair, corners = (_intervals if d == 2 else _polygons)(one, two)
    i, j = i[pair], j[pair]
    # The distance along the normal, at the middle of the segment.
    middle = centres[i] + np.einsum("sk,skd->sd", corners.mean(axis=1), axes[i])
    away = np.einsum("sd,sd->s", second.centres[j] - middle, second.normals[j])
    away /= np.einsum("sd,sd->s", first.normals[i], second.normals[j])
    found = Segments(i, j, corners, centres[i], axes[i], one[pair], two[pair], away)
    least = _SLIVER * np.minimum(first.measures[i], second.measures[j])
    larger = np.maximum(first.radii[i], second.radii[j])
    keep = found.measures > least
    keep &= (away <= np.minimum(most, reach * larger)) & (-away <= most)
    found, middle = found.rows(keep), middle[keep]
    body, numbers = (first, np.arange(len(first.corners))) if whole is None else whole
    mine = numbers[found.first]
    return found.rows(_facing(found, middle, mine, (body.tree, second.tree)))


def _facing(
    segments: Segments, x: Array, mine: Numbers, bodies: tuple[FacetTree, FacetTree]
) -> NDArray[np.bool_]:
    """Which segments are of facets that face each other (n,).

    A line along the normal N of side 1 runs through the middle of a segment, x, to the other facet
    at x + s N. Seen from x, where s > 0, nothing is between them; in an overlap, s < 0, the way
    back runs inside both bodies, so that nothing is between them either: behind a thin body, and on
    the backs of two, there is. Where only parts of surfaces are known, facets on both sides of x
    may be opposite: the nearer one counts.

    An overlap belongs to the facets between which it is shallow: x does not meet x + s N if from
    the point y of side 2 that is nearest to the middle of this line, D < |s|/2 away on a facet with
    another normal N_2, side 1 is at y - D' N_2 with D <= D' < |s|/2. So the ends of a shaft that
    leaves its hole are no pair, though its interference is in front of the other end of the hole.
    """
    one, two = bodies
    normals, theirs = one.facets.normals[mine], segments.second
    scale = segments.measures.max(initial=0.0) ** (1 / segments.corners.shape[2])
    size, start = np.abs(segments.away), np.full(len(x), _ON * scale)
    end = np.maximum((1 - _BETWEEN) * size, start)
    way = np.sign(segments.away)[:, None] * normals
    facing = (one.first_along(x, way, start, end, mine)[1] < 0) & (
        two.first_along(x, way, start, end, theirs)[1] < 0
    )
    back, _ = one.first_along(x, -way, start, end, mine)
    nearer, other = two.first_along(x, -way, start, end, theirs)
    cosines = np.einsum("sd,sd->s", two.facets.normals[other], normals)
    facing &= (other < 0) | (cosines > -OPPOSITE) | (nearer > back)
    deep = np.flatnonzero(facing & (segments.away < -start))
    half = OPPOSITE * end
    middle = x + segments.away[:, None] / 2 * normals
    y, D, nearest = two.nearest(middle[deep], half[deep])
    aside = np.einsum("sd,sd->s", two.facets.normals[theirs[deep]], two.facets.normals[nearest])
    other = (nearest >= 0) & (aside < OPPOSITE)
    deep, y, D, inward = deep[other], y[other], D[other], -two.facets.normals[nearest[other]]
    _, which = one.first_along(y, inward, (1 - _BETWEEN) * D - start[deep], half[deep])
    cosines = np.einsum("sd,sd->s", one.facets.normals[which], inward)
    facing[deep] = (which < 0) | (cosines < OPPOSITE)
    return facing


def soon_paired(first: FlatFacets, second: FlatFacets, reach: float) -> tuple[Numbers, Numbers]:
    """Pairs of facets that are or, after a short way, may be in :func:`cut`: those that overlap if
    they are larger by a fraction :data:`_SOON`, by facets of the first surface."""
    one, two = (side.grown(1 + _SOON) for side in (first, second))
    limit = reach * (one.radii + two.radii.max(initial=0.0))
    i, j = two.tree.opposite(one, limit, limit, OPPOSITE)
    both = _both_projected(one, two, i, j)
    meet = np.unique((_intervals if first.corners.shape[2] == 2 else _polygons)(*both)[0])
    return i[meet], j[meet]


def inside(facets: FlatFacets, body: FlatFacets, paired: Numbers, deepest: float) -> Array:
    """How deep the middles of facets that have no partner are in another body, where none of its
    facets nearby has one either, else 0 (n,) [mm].

    A middle x is inside where the line back from it meets the surface from outside first. What
    is there may be stopped by facets around: the side of a block is inside a floor that its bottom
    presses. That is so where a facet with a partner is no farther away than twice D, the distance
    of the surface, or twice the deepest overlap of pairs.
    """
    x, N, tree = facets.centres, facets.normals, body.tree
    size = np.concatenate([facets.radii, body.radii]).max(initial=0.0)
    start, end = np.full(len(x), _ON * size), np.full(len(x), np.inf)
    _, first = tree.first_along(x, -N, start, end)
    deep = np.flatnonzero((first >= 0) & (np.einsum("fd,fd->f", body.normals[first], N) < 0))
    depth = np.zeros(len(x))
    _, depth[deep], _ = tree.nearest(x[deep])
    deep = deep[depth[deep] > _BETWEEN * size]
    held = body.rows(paired).tree
    around = 2 * np.maximum(depth[deep], deepest)
    alone = held.nearest(x[deep], around)[2] < 0
    found = np.zeros(len(x))
    found[deep[alone]] = depth[deep[alone]]
    return found


def passed(facets: FlatFacets, body: FlatFacets, before: tuple[FlatFacets, FlatFacets]) -> bool:
    """Whether facets without a partner have gone through another body: the middle of one was in
    front of its surface, crossed a facet on the straight way, seen from this facet, and is behind
    one, not next to it."""
    if not len(facets.corners) or not len(body.corners):
        return False
    moves = [now.centres - then.centres for now, then in zip((facets, body), before, strict=True)]
    common = moves[1].mean(axis=0)
    ways = sum(np.linalg.norm(move - common, axis=1).max() for move in moves)
    trees = [scipy.spatial.cKDTree(side.centres) for side in (facets, body)]
    near = trees[0].sparse_distance_matrix(trees[1], body.radii.max() + ways, output_type="ndarray")
    i, j = near["i"], near["j"]
    opposite = np.einsum("pd,pd->p", facets.normals[i], body.normals[j]) < -OPPOSITE
    i, j = i[opposite], j[opposite]
    axes, places, heights = body.axes[j], [], []
    for one, two in (before, (facets, body)):
        way = one.centres[i] - two.centres[j]
        heights.append(np.einsum("pd,pd->p", way, two.normals[j]))
        places.append(np.einsum("pkd,pd->pk", two.axes[j], way))
    through = (heights[0] > 0) & (heights[1] < 0)
    share = (heights[0] / np.where(through, heights[0] - heights[1], 1.0))[:, None]
    crossed = (1 - share) * places[0] + share * places[1]
    facet = _projected(body.corners[j], body.centres[j], axes)
    count = len(facets.corners)
    crosses, behind = (
        np.bincount(i[through & _contain(facet, at)], minlength=count)
        for at in (crossed, places[1])
    )
    return bool(((crosses > 0) & (behind > 0)).any())


def _contain(polygons: Array, points: Array) -> NDArray[np.bool_]:
    """Whether convex polygons or intervals (n, c, d - 1) contain points (n, d - 1)."""
    if points.shape[1] == 1:
        return (polygons.min(axis=1) <= points).all(axis=1) & (points <= polygons.max(axis=1)).all(
            axis=1
        )
    polygons = _counterclockwise(polygons)
    outward = np.einsum("nkd,nkd->nk", _side_normals(polygons), points[:, None] - polygons)
    return (outward <= 0).all(axis=1)


def _projected(points: Array, origins: Array, axes: Array) -> Array:
    """Coordinates of points (n, c, d) in planes (n, c, d - 1)."""
    return np.einsum("nkd,ncd->nck", axes, points - origins[:, None])


def _both_projected(
    first: FlatFacets, second: FlatFacets, i: Numbers, j: Numbers
) -> tuple[Array, Array]:
    """Facets ``i`` of one surface and ``j`` of another in the planes of the former
    (n, c, d - 1)."""
    axes, centres = first.axes[i], first.centres[i]
    return _projected(first.corners[i], centres, axes), _projected(second.corners[j], centres, axes)


def _measures(corners: Array) -> Array:
    """Lengths of intervals (n, 2, 1), areas of polygons (n, c, 2), positive counterclockwise."""
    if corners.shape[2] == 1:
        return corners[:, 1, 0] - corners[:, 0, 0]
    x, y = np.moveaxis(corners - corners[:, :1], 2, 0)
    return (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1) / 2


def _intervals(one: Array, two: Array) -> tuple[Numbers, Array]:
    """Intersections of intervals (n, 2, 1): numbers of the pairs, and ends (m, 2, 1)."""
    low = np.maximum(one.min(axis=1), two.min(axis=1))
    high = np.minimum(one.max(axis=1), two.max(axis=1))
    pairs = np.flatnonzero(high[:, 0] > low[:, 0])
    return pairs, np.stack([low, high], axis=1)[pairs]


def _polygons(one: Array, two: Array) -> tuple[Numbers, Array]:
    """Intersections of convex polygons (n, c, 2), cut into triangles or quadrilaterals as they are:
    numbers of the pairs, and corners (m, c, 2).

    The corner whose triangle with its neighbours is the smallest is cut off until as many are left;
    of equal ones that which leaves the shorter side, then that farther from the origin, then from
    the middle of the second polygon.
    So a polygon that is nearly one of these is integrated nearly like it, as where facets that lie
    on each other begin to slide: a fan of triangles would integrate by another rule.
    """
    count, size, centres = len(one), max(one.shape[1], two.shape[1]), two.mean(axis=1)
    # With a repeated corner a triangle is a quadrilateral.
    one, two = (p[:, np.minimum(np.arange(size), p.shape[1] - 1)] for p in (one, two))
    polygons, counts = clipped(_counterclockwise(one), _counterclockwise(two))
    most = polygons.shape[1] - size + 1
    found, numbers = np.empty((count, most, size, 2)), np.empty(count, dtype=np.int64)
    given = polygons, counts, np.ascontiguousarray(centres), np.array([_EQUAL])
    call(_module(size), "pieces", *given, found, numbers)
    return np.repeat(np.arange(count), numbers), found[np.arange(most) < numbers[:, None]]


def _followed(corners: Array, one: Array, two: Array) -> Array:
    """The products of :meth:`Segments.follows` for corners (n, c, d - 1) of intersections of
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
