"""User-defined eigenstrains: numbers and tensors, as functions of load factor and position."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh, compute_midpoints
from numpy.typing import NDArray
from ufl.core.expr import Expr

from ..assembly.values import Part, takes_points, value_at
from ..base.parallel import raise_together
from ..base.words import as_numbers
from ..domain.materials import Bodies, rows_of_cells
from ..domain.tags import Group, by_tag

Array = NDArray[np.float64]

_WAYS = (
    "give a number e or a symmetric tensor (3, 3), a Constant, lambda t: ..., or lambda x, t: ... "
    "at midpoints x (3, n) of cells with e (n,) or tensors (3, 3, n), a Function of degree 0, or "
    "an array with one for each local cell"
)

#: Difference of e_ij and e_ji relative to the largest entry that counts as rounding.
_SYMMETRIC = 1e-12


class Eigenstrain:
    """Stress-free strain of the cells of a tag; collective.

    Attributes:
        tensor: Whether it is a tensor rather than a multiple of the identity.
    """

    def __init__(self, mesh: Mesh, value: Any, cells: NDArray[np.int32], what: str):
        points = takes_points(value, what)
        message, first, self.uniform = None, np.zeros(()), True
        try:
            self._at, self.uniform = _reader(mesh, value, cells, points)
            first = self._at(0.0)
            _check(first, () if self.uniform else (len(cells),), mesh.geometry.dim)
        except Exception as error:  # a user's function may raise anything
            message = f"{what} is {value!r}: {error}; {_WAYS}"
        raise_together(mesh.comm, message)
        self.tensor = first.ndim >= 2

    def __call__(self, t: float) -> Array:
        """Strain at load factor t: () or (3, 3) for all cells, or one per cell (n, ...)."""
        return self._at(t)


class Eigenstrains:
    """Eigenstrains of all bodies, as loads."""

    kind = "an eigenstrain"

    def __init__(self, bodies: Bodies):
        self._bodies = bodies
        self.values, self.apply = bodies.eigenstrains, bodies.set_eigenstrains

    def parts(self, t: float) -> Iterator[Part]:
        for tag, strain in self._bodies.strains(t):
            yield Part(f"eigenstrain of tag {tag}", np.atleast_1d(strain), np.zeros((3, 0)))


def checked_eigenstrains(
    mesh: Mesh,
    tags: NDArray[np.int32],
    eigenstrain: Mapping[Group, Any] | None,
    names: Mapping[str, int],
) -> dict[int, Eigenstrain]:
    """Eigenstrains by tag; collective."""
    if not isinstance(eigenstrain or {}, Mapping):
        raise TypeError(
            f"Problem: eigenstrain = {eigenstrain!r} must be a dict of strains by cell tag, for "
            "example {1: lambda t: 1e-3 * t}"
        )
    return {
        tag: Eigenstrain(
            mesh,
            value,
            np.flatnonzero(tags == tag).astype(np.int32),
            f"Problem: the eigenstrain of tag {tag}",
        )
        for tag, value in by_tag(eigenstrain or {}, names, "eigenstrain").items()
    }


def refusal(bodies: Bodies, strains: Array, t: float) -> str | None:
    """Why these eigenstrains are impossible at finite strain; None if they are valid."""
    least = np.inf if bodies.small else bodies.least_stretch(strains)
    if least > 0:
        return None
    return (
        f"an eigenstrain of {least - 1:.6g} at load factor {t:.8g} would shrink a body to nothing: "
        "at finite strain F_s = I + e must be positive definite. A strain is dimensionless, 1 % is "
        "0.01"
    )


def _reader(
    mesh: Mesh, value: Any, cells: NDArray[np.int32], points: bool
) -> tuple[Callable[[float], Array], bool]:
    if isinstance(value, fem.Function):
        return lambda t: rows_of_cells(mesh, value, cells), False
    if points:
        x = compute_midpoints(mesh, mesh.topology.dim, cells).T
        return lambda t: np.moveaxis(value_at(value, t, x), -1, 0), False
    if isinstance(value, Expr) and not isinstance(value, fem.Constant):
        raise ValueError("a UFL expression has no cell values")
    if not callable(value):
        array = as_numbers(value)
        if array.ndim in (1, 3):
            rows = rows_of_cells(mesh, array, cells)
            return lambda t: rows, False
    return partial(value_at, value), True


def _check(strain: Array, rows: tuple[int, ...], d: int) -> None:
    shape = strain.shape[len(rows) :]
    if strain.shape[: len(rows)] != rows or shape not in ((), (3, 3)):
        raise ValueError(f"its value at load factor 0 has shape {strain.shape}")
    if not np.isfinite(strain).all():
        raise ValueError("its value at load factor 0 is not finite")
    if shape:
        largest = np.abs(strain).max(initial=0.0)
        if np.abs(strain - strain.swapaxes(-1, -2)).max(initial=0.0) > _SYMMETRIC * largest:
            raise ValueError("the tensor is not symmetric")
        if d == 2 and np.abs(strain[..., :2, 2]).max(initial=0.0) > 0:
            raise ValueError("a plane body has no shear strains 13 and 23")
