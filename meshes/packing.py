"""Discs and spheres at random places in a cell, none of which touch; where sides best cut them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

#: Area of a disc and volume of a sphere of radius 1, by dimension.
UNIT_BALL = {2: math.pi, 3: 4 * math.pi / 3}

#: Share of a cell that balls (with half their spacing) may fill: above, they jam at random places.
JAMMED = {2: 0.82, 3: 0.62}

#: Random starts before balls that jam are said to have no room.
STARTS = 10


def pack(
    count: int,
    fraction: float,
    seed: int = 0,
    periodic: bool = True,
    size: float = 1.0,
    dim: int = 2,
    spacing: float = 0.1,
    spread: float = 0.0,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres (count, dim) and radii (count,) [mm] of balls in a square or cube [0, size]^dim.

    All are put anywhere, then every two that are too close move apart, until none are. So denser
    cells are reached than by dropping one after the other, which jams at half the area.

    Args:
        count: Number of balls.
        fraction: Share of the cell that they fill.
        seed: The same seed gives the same places, on every rank.
        periodic: Balls that leave the cell at one side come in at the opposite one; otherwise none
            is cut by a side, and ``spacing`` holds between balls and sides too.
        size: Side of the cell [mm].
        dim: 2 for discs, 3 for spheres.
        spacing: Least distance of two balls, in mean radii of the two.
        spread: Of the radii, lognormal: standard deviation of their logarithm.

    Raises:
        ValueError: there is no room, or an argument is out of range.
    """
    what = f"pack: {count} balls with fraction = {fraction} and spacing = {spacing}"
    with_spacing = fraction * (1 + spacing / 2) ** dim
    if dim not in UNIT_BALL or count < 1 or not fraction > 0 or spacing < 0 or spread < 0:
        raise ValueError(f"{what}, spread = {spread}, dim = {dim}: counts and shares are positive")
    if with_spacing > JAMMED[dim]:
        raise ValueError(
            f"{what} fill {with_spacing:.3f} of the cell with half their spacing, and balls at "
            f"random places jam at {JAMMED[dim]}; lower the fraction or the spacing"
        )
    generator = np.random.default_rng(seed)
    radii = generator.lognormal(0.0, spread, count)
    radii *= size * (fraction / (UNIT_BALL[dim] * (radii**dim).sum())) ** (1 / dim)
    for _ in range(STARTS):
        start = generator.uniform(0, size, (count, dim))
        centres = _apart(start, radii * (1 + spacing / 2), size, periodic)
        if centres is not None:
            return centres, radii
    raise ValueError(
        f"{what} find no room in a {'periodic ' if periodic else ''}cell of side {size}; lower the "
        "fraction or the spacing, or take more balls in a periodic cell"
    )


def _apart(
    centres: NDArray[np.float64],
    radii: NDArray[np.float64],
    size: float,
    periodic: bool,
    sweeps: int = 3000,
    aim: float = 1e-3,
) -> NDArray[np.float64] | None:
    """Centres moved until no two balls overlap; None where they still do after so many sweeps.

    Args:
        centres: (n, dim).
        radii: Of the balls (n,).
        size: Side of the cell.
        periodic: Whether balls leave and enter; otherwise they stay inside.
        sweeps: Moves of all balls before giving up.
        aim: Pairs are moved apart to this share of a radius more than is asked for, so that the
            sweeps end.
    """
    if 2 * radii.max() > size:  # a ball touches the sides, or its own image
        return None
    count, dim = centres.shape
    shifts = shifts_of(dim, size, periodic)
    for _ in range(sweeps):
        if periodic:
            centres = centres % size
        else:
            centres = np.clip(centres, radii[:, None], size - radii[:, None])
        everywhere = at_images(centres, shifts)
        near = cKDTree(centres).sparse_distance_matrix(
            cKDTree(everywhere), 2 * radii.max() * (1 + aim), output_type="ndarray"
        )
        near = near[near["i"] != near["j"] % count]
        one, two, distance = near["i"], near["j"], near["v"]
        wanted = radii[one] + radii[two % count]
        if (distance >= wanted).all():
            return centres
        lack = np.maximum(wanted * (1 + aim) - distance, 0.0) / 2
        away = (centres[one] - everywhere[two]) / np.maximum(distance, 1e-12 * size)[:, None]
        np.add.at(centres, one, away * lack[:, None])
    return None


def shifts_of(dim: int, size: float, periodic: bool = True) -> NDArray[np.float64]:
    """From a cell to itself and, in a periodic one, to its neighbours (3^dim, dim)."""
    return np.array(list(itertools.product((0, -1, 1) if periodic else (0,), repeat=dim))) * size


def at_images(x: NDArray[np.float64], shifts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, dim) at every shift, one shift after the other (shifts * n, dim)."""
    return (x + shifts[:, None]).reshape(-1, x.shape[1])


def images(
    centres: NDArray[np.float64], radii: ArrayLike, size: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Centres of all balls and periodic images that reach into [0, size]^dim, and whose they are.

    Args:
        centres: In the cell (n, dim) [mm].
        radii: One, or one of each [mm].
        size: Side of the cell [mm].

    Returns:
        Centres (m, dim) [mm], numbers of the balls (m,).
    """
    count, dim = centres.shape
    shifts = shifts_of(dim, size)
    places = at_images(centres, shifts)
    numbers = np.tile(np.arange(count), len(shifts))
    outside = np.maximum(np.maximum(-places, places - size), 0.0)
    into = np.linalg.norm(outside, axis=1) < np.broadcast_to(radii, count)[numbers]
    return places[into], numbers[into]


def well_cut(
    tangents: Sequence[NDArray[np.float64]],
    size: float,
    clear: Callable[[NDArray[np.float64]], float],
    candidates: int = 12,
) -> NDArray[np.float64]:
    """Where a periodic cell is best cut: the low corner (dim,) of a cell with well placed sides.

    A side that nearly touches a body leaves a sliver, inside or outside: the least distance between
    sides and places to avoid is as large as can be, as is that of corners.

    Args:
        tangents: Along every axis, places where no side is to be (n,) [mm].
        size: Side of the cell [mm].
        clear: Of a corner of the cell, its distance from what it is to avoid [mm].
        candidates: Gaps between places to avoid that are looked at along each axis.
    """
    places, margins = [], []
    for x in tangents:
        ordered = np.sort(np.ravel(x) % size)
        gaps = np.diff(ordered, append=ordered[0] + size)
        best = np.argsort(-gaps, kind="stable")[:candidates]
        places.append((ordered[best] + gaps[best] / 2) % size)
        margins.append(gaps[best] / 2)
    choices = itertools.product(*(range(len(x)) for x in places))

    def corner(choice: tuple[int, ...]) -> NDArray[np.float64]:
        return np.array([x[i] for x, i in zip(places, choice, strict=True)])

    def margin(choice: tuple[int, ...]) -> float:
        return min(clear(corner(choice)), *(m[i] for m, i in zip(margins, choice, strict=True)))

    return corner(max(choices, key=margin))


def cut_balls(
    centres: NDArray[np.float64], radii: Sequence[float], size: float
) -> NDArray[np.float64]:
    """Centres of a periodic cell whose sides pass tangents of balls at a distance.

    Args:
        centres: (n, dim) [mm].
        radii: Of the circles around each centre, all the same [mm].
        size: Side of the cell [mm].
    """
    around = np.array(radii)[:, None]

    def clear(corner: NDArray[np.float64]) -> float:
        """Distance of a corner from the circles."""
        apart = centres - corner
        apart -= size * np.round(apart / size)
        return np.abs(np.linalg.norm(apart, axis=1) - around).min()

    tangents = [np.concatenate([x - around, x + around]).ravel() for x in centres.T]
    return (centres - well_cut(tangents, size, clear)) % size
