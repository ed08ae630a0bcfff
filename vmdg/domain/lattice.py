"""The lattice of a periodic cell: its period vectors, and which points are images of each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from dolfinx.mesh import Mesh
from numpy.typing import ArrayLike, NDArray

from ..base.parallel import global_box
from ..base.tables import rounded
from ..base.words import as_numbers
from .shapes import determinants
from .topology import box_sides

Array = NDArray[np.float64]

#: Distance, relative to the shortest side of the cell, below which points coincide.
SAME_PLACE = 1e-6


@dataclass(frozen=True)
class Lattice:
    """A parallelepiped repeated periodically."""

    vectors: Array  # Its sides, one per row (d, d) [mm]
    origin: Array  # The corner from which the sides start (d,) [mm]

    @property
    def centre(self) -> Array:
        return self.origin + self.vectors.sum(axis=0) / 2

    @property
    def volume(self) -> float:
        """Volume of the cell, voids included [mm3; in 2D mm2]."""
        return float(abs(determinants(self.vectors)))

    @property
    def length(self) -> float:
        """Side of a cube of the same volume [mm]."""
        root = np.cbrt if len(self.vectors) == 3 else np.sqrt
        return float(root(self.volume))

    @property
    def tolerance(self) -> float:
        """Distance below which points coincide [mm]."""
        return SAME_PLACE * float(np.linalg.norm(self.vectors, axis=1).min())

    def fractions(self, x: Array) -> Array:
        """Coordinates of points x (..., d) in units of the sides, 0 to 1 in the cell."""
        return (x - self.origin) @ np.linalg.inv(self.vectors)

    def images(self, x: Array) -> NDArray[np.intp]:
        """Pairs of entities on opposite faces of the cell (n, 2), from points of each, of all ranks
        (entities, points, d)."""
        fractions, middle = self.fractions(x), x.mean(axis=1)
        pairs = [np.zeros((0, 2), dtype=np.intp)]
        for i, vector in enumerate(self.vectors):
            near = self.tolerance / np.linalg.norm(vector)
            low, high = (
                np.flatnonzero((np.abs(fractions[..., i] - end) < near).all(axis=1))
                for end in (0, 1)
            )
            for here, there, to in ((low, high, vector), (high, low, -vector)):
                self._check(middle[here], middle[there], to, i)
            found = scipy.spatial.cKDTree(middle[high]).query(middle[low] + vector)[1]
            pairs.append(np.column_stack([low, high[found]]))
        return np.concatenate(pairs)

    def _check(self, points: Array, others: Array, to: Array, side: int) -> None:
        axis = ("first", "second", "third")[side]
        if not len(points) and not len(others):
            raise ValueError(
                f"Periodic: no facet lies on the faces that the {axis} vector joins, {to.tolist()} "
                f"from {self.origin.tolist()}; give vectors=, the sides of the cell, one per row"
            )
        apart = np.full(len(points), np.inf)
        if len(others):
            apart = scipy.spatial.cKDTree(others).query(points + to)[0]
        bad = np.flatnonzero(~(apart < self.tolerance))
        if len(bad):
            here = np.array(min(points[bad].tolist()))
            raise ValueError(
                f"Periodic: the facet at {rounded(here)} has no image at "
                f"{rounded(here + to)} ({len(bad)} of {len(points)} facets of this face "
                "have none): opposite faces must have the same mesh, in gmsh by "
                "gmsh.model.mesh.setPeriodic before the mesh is generated"
            )


def make_lattice(mesh: Mesh, vectors: ArrayLike | None) -> Lattice:
    """The lattice of a mesh, by its sides, one per row (d, d) [mm], or those of its bounding box;
    collective."""
    d = mesh.geometry.dim
    A = np.diag(box_sides(mesh)[:d]) if vectors is None else as_numbers(vectors)
    if A.shape != (d, d) or not np.isfinite(A).all() or not np.linalg.cond(A) < 1e6:
        raise ValueError(
            f"Periodic: vectors = {vectors!r} must be the {d} linearly independent sides of the "
            "cell, one per row"
        )
    at = mesh.geometry.x[:, :d] @ np.linalg.inv(A)
    low, high = global_box(mesh.comm, at)
    wrong = np.flatnonzero(np.abs(high - low - 1) > SAME_PLACE)
    if len(wrong):
        i = wrong[0]
        raise ValueError(
            f"Periodic: along vectors[{i}] = {A[i].tolist()} the mesh is {high[i] - low[i]:.6g} "
            "times as long; give the period vectors of one cell"
        )
    return Lattice(A, low @ A)
