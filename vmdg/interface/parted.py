"""Facets of a bonded surface that have lost their partner, where bodies slide.

The area of a bond is that of its pairs in the reference configuration, by facets of side 1. What no
pair covers any more is broken and free: its traction is zero, and its opening is the way to the
nearest point of side 2, however far that is.
"""

from __future__ import annotations

import numpy as np
import scipy
from dolfinx import fem
from numpy.typing import NDArray

from ..laws import Mode
from ..points.pair_points import PairPoints
from ..points.segments import FlatFacets
from .values import InterfaceState

Array = NDArray[np.float64]

#: Least share of a facet that counts as lost: polygons that turn along each other leave less.
_LEAST = 0.01


class BondedArea:
    """The area of a bond by facets of side 1, this rank's; zero where nothing was bonded.

    Attributes:
        whole: The area [mm2; mm in plane strain].
    """

    def __init__(self, quadrature: PairPoints):
        self._surfaces = quadrature.facets.surfaces
        self._areas, self._moments = self._covered(quadrature)
        bonds = self._surfaces.law.has_bond
        self._areas, self._moments = bonds * self._areas, bonds * self._moments
        self.whole = float(self._areas.sum())

    def _covered(self, quadrature: PairPoints) -> tuple[Array, Array]:
        """Area that pairs cover (n,), and the integral of X (n, d), by facets of side 1."""
        first = quadrature.facets.segments.first[quadrature.facet]
        count, dX = len(self._surfaces.sides[0].facets), quadrature.weights
        X = quadrature.points[:, : quadrature.d]
        sums = [np.bincount(first, dX * x, minlength=count) for x in (1.0, *X.T)]
        return sums[0], np.transpose(sums[1:])

    def parted(self, quadrature: PairPoints, u: fem.Function) -> InterfaceState:
        """A row for every facet with a part that has lost its partner, in the middle of it."""
        surfaces, d = self._surfaces, quadrature.d
        areas, moments = self._covered(quadrature)
        lost = self._areas - areas
        rows = np.flatnonzero(lost > _LEAST * self._areas)
        if not len(rows):
            return InterfaceState.empty(d)
        before, (now, other) = surfaces.reference[0].rows(rows), surfaces.flat(u)
        now, weights = now.rows(rows), lost[rows]
        axes = np.tile(np.eye(d)[:, None], (len(rows), 1))
        middle = (self._moments - moments)[rows] / weights[:, None]
        R = np.stack([turned(e, before.normals, now.normals) for e in axes], axis=2)
        way = np.einsum("pij,pj->pi", R, middle - before.centres)
        opening = to_nearest(now.centres + way, other)
        count, law = len(rows), surfaces.law.at(rows)
        points = np.zeros((count, 3))
        points[:, :d] = middle
        return InterfaceState(
            points=points,
            weights=weights,
            normal=before.normals,
            opening=opening,
            gap=opening,
            softening=np.array(np.broadcast_to(law.strength, count), dtype=float),
            traction=np.zeros((count, d)),
            mode=np.full(count, Mode.OPEN, dtype=np.int8),
            rotation=R,
            facet=surfaces.sides[0].facets[rows],
            damage=np.ones(count),
        )


def turned(vectors: Array, start: Array, end: Array) -> Array:
    """Vectors (n, d) in the rotation that takes unit vectors to others (n, d) the shortest way;
    opposite ones by reflection."""
    both = start + end
    # Nearest points may be on the back of a thin body.
    size = np.maximum(1 + np.einsum("pi,pi->p", start, end), np.finfo(float).eps)
    along = np.einsum("pi,pi->p", both, vectors) / size
    through = 2 * np.einsum("pi,pi->p", start, vectors)
    return vectors - along[:, None] * both + through[:, None] * end


def to_nearest(points: Array, facets: FlatFacets) -> Array:
    """The way from points (n, d) to the nearest point of a surface (n, d) [mm]."""
    nearest = scipy.spatial.cKDTree(facets.centres).query(points)[0]
    # The centre of the facet with the nearest point is no farther than this.
    most = nearest + facets.radii.max()
    near = scipy.spatial.cKDTree(facets.centres).query_ball_point(points, most * (1 + 1e-12))
    counts = np.array([len(some) for some in near])
    p, f = np.repeat(np.arange(len(points)), counts), np.concatenate(near).astype(np.intp)
    ways = _ways(points[p], facets.rows(f))
    order = np.lexsort((np.linalg.norm(ways, axis=1), p))
    return ways[order][np.cumsum(counts) - counts]


def _ways(points: Array, facets: FlatFacets) -> Array:
    """The way from each point (n, d) to the nearest point of its facet (n, d)."""
    corners, x = facets.corners, points[:, None]
    along = np.roll(corners, -1, axis=1) - corners
    square = np.maximum(np.einsum("fci,fci->fc", along, along), np.finfo(float).tiny)
    share = np.clip(np.einsum("fci,fci->fc", x - corners, along) / square, 0.0, 1.0)
    to_sides = corners + share[..., None] * along - x
    best = np.linalg.norm(to_sides, axis=2).argmin(axis=1)
    ways = to_sides[np.arange(len(points)), best]
    if points.shape[1] == 3:
        axes = facets.axes
        flat = np.einsum("fki,fci->fck", axes, corners - x)
        a, b = flat, np.roll(flat, -1, axis=1)
        turn = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        inside = (turn >= 0).all(axis=1) | (turn <= 0).all(axis=1)
        height = np.einsum("fi,fi->f", facets.centres - points, facets.normals)
        ways[inside] = height[inside, None] * facets.normals[inside]
    return ways
