"""Quadrature points on the segments of two surfaces, each with a place in both cells."""

from __future__ import annotations

from typing import NamedTuple

import basix
import basix.ufl
import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from ..base.parallel import global_any
from ..domain.shapes import determinants
from ..forms.geometry import CARTESIAN, Geometry
from .facet_places import FacetPlaces, FacetPolynomials
from .pairing import PairedFacets
from .points import Points

Array = NDArray[np.float64]

#: Kinds of segments by their number of corners.
_KINDS = {
    2: basix.CellType.interval,
    3: basix.CellType.triangle,
    4: basix.CellType.quadrilateral,
}

#: Room for points of surfaces that slide, relative to their number, and least number.
_ROOM, _FEW = 2.0, 64

#: Gaps below this, relative to the facet, are rounding.
NO_GAP = 1e-10

#: Area at a point, relative to the largest one of its segment, below which it is rounding.
_FLAT = 1e-12


class Rule(NamedTuple):
    """Points and weights on segments of one shape."""

    corners: Array  # Shares of the corners in the places of the points (nq, c)
    slopes: Array  # Their derivatives in the reference shape (d - 1, nq, c)
    weights: Array  # Weights in the reference shape (nq,)

    @classmethod
    def of(cls, kind: basix.CellType, points: Array, weights: Array) -> Rule:
        corners, *slopes = basix.ufl.element("Lagrange", kind, 1).tabulate(1, points)
        return cls(corners, np.array(slopes), weights)


def rule_with_corners(kind: basix.CellType, degree: int) -> Rule:
    """Positive weights and a point at every corner, exact to a degree; on triangles above degree 4
    the rule of Gauss.

    Bodies that touch with a corner do so in a point: between points of Gauss it would sink in.
    Intervals and quadrilaterals have the rule of Lobatto. On triangles corners and centre, with
    weights 1/12 and 3/4 of the area, are exact to degree 2. Corners, middles of the sides and
    (b, b, 1 - 2 b) are exact to degree 4 if they are so for 1, e_2 = L_1 L_2 + L_2 L_3 + L_3 L_1,
    e_3 = L_1 L_2 L_3 and e_2^2, whose means are 1, 1/4, 1/60 and 1/15: 9 b^2 - 7 b + 1 = 0, and the
    weights of all three points are w = 1/(60 b^2 (1 - 2 b)) inside, v = 1 - 4 w b (2 - 3 b) in the
    middles and 1 - v - w at the corners.
    """
    if kind in (basix.CellType.interval, basix.CellType.quadrilateral):
        return Rule.of(kind, *basix.make_quadrature(kind, degree, rule=basix.QuadratureType.gll))
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    if degree <= 2:
        points = np.append(corners, [[1 / 3, 1 / 3]], axis=0)
        return Rule.of(kind, points, np.array([1 / 24, 1 / 24, 1 / 24, 3 / 8]))
    if degree <= 4:
        b = (7 - np.sqrt(13.0)) / 18
        inside = 1 / (60 * b**2 * (1 - 2 * b))
        middles = 1 - 4 * inside * b * (2 - 3 * b)
        points = np.concatenate([corners, (1 - corners) / 2, b + (1 - 3 * b) * corners])
        weights = np.array([1 - middles - inside, middles, inside])
        return Rule.of(kind, points, np.repeat(weights / 6, 3))
    return Rule.of(kind, *basix.make_quadrature(kind, degree))


class Shifts(NamedTuple):
    """How points of side 1 move within the planes of their segments where side 2 moves by g + h.v
    relative to side 1, v from the point, by components in the plane.

    Attributes:
        place, place_slope: Change of the place by g (nq, d - 1, d - 1), and by h (nq, d - 1, d - 1,
            d - 1).
        area, area_slope: Change of dA, relative to it, by g (nq, d - 1), and by h (nq, d - 1,
            d - 1).
    """

    place: Array
    place_slope: Array
    area: Array
    area_slope: Array


class PairPoints(Points):
    """The segments of an interface and their quadrature points.

    Point p of side 1 and its partner on side 2 have one projection into the plane of the segment,
    along the normal of the facet of side 1. Quadrilaterals may be triangles with a repeated corner.
    Contact of bodies that slide has points at the corners of segments, all others have those of
    Gauss.
    """

    facets: PairedFacets

    def __init__(
        self, mesh: Mesh, facets: PairedFacets, degree: int, geometry: Geometry = CARTESIAN
    ):
        self.mesh, self.geometry = mesh, geometry
        self.d = mesh.geometry.dim
        self.degree = degree
        corners = facets.segments.corners.shape[1]
        kind = _KINDS[corners]
        self._order = [0, 1, 3, 2] if corners == 4 else list(range(corners))
        law = facets.surfaces.law
        gauss = law.has_bond or not law.inelastic or not facets.slides
        given = basix.make_quadrature(kind, degree)
        self._rule = Rule.of(kind, *given) if gauss else rule_with_corners(kind, degree)
        # Products of two displacements are integrated exactly.
        size = len(self._rule.weights), (degree + 1) // 2
        self._polynomials = [FacetPolynomials(mesh, side, *size) for side in facets.surfaces.sides]
        self._room = -1
        self.take(facets)

    def take(self, facets: PairedFacets, u: fem.Function | None = None) -> bool:
        """Take other pairs; whether evaluators and functions of points must be made again, as on
        some rank there are more points than room; collective."""
        self.facets, segments, d = facets, facets.segments, self.d
        corners = segments.corners[:, self._order]
        rule = self._rule
        plane = rule.corners @ corners
        areas = np.abs(determinants(_edges(rule, corners))) * rule.weights
        one, two = (self._places_of(facets, plane, a, u) for a in range(2))
        around, longer = (self._circumference(side.positions) for side in (one, two))
        count = areas.size
        self.points = np.zeros((count, 3))
        self.points[:, :d] = one.positions.reshape(-1, d)
        self.weights = (areas * one.stretch * around).ravel()
        ratio = two.stretch / one.stretch
        # On an axis both are zero, and their ratio is that of the stretches.
        off = around > _FLAT * around.max(axis=1, keepdims=True)
        ratio *= np.divide(longer, around, out=ratio.copy(), where=off)
        both = one.normals, two.normals * ratio[..., None]
        self.outward = np.stack([normals.reshape(-1, d) for normals in both])
        self.points_of_facet = np.arange(count, dtype=np.int32).reshape(areas.shape)
        self.facet = np.repeat(np.arange(len(areas), dtype=np.int32), areas.shape[1])
        second = facets.second_leads[self.facet]
        self.normal = np.where(second[:, None], -two.normals.reshape(-1, d), self.outward[0])
        self.leads = np.full((count, 2), 0.5)
        if facets.slides:
            self.leads = 1.0 * np.stack([~second, second], axis=1)
        self.area = self.weights.reshape(areas.shape).sum(axis=1)
        self.extent = facets.extent
        gap = (two.positions - one.positions).reshape(-1, d)
        if facets.surfaces.gaps:
            # Where surfaces slide, a bond spans their distance, as if they touched.
            bonded = (self.facet < facets.bonded)[:, None]
            self.distance = np.where(bonded, 0.0, gap)
            if facets.surfaces.law.has_bond:
                self.initial_gap = np.where(bonded, gap, 0.0)
        else:
            large = np.abs(gap).max(initial=0.0) > NO_GAP * self.extent.max(initial=0.0)
            # Frames and forms are the same on all ranks, and in all states.
            if self.initial_gap is not None or global_any(self.mesh.comm, large):
                self.initial_gap = gap
        full = global_any(self.mesh.comm, count > self._room)
        if full:
            self._room = max(int(_ROOM * count), _FEW) if facets.slides else count
        self._take_places(one.reference, two.reference, self._room if full else None)
        return full

    def shifts(self) -> Shifts:
        """How points move with side 2; not with a bond."""
        segments, order, t = self.facets.segments, self._order, self.d - 1
        corners, follows = segments.corners[:, order], segments.follows()[:, order]
        follows[: self.facets.bonded] = 0.0
        rule = self._rule
        places = rule.corners @ corners
        edges = _edges(rule, corners)
        # At a corner between sides in one line there is no area.
        area = np.abs(determinants(edges))
        flat = area <= _FLAT * area.max(axis=1, keepdims=True)
        edges[flat] = np.eye(t)
        slopes = np.einsum("tqc,sqkt->sqck", rule.slopes, np.linalg.inv(edges))
        slopes[flat] = 0.0
        # Sums over the corners of what follows, and of its products with their places.
        each = follows.reshape(*follows.shape[:2], t * t)
        both = each[..., None] * corners[:, :, None]
        shape = *places.shape[:2], t, t
        place = (rule.corners @ each).reshape(shape)
        product = rule.corners @ both.reshape(*each.shape[:2], t**3)
        place_slope = product.reshape(*shape, t) - place[..., None] * places[:, :, None, None]
        grown = np.einsum("sqck,sckl->sqlc", slopes, follows, optimize=True)
        area = grown.sum(axis=3)
        area_slope = grown @ corners[:, None] - area[..., None] * places[:, :, None]
        found = place, place_slope, area, area_slope
        return Shifts(*(array.reshape(-1, *array.shape[2:]) for array in found))

    def _circumference(self, positions: Array) -> Array:
        """At points (ns, nq, d), in axisymmetry; else 1 (ns, nq)."""
        around = self.geometry.circumference(np.moveaxis(positions, 2, 0))
        return np.broadcast_to(around, positions.shape[:2])

    def _places_of(
        self, facets: PairedFacets, plane: Array, a: int, u: fem.Function | None
    ) -> FacetPlaces:
        """Places on side ``a`` of all points, of leading pairs in the reference configuration."""
        polynomials, segments = self._polynomials[a], facets.segments
        whole = (segments.first, segments.second)[a]
        if not facets.bonded:
            return polynomials.places(whole, segments, plane, u)
        parts = []
        for rows, given in ((slice(0, facets.bonded), None), (slice(facets.bonded, None), u)):
            where = segments.rows(rows)
            parts.append(polynomials.places(whole[rows], where, plane[rows], given))
        return FacetPlaces(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))

    @property
    def kept(self) -> slice:
        """The points that stay in a step: where surfaces slide those of the bond."""
        if not self.facets.slides:
            return slice(None)
        return slice(self.facets.bonded * self.points_of_facet.shape[1])


def _edges(rule: Rule, corners: Array) -> Array:
    """Tangents of the plane at the points of segments with these corners (ns, nq, d - 1, d - 1),
    by reference coordinate first."""
    return np.einsum("tqc,sck->sqtk", rule.slopes, corners)
