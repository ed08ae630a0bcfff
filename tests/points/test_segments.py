"""Facets of two surfaces cut into segments: exact areas, whatever their ratio."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest
from basix import CellType
from support.problems import rotation

from vmdg.points.pair_points import rule_with_corners
from vmdg.points.segments import FlatFacets, clipped, cut, inside, passed


def line(count: int, up: bool, length: float = 1.0, slope: float = 0.0) -> FlatFacets:
    """Facets of a straight line whose body is below or above it."""
    x = np.linspace(0.0, length, count + 1)
    points = np.stack([x, slope * x], axis=1)
    corners = np.stack([points[:-1], points[1:]], axis=1)
    return FlatFacets.of(corners, corners.mean(axis=1) + [0.0, 1.0 if up else -1.0])


def plane(count: int, up: bool, triangles: bool, turn: float = 0.0) -> FlatFacets:
    """Facets of the unit square, turned about its centre, at the height 0."""
    x = np.linspace(-0.5, 0.5, count + 1)
    a, b = (g[:-1, :-1].ravel() for g in np.meshgrid(x, x, indexing="ij"))
    h = 1 / count
    corners = np.stack(
        [np.stack([a + h * i, b + h * j], axis=1) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))],
        axis=1,
    )
    if triangles:
        corners = np.concatenate([corners[:, :3], corners[:, [0, 2, 3]]])
    c, s = np.cos(turn), np.sin(turn)
    corners = corners @ np.array([[c, s], [-s, c]])
    corners = np.concatenate([corners, np.zeros((*corners.shape[:2], 1))], axis=2)
    return FlatFacets.of(corners, corners.mean(axis=1) + [0.0, 0.0, 1.0 if up else -1.0])


@pytest.mark.parametrize("turn", [0.1, 0.7])
def test_turned_planes(turn):
    """A square turned over another one: the area of their intersection, an octagon."""
    found = cut(plane(3, False, True), plane(4, True, False, turn))
    # What a half plane at the distance 1/2 cuts from a corner of the square, eight right triangles.
    c, s = np.cos(turn), np.sin(turn)
    corner = (c + s - 1) ** 2 / (2 * c * s) / 4
    assert found.measures.sum() == pytest.approx(1 - 4 * corner, abs=1e-14)


@pytest.mark.parametrize("triangles", [True, False])
@pytest.mark.parametrize(
    ("way", "angle"),
    [("turned", 0.0), ("turned", 0.3), ("mirrored", 0.3), ("counted", 0.0), ("counted", 0.3)],
)
def test_pieces_are_of_the_facets_alone(triangles, way, angle):
    """The same segments of the same facets, whatever their axes and the order of their corners;
    mirrored, if the facets are not their own images."""
    sides = plane(3, False, triangles), plane(4, True, triangles, angle)
    turn = {"turned": rotation(3, 0.7), "mirrored": np.diag([1.0, -1.0, 1.0])}.get(way, np.eye(3))
    shift, found = int(way == "counted"), []
    for by, start in ((np.eye(3), 0), (turn, shift)):
        corners = (np.roll(side.corners @ by.T, start, axis=1) for side in sides)
        moved = [FlatFacets(c, s.normals @ by.T) for c, s in zip(corners, sides, strict=True)]
        cuts = cut(*moved)
        corners = cuts.origins[:, None] + np.einsum("nck,nkd->ncd", cuts.corners, cuts.axes)
        at = np.sort(corners @ by @ [1.0, np.pi, 0.0], axis=1)
        found.append(at[np.lexsort([*np.round(at, 6).T, cuts.second, cuts.first])])
    assert found[1] == pytest.approx(found[0], abs=1e-12)


def test_curved_line():
    """Two polygons along one circle: those of side 1 are covered whole, along their normals."""

    def polygon(count, inner):
        angle = np.linspace(0, 2 * np.pi, count + 1)
        points = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        corners = np.stack([points[:-1], points[1:]], axis=1)
        return FlatFacets.of(corners, corners.mean(axis=1) * (0.5 if inner else 1.5))

    for count, other in ((8, 12), (12, 8), (9, 40), (40, 9)):
        first, second = polygon(count, True), polygon(other, False)
        found = cut(first, second)
        lengths = np.bincount(found.first, found.measures, minlength=count)
        assert np.abs(lengths - first.measures).max() < 1e-15


def test_clipping():
    """Polygons inside, outside, around and across a window."""
    window = np.tile([[0.0, 0], [1, 0], [1, 1], [0, 1]], (5, 1, 1))
    square = window[0]
    others = [
        0.5 * square + 0.25,
        square + 2.0,
        3 * square - 1.0,
        square + [0.5, 0.25],
        square[[0, 1, 2, 2]] - [0.5, 0.0],
    ]
    corners, counts = clipped(window, np.array(others))
    areas = []
    for polygon, count in zip(corners, counts, strict=True):
        x, y = polygon[:count].T
        areas.append(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)
    assert areas == pytest.approx([0.25, 0.0, 1.0, 0.375, 0.375], abs=1e-15)


def joined(*parts: FlatFacets) -> FlatFacets:
    arrays = zip(*((part.corners, part.normals) for part in parts), strict=True)
    return FlatFacets(*map(np.concatenate, arrays))


def film(
    count: int, low: float, high: float, length: float = 1.0, start: float = 0.0
) -> FlatFacets:
    """The closed surface of a rectangle: top, bottom, and ends of one facet each."""
    across = line(count, True, length).corners + [start, 0.0]
    ends = np.array([[[x, low], [x, high]] for x in (start, start + length)])
    corners = np.concatenate([across + [0.0, high], across + [0.0, low], ends])
    inside = corners.mean(axis=1)
    inside[: 2 * count, 1] = (low + high) / 2
    inside[2 * count :, 0] = start + length / 2
    return FlatFacets.of(corners, inside)


@pytest.mark.parametrize("gap", [-0.04, 0.0, 0.03, 5.0])
@pytest.mark.parametrize("counts", [(1, 1), (2, 3), (50, 70)])
def test_fronts_of_thin_bodies(gap, counts):
    """Films of .05 and .08 mm, apart by any distance or in each other, in facets of any length:
    their fronts are paired, not their backs nor their ends."""
    lower, upper = film(counts[0], -0.05, 0.0), film(counts[1], gap, gap + 0.08)
    found = cut(lower, upper)
    assert found.measures.sum() == pytest.approx(1.0, rel=1e-13)
    assert found.away == pytest.approx(gap, abs=1e-14)
    assert (lower.normals[found.first] == [0.0, 1.0]).all()


def test_first_in_sight():
    """A body between two others hides the far one; its back is behind it, though it faces it."""
    middle = film(3, 0.1, 0.2)
    both = joined(film(4, 0.5, 0.6), film(2, -0.3, 0.0))
    found = cut(middle, both)
    up = middle.normals[found.first, 1] > 0
    assert found.measures[up].sum() == pytest.approx(1.0, rel=1e-13)
    assert found.away[up] == pytest.approx(0.3, rel=1e-13)
    assert found.away[~up] == pytest.approx(0.1, rel=1e-13)
    hidden = cut(film(3, -2.0, -1.0), joined(both, middle))
    assert found.measures.sum() == pytest.approx(2.0, rel=1e-13)
    assert hidden.away == pytest.approx(0.7, rel=1e-13)


def test_shallow_overlap():
    """Two blocks of one width, one .01 mm in the other, a little wider or not: their sides, which
    are 1 mm from each other through both bodies, are no pair; nor are the ends of a pin of .1 mm in
    a slot of .098 mm those of what it is in."""
    for wider in (0.0, 1e-6, 1e-3):
        lower, upper = film(10, -1.0, 0.0, 1 + 2 * wider, -wider), film(12, -0.01, 1.0)
        found = cut(lower, upper)
        assert found.away == pytest.approx(-0.01, rel=1e-12)
        assert found.measures.sum() == pytest.approx(1.0, rel=1e-12)
    slot = joined(film(7, -0.5, -0.049, 1.0), film(7, 0.049, 0.5, 1.0))
    pin = film(9, -0.05, 0.05, 1.3, -0.2)
    found = cut(pin, slot)
    assert found.away == pytest.approx(-0.001, rel=1e-9)
    assert found.measures.sum() == pytest.approx(2.0, rel=1e-12)


def test_inside_without_a_partner():
    """A film that has sunk into a block as a whole is no pair, and inside by its depth; where its
    front is paired, or is far away, nothing is."""
    block = film(8, -1.0, 0.0)
    for low, expected in ((-0.3, 0.3), (-0.02, 0.0), (0.1, 0.0)):
        sheet = film(4, low, low + 0.05, 0.5, 0.25)
        found = cut(block, sheet)
        alone = np.setdiff1d(np.arange(len(sheet.corners)), found.second)
        paired = np.unique(found.first)
        deepest = -found.away.min(initial=0.0)
        depth = inside(sheet.rows(alone), block, paired, deepest)
        assert depth.max(initial=0.0) == pytest.approx(expected, abs=1e-12)


def test_passed():
    """A thin film that has gone through another, in one step: whatever the way; not one that has
    gone past it, nor what both bodies do together."""
    still = film(6, 0.0, 0.01)
    start = film(3, 0.1, 0.11, 0.4, 0.3)

    def moved(facets, way, turn=0.0):
        c, s = np.cos(turn), np.sin(turn)
        Q = np.array([[c, s], [-s, c]])
        return FlatFacets(facets.corners @ Q + way, facets.normals @ Q)

    for way, expected in (
        ((0.0, -0.2), True),
        ((0.2, -0.4), True),
        ((0.0, 0.3), False),
        ((2.0, -0.4), False),
        ((0.0, -0.05), False),
    ):
        now = moved(start, np.array(way))
        assert passed(now, still, (start, still)) == expected
        turned = [moved(each, np.array([3.0, 1.0]), 0.5) for each in (now, still)]
        assert passed(*turned, (start, still)) == expected


def test_not_opposite():
    """Neither far surfaces, where distances are limited, nor those with parallel normals, nor
    perpendicular ones."""
    first, far = line(3, False), line(4, True)
    far = FlatFacets(far.corners + [0.0, 0.2], far.normals)
    assert len(cut(first, far).first) and not len(cut(first, far, most=0.1).first)
    across = FlatFacets.of(
        line(4, True).corners[..., ::-1], line(4, True).centres[:, ::-1] - [1.0, 0.0]
    )
    for second in (line(4, False), across):
        assert not len(cut(first, second).first)


def test_rules_with_corners():
    """Weights are positive, every corner is a point, and polynomials of the degree are exact."""
    triangle = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    square = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    for corners, rule, most in (
        (triangle[:2, :1], rule_with_corners(CellType.interval, 2), 3),
        (triangle[:2, :1], rule_with_corners(CellType.interval, 4), 5),
        (triangle, rule_with_corners(CellType.triangle, 2), 2),
        (triangle, rule_with_corners(CellType.triangle, 4), 4),
        (square, rule_with_corners(CellType.quadrilateral, 2), 3),
    ):
        places = rule.corners @ corners
        assert (rule.weights > 0).all()
        away = np.abs(corners[:, None] - places).max(axis=2)
        assert away.min(axis=1).max() < 1e-15
        d = places.shape[1]
        for powers in np.ndindex(*d * (most + 1,)):
            exact = np.prod([1 / (1 + k) for k in powers])
            if len(corners) == 3:
                if sum(powers) > most:
                    continue
                one, two = powers
                exact = factorial(one) * factorial(two) / factorial(one + two + 2)
            found = rule.weights @ (places ** np.array(powers)).prod(axis=1)
            assert found == pytest.approx(exact, abs=4e-15)


def test_sixty_degrees_are_opposite():
    """However axes are turned, as rounding of the cosine must not decide."""
    low, high = line(6, up=False), line(5, up=True, slope=np.tan(np.pi / 3))
    for angle in np.linspace(0.0, 2 * np.pi, 24):
        turn = rotation(2, angle)
        one, two = (FlatFacets(s.corners @ turn.T, s.normals @ turn.T) for s in (low, high))
        assert cut(one, two).measures.sum() == pytest.approx(1.0)
