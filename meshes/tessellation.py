"""Power diagrams of a square or cube: Voronoi's where all weights are equal, periodic or not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection, cKDTree

from vmdg.base.graph import components

from .packing import at_images, shifts_of, well_cut

#: Neighbours whose planes are tried for a cell, by dimension; the sum of volumes is checked.
NEAREST = {2: 60, 3: 150}

#: Of the size of the cell: planes meet, points are one, a body is thick, if by this much.
SMALL = 1e-9

#: Grain, corners, and the numbers of the corners of every face.
Piece = tuple[int, NDArray[np.float64], list[NDArray[np.int64]]]


@dataclass(frozen=True)
class Tessellation:
    """Grains of a cell [0, size]^d; a grain that the sides of a periodic cell cut has pieces.

    Attributes:
        points: Corners (n, d) [mm].
        pieces: Grain of every piece, from 0, and its faces: numbers of their corners in order (two
            in 2D).
        image: Number of the point on the low side (n, d), along every axis, of those on the high
            side; of others their own.
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
    """Cells {x: |x - s|^2 - w is least} of seeds s with weights w, cut by the sides.

    In 2D corners nearer to each other than ``shortest`` become one, so edges shorter than that
    vanish; in 3D faces stay flat. A periodic diagram is shifted so that its sides pass corners at a
    distance.

    Args:
        seeds: (n, d) [mm].
        weights: (n,) [mm2]; equal ones for Voronoi cells.
        size: Side of the cell [mm].
        periodic: Whether cells go on at the opposite side.
        shortest: [mm].

    Raises:
        ValueError: a weight leaves a seed without a cell, or the cells do not fill the square.
    """
    planes = _bounded(seeds, weights, size, periodic)
    if periodic:
        corners = [_corners(own)[0] for own in planes]
        there = np.concatenate(corners).T
        low = well_cut(there, size, lambda x: _from_boundaries(x, seeds, weights, size))
        middles = np.array([x.mean(axis=0) for x in corners]) - low
        planes = [
            _moved(own, -low - size * np.floor(middle / size))
            for own, middle in zip(planes, middles, strict=True)
        ]
    pieces = list(_pieces(planes, size, seeds.shape[1], periodic))
    return _joined(pieces, size, periodic, shortest if seeds.shape[1] == 2 else 0.0)


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
    near = cKDTree(everywhere).query(seeds, min(NEAREST[dim] + 1, len(everywhere)))[1]
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
        volume += ConvexHull(corners).volume
        cells.append(planes[np.unique(np.concatenate(active))])
    if abs(volume / size**dim - 1) > 1e-6:
        raise ValueError(
            f"tessellate: the cells fill {volume / size**dim:.6f} of the square; weights differ so "
            f"much that cells have more than {NEAREST[dim]} neighbours near"
        )
    return cells


def _moved(planes: NDArray[np.float64], shift: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same body at another place."""
    return np.column_stack([planes[:, :-1], planes[:, -1] - planes[:, :-1] @ shift])


def _box(dim: int, size: float) -> NDArray[np.float64]:
    """Planes of [0, size]^dim, the low ones first (2 dim, dim + 1)."""
    one = np.eye(dim)
    low, high = np.column_stack([-one, np.zeros(dim)]), np.column_stack([one, np.full(dim, -size)])
    return np.concatenate([low, high])


def _corners(
    planes: NDArray[np.float64], least: float = 0.0
) -> tuple[NDArray[np.float64] | None, list[list[int]]]:
    """Corners (k, d) of the body inside unit planes, and the planes that meet in each.

    None where no ball of a radius above ``least`` has room inside.
    """
    dim = planes.shape[1] - 1
    # The largest ball inside: n.x + radius <= -c.
    ball = linprog(
        [*[0.0] * dim, -1.0],
        A_ub=np.column_stack([planes[:, :-1], np.ones(len(planes))]),
        b_ub=-planes[:, -1],
        bounds=[*[(None, None)] * dim, (0, None)],
    )
    if ball.status != 0 or ball.x[-1] <= least:
        return None, []
    found = HalfspaceIntersection(planes, ball.x[:-1])
    return found.intersections, found.dual_facets


def _pieces(
    planes: list[NDArray[np.float64]], size: float, dim: int, periodic: bool
) -> Iterator[Piece]:
    """Grain, corners and faces (corners in order) of all that lies in the cell."""
    shifts = shifts_of(dim, size, periodic)
    box = _box(dim, size)
    for grain, own in enumerate(planes):
        around = _corners(own)[0]
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
    """Corners of a flat face one after the other around it."""
    if len(normal) == 2:
        return on
    arms = corners[on] - corners[on].mean(axis=0)
    first = arms[np.argmax((arms**2).sum(axis=1))]
    return on[np.argsort(np.arctan2(arms @ np.cross(normal, first), arms @ first))]


def _joined(pieces: list[Piece], size: float, periodic: bool, shortest: float) -> Tessellation:
    """Pieces that share their corners.

    Corners within ``shortest`` of each other are one, both inside or both on the same side: a
    corner that moved to a side would lay a boundary of grains along it.
    """
    corners = np.concatenate([x for _, x, _ in pieces])
    low, high = (np.abs(corners - side) < 10 * SMALL * size for side in (0, size))
    corners = np.where(low, 0.0, np.where(high, size, corners))
    one = _classes(corners, low + 2 * high, size, periodic, shortest)
    points, number, image = _shared(corners, one, (low, high), size, periodic)
    joined, start, dim = [], 0, corners.shape[1]
    for grain, x, faces in pieces:
        around = [_without_repeats(number[start + face]) for face in faces]
        around = [face for face in around if len(face) >= dim]
        if len({frozenset(face) for face in around}) > dim:
            joined.append((grain, around))
        start += len(x)
    return Tessellation(points, joined, image)


def _classes(
    corners: NDArray[np.float64],
    sides: NDArray[np.int64],
    size: float,
    periodic: bool,
    near: float,
) -> NDArray[np.int64]:
    """Number of the class of every corner, a chain of corners nearer to each other than that.

    Args:
        corners: (n, d).
        sides: Equal rows (n, d) for corners on the same sides.
        size: [mm].
        periodic: Whether images are of the same class.
        near: [mm].
    """
    tree = cKDTree(corners % size if periodic else corners, boxsize=size if periodic else None)
    same = tree.query_pairs(100 * SMALL * size, output_type="ndarray")
    close = cKDTree(corners).query_pairs(near, output_type="ndarray")
    close = close[(sides[close[:, 0]] == sides[close[:, 1]]).all(axis=1)]
    return components(*np.concatenate([same, close]).T, len(corners)).astype(np.int64)


def _shared(
    corners: NDArray[np.float64],
    one: NDArray[np.int64],
    sides: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    size: float,
    periodic: bool,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """A point for every class and image of it that occurs.

    Args:
        corners: (n, d), on the sides exactly.
        one: Class of every corner.
        sides: Marks of the corners on low and on high sides, each (n, d).
        size: [mm].
        periodic: Whether opposite sides are one.

    Returns:
        Points (m, d), the number of the point of every corner (n,), and of every point the number
        of its image on the low side along every axis (m, d).
    """
    dim = corners.shape[1]
    # A class is where its corners are on average, relative to its first one; on a side if one is.
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
    """Corners of a face, each once, where neighbours became one."""
    return tuple(int(n) for n, before in zip(face, np.roll(face, 1), strict=True) if n != before)
