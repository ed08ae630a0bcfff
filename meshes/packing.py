"""Random packings of discs and spheres in a cell, and the best position of its sides."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

#: Area of a disc and volume of a sphere of radius 1, by dimension.
UNIT_BALL = {2: math.pi, 3: 4 * math.pi / 3}

#: Packing fraction of balls, including half their spacing, above which random packings jam.
JAMMED = {2: 0.82, 3: 0.62}

#: Random restarts before a packing is considered impossible.
STARTS = 10

#: Intervals between places to avoid that are tried along each axis for the sides of a cell.
_CANDIDATES = 12


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

    All balls start at random positions, then every pair that is too close moves apart, until none
    is. This reaches denser packings than sequential placement, which jams at half the area.

    Args:
        count: Number of balls.
        fraction: Fraction of the cell that they fill.
        seed: Random seed: the same seed gives the same positions, on every rank.
        periodic: Balls that leave the cell at one side enter at the opposite one; otherwise none is
            cut by a side, and ``spacing`` applies to sides too.
        size: Side of the cell [mm].
        dim: 2 for discs, 3 for spheres.
        spacing: Least distance of two balls, in mean radii of the two.
        spread: Standard deviation of the logarithm of the radii (lognormal).

    Raises:
        ValueError: the balls do not fit, or an argument is out of range.
    """
    what = f"pack: {count} balls with fraction = {fraction} and spacing = {spacing}"
    with_spacing = fraction * (1 + spacing / 2) ** dim
    if dim not in UNIT_BALL or count < 1 or not fraction > 0 or spacing < 0 or spread < 0:
        raise ValueError(f"{what}, spread = {spread}, dim = {dim}: must be positive")
    if with_spacing > JAMMED[dim]:
        raise ValueError(
            f"{what} fill {with_spacing:.3f} of the cell including half their spacing, but random "
            f"packings jam at {JAMMED[dim]}; lower the fraction or the spacing"
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
        f"{what} do not fit in a {'periodic ' if periodic else ''}cell of side {size}; lower the "
        "fraction or the spacing, or use more balls in a periodic cell"
    )


#: Distance of separated pairs, relative to that at which they touch, so that the sweeps end.
_AIM = 1 + 1e-3


def _apart(
    centres: NDArray[np.float64],
    radii: NDArray[np.float64],
    size: float,
    periodic: bool,
    sweeps: int = 3000,
) -> NDArray[np.float64] | None:
    """Centres moved until no two balls overlap; None if some still do after the last sweep."""
    if 2 * radii.max() > size:  # a ball touches two sides, or its own image
        return None
    count, dim = centres.shape
    shifts = shifts_of(dim, size, periodic)
    for _ in range(sweeps):
        if periodic:
            centres = centres % size
        else:
            centres = np.clip(centres, radii[:, None], size - radii[:, None])
        everywhere = at_images(centres, shifts)
        near = scipy.spatial.cKDTree(centres).sparse_distance_matrix(
            scipy.spatial.cKDTree(everywhere), 2 * radii.max() * _AIM, output_type="ndarray"
        )
        near = near[near["i"] != near["j"] % count]
        one, two, distance = near["i"], near["j"], near["v"]
        wanted = radii[one] + radii[two % count]
        if (distance >= wanted).all():
            return centres
        lack = np.maximum(wanted * _AIM - distance, 0.0) / 2
        away = (centres[one] - everywhere[two]) / np.maximum(distance, 1e-12 * size)[:, None]
        np.add.at(centres, one, away * lack[:, None])
    return None


def shifts_of(dim: int, size: float, periodic: bool = True) -> NDArray[np.float64]:
    """Shifts from a cell to itself and, if periodic, to its neighbours (3^dim, dim)."""
    return np.array(list(itertools.product((0, -1, 1) if periodic else (0,), repeat=dim))) * size


def at_images(x: NDArray[np.float64], shifts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, dim) at every shift, one shift after the other (shifts * n, dim)."""
    return (x + shifts[:, None]).reshape(-1, x.shape[1])


def images(
    centres: NDArray[np.float64], radii: ArrayLike, size: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Centres (m, dim) [mm] of all balls and periodic images that intersect [0, size]^dim, and the
    numbers of the balls (m,)."""
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
) -> NDArray[np.float64]:
    """Best position of the sides of a periodic cell: its low corner (dim,).

    A side nearly tangent to a body creates slivers, so the least distance of sides, and of corners,
    from places to avoid is maximised.
    """
    places, margins = [], []
    for x in tangents:
        ordered = np.sort(np.ravel(x) % size)
        gaps = np.diff(ordered, append=ordered[0] + size)
        best = np.argsort(-gaps, kind="stable")[:_CANDIDATES]
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
    """Centres in a periodic cell whose sides keep a distance from tangents of balls, of one radius
    or several around each centre [mm]."""
    around = np.array(radii)[:, None]

    def clear(corner: NDArray[np.float64]) -> float:
        apart = centres - corner
        apart -= size * np.round(apart / size)
        return np.abs(np.linalg.norm(apart, axis=1) - around).min()

    tangents = [np.concatenate([x - around, x + around]).ravel() for x in centres.T]
    return (centres - well_cut(tangents, size, clear)) % size
