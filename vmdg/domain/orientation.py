"""Misorientation of crystals."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.words import as_numbers

SYMMETRIES = ("cubic", "hexagonal", "orthorhombic", "triclinic")


def misorientation(
    first: ArrayLike, second: ArrayLike, symmetry: str = "cubic"
) -> NDArray[np.float64]:
    """Smallest rotation angle [degrees] between two crystals, (n,).

    It defines classes of grain boundaries: with the rotations R (grains + 1, 3, 3) by tag,

        Interface(between=lambda a, b: misorientation(R[a], R[b]) < 15, law=...)

    Args:
        first: Rotations (n, 3, 3), or one (3, 3), whose columns are the axes of the crystal.
        second: The same number of rotations.
        symmetry: Crystal symmetry, with its number of equivalent rotations: "cubic" 24, "hexagonal"
            12 (axis 3 is the hexagonal one), "orthorhombic" 4, "triclinic" 1.

    Raises:
        ValueError: an unknown symmetry, or arrays of the wrong shape.
    """
    one, two = as_numbers(first), as_numbers(second)
    if symmetry not in SYMMETRIES:
        raise ValueError(f"misorientation: symmetry = {symmetry!r} must be one of {SYMMETRIES}")
    if one.shape[-2:] != (3, 3) or one.shape != two.shape:
        raise ValueError(
            f"misorientation: rotations have shapes {one.shape} and {two.shape}; both must be "
            "(n, 3, 3), the axes of a crystal the columns of a matrix"
        )
    apart = np.swapaxes(one, -1, -2) @ two
    # Of all equivalent rotations the smallest one has the largest trace, 1 + 2 cos.
    trace = np.einsum("...ij,sji->...s", apart, _alike(symmetry)).max(axis=-1)
    return np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


def _alike(symmetry: str) -> NDArray[np.float64]:
    """Rotations that map a crystal onto itself (s, 3, 3)."""
    signs = [np.diag(s) for s in itertools.product((1.0, -1.0), repeat=3)]
    if symmetry == "cubic":
        orders = [np.eye(3)[list(order)] for order in itertools.permutations(range(3))]
        return _proper([sign @ order for sign in signs for order in orders])
    if symmetry == "hexagonal":
        turns = []
        for k in range(6):
            c, s = math.cos(k * math.pi / 3), math.sin(k * math.pi / 3)
            turns.append(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))
        return np.array([turn @ np.diag(d) for turn in turns for d in ((1, 1, 1), (1, -1, -1))])
    return _proper(signs) if symmetry == "orthorhombic" else np.eye(3)[None]


def _proper(matrices: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.array([m for m in matrices if np.linalg.det(m) > 0])
