"""Power diagrams of a square or cube, periodic or not; Voronoi diagrams for equal weights."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy
from numpy.typing import NDArray

from vmdg.base.graph import components

from .packing import at_images, shifts_of, well_cut

#: Number of neighbours whose planes may bound a cell, by dimension; the sum of volumes is checked.
NEAREST = {2: 60, 3: 150}

#: Tolerance relative to the cell size, for intersecting planes, coincident points, thick bodies.
SMALL = 1e-9

#: Distance of corners from the plane of a face, relative to the cell size, that makes it bent.
BENT = 1e-6

#: Grain, corners, and the numbers of the corners of every face.
Piece = tuple[int, NDArray[np.float64], list[NDArray[np.int64]]]


@dataclass(frozen=True)
class Tessellation:
    """Grains of a cell [0, size]^d; a grain cut by the sides of a periodic cell has several pieces.

    Attributes:
        points: Corners (n, d) [mm].
        pieces: Grain of every piece, from 0, and its faces: numbers of their corners in order (two
            in 2D).
        image: For points on a high side, the number of their image on the low side, along every
            axis (n, d); for others their own.
    """

    points: NDArray[np.float64]
    pieces: list[tuple[int, list[tuple[int, ...]]]]
    image: NDArray[np.int64]


def tessellate(
    seeds: NDArray[np.float64],
    weights: NDArray[np.float64],
    size: float,
    periodic: bool,
    shortest: float,
) -> Tessellation:
    """Cells {x: |x - s|^2 - w is minimal} of seeds s with weights w, cut by the sides.

    Edges shorter than ``shortest`` become points; in 3D, faces that this bends become triangles. A
    periodic diagram is shifted so that its sides keep a distance from corners.

    Args:
        weights: (n,) [mm2]; equal ones for Voronoi cells.
    """
    planes = _bounded(seeds, weights, size, periodic)
    if periodic:
        corners = [_corners_of_cell(own) for own in planes]
        there = np.concatenate(corners).T
        low = well_cut(list(there), size, lambda x: _from_boundaries(x, seeds, weights, size))
        middles = np.array([x.mean(axis=0) for x in corners]) - low
        planes = [
            _moved(own, -low - size * np.floor(middle / size))
            for own, middle in zip(planes, middles, strict=True)
        ]
    pieces = list(_pieces(planes, size, seeds.shape[1], periodic))
    return _joined(pieces, size, periodic, shortest)


def _from_boundaries(
    x: NDArray[np.float64], seeds: NDArray[np.float64], weights: NDArray[np.float64], size: float
) -> float:
    """Distance of a point from the boundary between the two cells nearest to it [mm]."""
    shifts = shifts_of(seeds.shape[1], size)
    apart = at_images(seeds, shifts) - x
    power = (apart**2).sum(axis=1) - np.tile(weights, len(shifts))
    one, two = np.argsort(power)[:2]
    return (power[two] - power[one]) / (2 * np.linalg.norm(apart[two] - apart[one]))


def _bounded(
    seeds: NDArray[np.float64], weights: NDArray[np.float64], size: float, periodic: bool
) -> list[NDArray[np.float64]]:
    """Planes (m, d + 1) around the cell of every seed, n.x + c <= 0 inside."""
    count, dim = seeds.shape
    shifts = shifts_of(dim, size, periodic)
    everywhere = at_images(seeds, shifts)
    heavy = np.tile(weights, len(shifts))
    near = scipy.spatial.cKDTree(everywhere).query(seeds, min(NEAREST[dim] + 1, len(everywhere)))[1]
    cells, volume = [], 0.0
    for n, others in enumerate(near.reshape(count, -1)):
        others = others[others != n]
        apart = everywhere[others] - seeds[n]
        middle = (everywhere[others] ** 2).sum(axis=1) - (seeds[n] ** 2).sum()
        offset = (middle - heavy[others] + weights[n]) / 2
        planes = np.column_stack([apart, -offset]) / np.linalg.norm(apart, axis=1)[:, None]
        if not periodic:
            planes = np.concatenate([planes, _box(dim, size)])
        corners, active = _corners(planes)
        if corners is None:
            raise ValueError(
                f"tessellate: the weight of seed {n} leaves it no cell; weights that differ less"
            )
        volume += scipy.spatial.ConvexHull(corners).volume
        cells.append(planes[np.unique(np.concatenate(active))])
    if abs(volume / size**dim - 1) > 1e-6:
        raise ValueError(
            f"tessellate: the cells fill {volume / size**dim:.6f} of the square; weights differ so "
            f"much that cells have more than {NEAREST[dim]} close neighbours"
        )
    return cells


def _moved(planes: NDArray[np.float64], shift: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([planes[:, :-1], planes[:, -1] - planes[:, :-1] @ shift])


def _box(dim: int, size: float) -> NDArray[np.float64]:
    """Planes of [0, size]^dim, low ones first (2 dim, dim + 1)."""
    one = np.eye(dim)
    low, high = np.column_stack([-one, np.zeros(dim)]), np.column_stack([one, np.full(dim, -size)])
    return np.concatenate([low, high])


def _corners_of_cell(planes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners (k, d) of a non-empty body."""
    corners, _ = _corners(planes)
    assert corners is not None
    return corners


def _corners(
    planes: NDArray[np.float64], least: float = 0.0
) -> tuple[NDArray[np.float64] | None, list[list[int]]]:
    """Corners (k, d) of the body inside unit planes, and the planes that meet in each.

    None if no ball of radius above ``least`` fits inside.
    """
    dim = planes.shape[1] - 1
    # The largest ball inside: n.x + radius <= -c.
    ball = scipy.optimize.linprog(
        [*[0.0] * dim, -1.0],
        A_ub=np.column_stack([planes[:, :-1], np.ones(len(planes))]),
        b_ub=-planes[:, -1],
        bounds=[*[(None, None)] * dim, (0, None)],
    )
    if ball.status != 0 or ball.x[-1] <= least:
        return None, []
    found = scipy.spatial.HalfspaceIntersection(planes, ball.x[:-1])
    return found.intersections, found.dual_facets


def _pieces(
    planes: list[NDArray[np.float64]], size: float, dim: int, periodic: bool
) -> Iterator[Piece]:
    """Grain, corners and faces (corners in order) of all pieces in the cell."""
    shifts = shifts_of(dim, size, periodic)
    box = _box(dim, size)
    for grain, own in enumerate(planes):
        around = _corners_of_cell(own)
        low, high = around.min(axis=0), around.max(axis=0)
        for shift in shifts:
            if ((low + shift >= size) | (high + shift <= 0)).any():
                continue
            cut = np.concatenate([_moved(own, shift), box])
            corners, active = _corners(cut, SMALL * size)
            if corners is None:
                continue
            faces = []
            for plane in range(len(cut)):
                on = np.array([n for n, met in enumerate(active) if plane in met], dtype=np.int64)
                if len(on) >= dim:
                    faces.append(_in_order(corners, on, cut[plane, :-1]))
            yield grain, corners, faces


def _in_order(
    corners: NDArray[np.float64], on: NDArray[np.int64], normal: NDArray[np.float64]
) -> NDArray[np.int64]:
    if len(normal) == 2:
        return on
    arms = corners[on] - corners[on].mean(axis=0)
    first = arms[np.argmax((arms**2).sum(axis=1))]
    return on[np.argsort(np.arctan2(arms @ np.cross(normal, first), arms @ first))]


def _joined(pieces: list[Piece], size: float, periodic: bool, shortest: float) -> Tessellation:
    """Pieces that share their corners; edges below ``shortest`` become points.

    Where a piece would be inverted or a grain boundary be moved onto a side, edges are kept, the
    longest first.
    """
    corners = np.concatenate([x for _, x, _ in pieces])
    low, high = (np.abs(corners - side) < 10 * SMALL * size for side in (0, size))
    corners = np.where(low, 0.0, np.where(high, size, corners))
    tree = scipy.spatial.cKDTree(
        corners % size if periodic else corners, boxsize=size if periodic else None
    )
    one = _classes(len(corners), tree.query_pairs(100 * SMALL * size, output_type="ndarray"))
    starts = np.cumsum([0, *(len(x) for _, x, _ in pieces)])[:-1]
    pairs = _short_edges(pieces, starts, corners, one, shortest)
    alone = np.bincount([grain for grain, _, _ in pieces]) == 1
    while True:
        group = _classes(one.max() + 1, pairs)
        stay = np.zeros(len(pairs), dtype=bool)
        for astray in _astray(group[one], low | high):
            stay[np.flatnonzero(group[pairs[:, 0]] == astray)[-1]] = True
        if not stay.any():
            points, number, image = _shared(corners, group[one], (low, high), size, periodic)
            joined, faces_of = [], _Faces(points, size)
            for (grain, x, faces), start in zip(pieces, starts, strict=True):
                around = [_without_repeats(number[start + face]) for face in faces]
                kept = [n for n, face in enumerate(around) if len(face) >= points.shape[1]]
                around, outward = [around[n] for n in kept], [_sense(x, faces[n]) for n in kept]
                if not alone[grain] and faces_of.vanish(around):
                    continue
                if not faces_of.enclose(around, outward):
                    touching = np.isin(pairs, one[start : start + len(x)]).any(axis=1)
                    stay[np.flatnonzero(touching)[-1]] = True
                joined.append((grain, [part for face in around for part in faces_of.flat(face)]))
            if not stay.any():
                return Tessellation(points, joined, image)
        pairs = pairs[~stay]


def _astray(joined: NDArray[np.int64], sides: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Classes whose corners lie on several sides, by axis (n, d), and none on all of these."""
    all_sides = np.zeros((joined.max() + 1, sides.shape[1]), dtype=bool)
    np.logical_or.at(all_sides, joined, sides)
    return np.setdiff1d(joined, joined[(sides == all_sides[joined]).all(axis=1)])


def _classes(count: int, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """Class of every item (count,): items connected by a chain of pairs (n, 2)."""
    return components(pairs[:, 0], pairs[:, 1], count).astype(np.int64)


def _short_edges(
    pieces: list[Piece],
    starts: NDArray[np.int64],
    corners: NDArray[np.float64],
    one: NDArray[np.int64],
    shortest: float,
) -> NDArray[np.int64]:
    """Classes of the ends of short edges (n, 2), by increasing length."""
    edges = np.concatenate(
        [
            np.column_stack([face, np.roll(face, -1)]) + start
            for (_, _, faces), start in zip(pieces, starts, strict=True)
            for face in faces
        ]
    )
    length = np.linalg.norm(corners[edges[:, 0]] - corners[edges[:, 1]], axis=1)
    ends = np.sort(one[edges], axis=1)
    short = np.flatnonzero((length < shortest) & (ends[:, 0] != ends[:, 1]))
    short = short[np.argsort(length[short], kind="stable")]
    first = np.unique(ends[short], axis=0, return_index=True)[1]
    return ends[short[np.sort(first)]]


class _Faces:
    """Faces between points that may have moved."""

    def __init__(self, points: NDArray[np.float64], size: float):
        self._points, self._size = points, size
        self._parts: dict[frozenset[int], list[tuple[int, ...]]] = {}

    def flat(self, face: tuple[int, ...]) -> list[tuple[int, ...]]:
        key = frozenset(face)
        if key not in self._parts:
            bent = len(face) > 3 and not self._on_side(face)
            if bent:
                x = self._points[list(face)]
                height = np.linalg.svd(x - x.mean(axis=0))[2][-1]
                bent = np.abs((x - x.mean(axis=0)) @ height).max() > BENT * self._size
            self._parts[key] = _triangles(face, self._points) if bent else [face]
        return self._parts[key]

    def _on_side(self, face: tuple[int, ...]) -> bool:
        x = self._points[list(face)]
        return bool(((x == 0).all(axis=0) | (x == self._size).all(axis=0)).any())

    def vanish(self, around: list[tuple[int, ...]]) -> bool:
        """Whether faces enclose no volume: they cover each other in pairs inside the cell."""
        times = Counter(frozenset(face) for face in around)
        return all(n == 2 and not self._on_side(tuple(face)) for face, n in times.items())

    def enclose(self, around: list[tuple[int, ...]], outward: list[int]) -> bool:
        """Whether faces still have their orientation as seen from their midpoint: they enclose a
        body."""
        if not around or any(len(set(face)) < len(face) for face in around):
            return False
        simplices = []
        for face, sense in zip(around, outward, strict=True):
            for part in self.flat(face):
                # Parts may have the opposite orientation.
                ordered = sorted(part, key=face.index)
                simplices += [
                    [ordered[0], a, b][-len(self._points[0]) :][::sense]
                    for a, b in itertools.pairwise(ordered[len(ordered) > 2 :])
                ]
        middle = self._points[list(set(itertools.chain(*around)))].mean(axis=0)
        return bool((np.linalg.det(self._points[np.array(simplices)] - middle) > 0).all())


def _sense(corners: NDArray[np.float64], face: NDArray[np.int64]) -> int:
    """Orientation of a face: 1 if the midpoint of its body is on its inner side, otherwise -1."""
    dim, arms = corners.shape[1], corners[face] - corners.mean(axis=0)
    if dim == 2:
        return 1 if np.linalg.det(arms) > 0 else -1
    area = np.cross(arms, np.roll(arms, -1, axis=0)).sum(axis=0)
    return 1 if area @ arms[0] > 0 else -1


def _triangles(face: tuple[int, ...], points: NDArray[np.float64]) -> list[tuple[int, ...]]:
    def goodness(i: int, j: int, k: int) -> float:
        x = points[[face[i], face[j], face[k]]]
        edges = x - np.roll(x, 1, axis=0)
        return float(np.linalg.norm(np.cross(edges[0], edges[1])) / (edges**2).sum())

    @cache
    def best(i: int, k: int) -> tuple[float, list[tuple[int, ...]]]:
        found: tuple[float, list[tuple[int, ...]]] = (math.inf, []) if k - i < 2 else (-1.0, [])
        for j in range(i + 1, k):
            one, two = best(i, j), best(j, k)
            least = min(goodness(i, j, k), one[0], two[0])
            if least > found[0]:
                found = least, [*one[1], *two[1], (face[i], face[j], face[k])]
        return found

    return best(0, len(face) - 1)[1]


def _shared(
    corners: NDArray[np.float64],
    one: NDArray[np.int64],
    sides: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    size: float,
    periodic: bool,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """A point for every class and every existing image of it.

    Args:
        sides: Marks of the corners on low and on high sides, each (n, d).

    Returns:
        Points (m, d), the number of the point of every corner (n,), and of every point the number
        of its image on the low side along every axis (m, d).
    """
    dim = corners.shape[1]
    # A class is at the mean of its corners, relative to its first one; on a side if a corner is.
    first = np.unique(one, return_index=True)[1]
    offset = corners - corners[first[one]]
    if periodic:
        offset -= size * np.round(offset / size)
    place = corners[first].copy()
    for axis in range(dim):
        place[:, axis] += np.bincount(one, offset[:, axis]) / np.bincount(one)
        for side, on in zip((0.0, 0.0 if periodic else size), sides, strict=True):
            place[one[on[:, axis]], axis] = side
    turns = np.zeros(corners.shape, dtype=np.int64)
    if periodic:
        turns = np.round((corners - place[one]) / size).astype(np.int64)
    keys, number = np.unique(np.column_stack([one, turns]), axis=0, return_inverse=True)
    found = {tuple(key): n for n, key in enumerate(keys.tolist())}
    image = np.tile(np.arange(len(keys))[:, None], dim)
    for key, n in found.items():
        for axis in range(dim):
            if key[1 + axis] == 1:
                image[n, axis] = found[(*key[: 1 + axis], 0, *key[2 + axis :])]
    return place[keys[:, 0]] + size * keys[:, 1:], number.ravel(), image


def _without_repeats(face: NDArray[np.int64]) -> tuple[int, ...]:
    return tuple(int(n) for n, before in zip(face, np.roll(face, 1), strict=True) if n != before)
