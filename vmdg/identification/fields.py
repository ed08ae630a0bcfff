"""A measured field of displacements, and the same field of a run with its derivatives."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from dolfinx import geometry
from numpy.typing import NDArray

from ..base.parallel import global_sum, raise_together
from ..base.tables import rounded
from ..output.history import History
from ..problem.problem import Problem
from ..solver.monitors import Sampled
from .curves import Compared, along_path

Array = NDArray[np.float64]

#: Smallest singular value of motions of the camera, relative to the largest, that is not rounding.
DEPENDENT = 1e-9


@dataclass(frozen=True, eq=False)
class Field:
    """Displacements of points that were measured in images at some load factors.

    Where the camera has moved a little between two images, by a translation and a small rotation,
    the displacements of an image have an unknown rigid motion in common. It is a parameter of every
    image that follows from all others by linear least squares: the motion that the weighted
    residuals have, at the places where the points were seen, is removed from them and from their
    derivatives (variable projection, Golub and Pereyra 1973). So the covariance of the parameters
    contains that of the motions.

    A displacement field alone says nothing about the size of forces, strengths and moduli: a
    :class:`Curve` of the force belongs to it.

    Args:
        points: Places of the points in the undeformed body (n, d), inside of the bodies and not on
            an interface, where there are two displacements [mm].
        loads: Load factors, or values of the column ``along``, of the images in the order of the
            measurement (m,).
        u: Measured displacements (m, n, d) [mm]; NaN for what was not seen.
        sigma: Standard deviation of their noise, a number or of the shape of u [mm].
        along: Column of ``loads``.
        camera: Whether the camera may have moved between the images.
        column: Name of the field; different ones for several in an experiment.

    Raises:
        ValueError: shapes do not match, a value is not finite or a deviation not positive, or an
            image has no more numbers than the motion of the camera.
    """

    points: Any
    loads: Any
    u: Any
    sigma: Any = field(kw_only=True)
    along: str = field(default="load", kw_only=True)
    camera: bool = field(default=True, kw_only=True)
    column: str = field(default="field", kw_only=True)

    def __post_init__(self) -> None:
        points, loads, u = (np.array(one, float) for one in (self.points, self.loads, self.u))
        if points.ndim != 2 or points.shape[1] not in (2, 3) or not np.isfinite(points).all():
            raise ValueError(
                f"Field: points must be finite numbers (n, 2) or (n, 3), not {points.shape}"
            )
        if loads.ndim != 1 or not len(loads) or not np.isfinite(loads).all():
            raise ValueError("Field: loads must be finite numbers (m,)")
        if u.shape != (len(loads), *points.shape) or np.isinf(u).any():
            raise ValueError(
                f"Field: u has shape {u.shape}, but {len(loads)} loads and {len(points)} points of "
                f"{points.shape[1]} components; it must be (m, n, d), finite or NaN"
            )
        sigma = np.broadcast_to(np.array(self.sigma, dtype=float), u.shape)
        if not (sigma > 0).all():
            raise ValueError("Field: sigma must be positive")
        for name, value in {"points": points, "loads": loads, "u": u}.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "_seen", np.isfinite(u))
        object.__setattr__(self, "sigma", sigma[self._seen])
        few = [i for i, basis in enumerate(self._motions) if len(basis) <= basis.shape[1]]
        if few or not self._seen.any():
            raise ValueError(
                f"Field: image {few[0] + 1 if few else 1} has no more displacements than unknown "
                "motions of the camera; leave it out"
            )

    @property
    def data(self) -> Array:
        """The measured numbers (N,), image by image."""
        return self.u[self._seen]

    @property
    def nuisances(self) -> int:
        """Number of unknown motions that are removed from the residuals."""
        return sum(basis.shape[1] for basis in self._motions)

    @property
    def abscissae(self) -> Array:
        """Load of every number (N,)."""
        return np.broadcast_to(self.loads[:, None, None], self.u.shape)[self._seen]

    @property
    def places(self) -> dict[str, Any]:
        """Where it was measured, in JSON types."""
        sums = hashlib.sha256()
        for array in (self.points, self.loads, self._seen):
            sums.update(np.ascontiguousarray(array).tobytes())
        return {"column": self.column, "along": self.along, "points": sums.hexdigest()}

    def at(self, i: int) -> str:
        """Name of number i."""
        image, point, component = np.argwhere(self._seen)[i]
        return (
            f"the displacement {'xyz'[component]} of the {self.column} at "
            f"{rounded(self.points[point])} and {self.along} {self.loads[image]:.6g}"
        )

    @cached_property
    def _motions(self) -> list[Array]:
        """Orthonormal bases of the weighted rigid motions of every image (numbers, motions)."""
        d = self.points.shape[1]
        weights = iter(np.split(1 / self.sigma, self._ends))
        bases = []
        for seen, u in zip(self._seen, self.u, strict=True):
            x = self.points + np.where(seen, u, 0.0)
            x = x - x.mean(axis=0)
            modes = [np.broadcast_to(row, x.shape) for row in np.eye(d)]
            for i, j in ((0, 1), (1, 2), (2, 0))[: 1 if d == 2 else 3]:
                turned = np.zeros_like(x)
                turned[:, i], turned[:, j] = -x[:, j], x[:, i]
                modes.append(turned)
            weighted = np.stack([mode[seen] for mode in modes], axis=1)
            size = np.abs(weighted).max(axis=0)
            weighted = weighted / np.where(size > 0, size, 1.0) * next(weights)[:, None]
            basis, sizes, _ = np.linalg.svd(weighted, full_matrices=False)
            kept = sizes > DEPENDENT * sizes.max(initial=0.0)
            bases.append(basis[:, kept if self.camera else []])
        return bases

    @property
    def _ends(self) -> Array:
        """Where the numbers of an image end, without the last one."""
        return np.cumsum(self._seen.sum(axis=(1, 2)))[:-1]

    def without_nuisances(self, weighted: Array) -> Array:
        """Residuals, ``weighted`` (N,), or derivatives (N, k), without motions of the camera."""
        images = zip(np.split(weighted, self._ends), self._motions, strict=True)
        return np.concatenate([one - basis @ (basis.T @ one) for one, basis in images])

    def of_run(self, history: History, names: Sequence[str]) -> Compared:
        """The displacements of a run at the loads of the images, see :meth:`.Curve.of_run`.

        Args:
            history: Rows of the run.
            names: Parameters by which it was differentiated.
        """
        found = along_path(history, self.along, self.column, self.loads, names)
        values = found.values.reshape(self.u.shape)[self._seen]
        slopes = found.slopes.reshape(*self.u.shape, len(names))[self._seen]
        return Compared(values, slopes, found.reached)

    def watch(self, problem: Problem) -> Callable[[], Sampled]:
        """A function that returns the current displacements of a problem (n d,); collective.

        Raises:
            ValueError: a point is outside of the bodies, or has another dimension.
        """
        mesh, comm = problem.mesh, problem.comm
        d = mesh.topology.dim
        if self.points.shape[1] != d:
            raise ValueError(
                f"Field: points have {self.points.shape[1]} coordinates, the problem has {d}"
            )
        x = np.zeros((len(self.points), 3))
        x[:, :d] = self.points
        owned = mesh.topology.index_map(d).size_local
        near = geometry.compute_collisions_points(geometry.bb_tree(mesh, d), x)
        links = geometry.compute_colliding_cells(mesh, near, x)
        row = np.repeat(np.arange(len(x)), np.diff(links.offsets))
        mine = links.array < owned
        cell = np.full(len(x), owned, dtype=np.int32)
        np.minimum.at(cell, row[mine], links.array[mine])
        # A point between ranks is that of the lowest one.
        holders = np.array(comm.allgather(cell < owned))
        outside = np.flatnonzero(~holders.any(axis=0))
        message = None
        if len(outside):
            message = (
                f"Field: {len(outside)} of {len(x)} points are outside of the bodies, the first at "
                f"{rounded(self.points[outside[0]])}: give places in the undeformed mesh, in its "
                "axes and unit, and leave out what is not part of it"
            )
        raise_together(comm, message)
        rows = np.flatnonzero(holders.argmax(axis=0) == comm.rank)
        places, cells = x[rows], cell[rows]

        def sample() -> Sampled:
            values = np.zeros((len(x), d))
            if len(rows):
                values[rows] = problem.u.eval(places, cells).reshape(len(rows), -1)[:, :d]
            return global_sum(comm, values).ravel().view(Sampled)

        return sample

    def draw(self, axes: Any, fitted: Array, sigma: Any) -> None:
        """Draw measured numbers over those of a run, without the motion of the camera.

        Args:
            axes: Of matplotlib.
            fitted: Values of the run (n,).
            sigma: Standard deviations (n,), or one; None for none.
        """
        rest = self.sigma * self.without_nuisances((self.data - fitted) / self.sigma)
        axes.plot(self.abscissae, fitted, "C0_", ms=10, label="model")
        axes.plot(self.abscissae, fitted + rest, "k.", ms=3, label="measured")
        axes.set(ylabel=f"displacements of the {self.column}")
        axes.legend()
