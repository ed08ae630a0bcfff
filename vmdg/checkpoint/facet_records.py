"""All that an interface remembers, one row of numbers a facet, for any partition of the mesh.

A facet is named by the cell of its side 1 and its number within this cell. The cell goes by its
number in the input of the mesh (``original_cell_index``): tried on one to three ranks, it is the
same on any number of them for meshes from gmsh, from a file and from DOLFINx's own generators,
since DOLFINx counts cells in the order in which they are handed over. Nor does the number of the
facet in the cell depend on the partition, since cells keep the order of their nodes, nor which side
is side 1 (:func:`vmdg.interface.facets.find_facets`). The order of the points of a facet does:
nodes of the facet submesh go by global numbers. So every point carries its place, and values are
given to the point at the same place. All components are global ones or, in a turning frame, tied to
N.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from ..interface.active import ActiveInterface, Frozen
from ..interface.facets import InterfaceFacets
from ..interface.points import HISTORY_ARRAYS, VALUE_ARRAYS, PointHistory, PointValues
from ..interface.stabilization import Stabilization

#: Points of a facet lie apart by a share of its size; the same point is met to rounding.
SAME_POINT = 1e-6


def _facet_shapes(d: int) -> dict[str, tuple[int, ...]]:
    """Arrays of one value a facet: those of Stabilization, and the flux weights."""
    pairs = {"delta": (2, d, d), "weights": (2, d, d)}
    return {"tau": (d, d), "delta_s": (d, d), "norm": (), "safety": ()} | pairs


def facet_keys(mesh: Mesh, facets: InterfaceFacets) -> NDArray[np.int64]:
    """Names of the facets (nf,), the same in any partition of the mesh."""
    mesh.topology.create_connectivity(mesh.topology.dim, mesh.topology.dim - 1)
    connectivity = mesh.topology.connectivity(mesh.topology.dim, mesh.topology.dim - 1)
    facets_of_cell = len(connectivity.links(0)) if connectivity.num_nodes else 1
    cells = np.asarray(mesh.topology.original_cell_index)[facets.cells[:, 0]]
    return cells.astype(np.int64) * facets_of_cell + facets.local[:, 0]


@dataclass(frozen=True)
class _Column:
    """Where an array lies in the rows of the facets.

    Attributes:
        name: Of the array.
        shape: Of one of its values.
        points: Whether it has a value at every point, else one a facet.
    """

    name: str
    shape: tuple[int, ...]
    points: bool


class FacetRecords:
    """Turns the memory of a active into rows (nf, width) and back.

    Args:
        active: The interface; which arrays it has depends on its law and frame, the same on
            every rank.
    """

    def __init__(self, active: ActiveInterface):
        self._active = active
        d = active.quadrature.d
        self._columns = [_Column(name, shape, False) for name, shape in _facet_shapes(d).items()]
        self._columns += [
            _Column(name, values.shape[1:], True) for name, values in self._of_points().items()
        ]
        self._points = active.quadrature.points_of_facet.shape[1]
        self._widths = [
            int(np.prod(column.shape)) * (self._points if column.points else 1)
            for column in self._columns
        ]

    def _of_facets(self) -> dict[str, NDArray]:
        stabilization, weights = self._active.frozen
        return vars(stabilization) | {"weights": weights}

    def _of_points(self) -> dict[str, NDArray]:
        active = self._active
        arrays = {"place": active.quadrature.points}
        history = active.history()
        if active.law.inelastic:
            arrays |= {f"history.{name}": getattr(history, name) for name in HISTORY_ARRAYS}
        values = {f"now.{name}": getattr(history.values, name) for name in VALUE_ARRAYS}
        return arrays | {name: array for name, array in values.items() if array is not None}

    def rows(self) -> NDArray[np.float64]:
        """One row a facet of the active, in the order of ``facets.facets``."""
        arrays = self._of_facets() | self._of_points()
        points = self._active.quadrature.points_of_facet
        parts = []
        for column, width in zip(self._columns, self._widths, strict=True):
            values = arrays[column.name]
            values = values[points] if column.points else values
            # Not -1: a rank may hold no facet.
            parts.append(np.asarray(values, dtype=float).reshape(len(points), width))
        return np.concatenate(parts, axis=1)

    def unpack(self, rows: NDArray[np.float64]) -> tuple[PointHistory, Frozen]:
        """History and stabilization from rows (nf, width) of the facets of the active.

        Raises:
            ValueError: a point lies where the rows have none; on this rank only.
        """
        blocks = np.split(rows, np.cumsum(self._widths)[:-1], axis=1)
        facets, count = self._active.quadrature.points_of_facet, len(rows)
        arrays: dict[str, NDArray] = {}
        for column, block in zip(self._columns, blocks, strict=True):
            shape = (count, self._points) if column.points else (count,)
            arrays[column.name] = block.reshape(*shape, *column.shape)
        source = self._same_points(arrays["place"])
        for column in self._columns:
            if column.points:
                values = np.empty((facets.size, *column.shape))
                stored = arrays[column.name]
                values[facets] = stored[np.arange(count)[:, None], source]
                arrays[column.name] = values
        frozen = {c.name: arrays[c.name] for c in self._columns if not c.points}
        weights = frozen.pop("weights")
        present = self._active.history()
        history = {name: getattr(present, name) for name in HISTORY_ARRAYS}
        if self._active.law.inelastic:
            history = {name: arrays[f"history.{name}"] for name in HISTORY_ARRAYS}
            history["mode"] = history["mode"].astype(np.int8)
        now = {name: arrays.get(f"now.{name}") for name in VALUE_ARRAYS}
        history = PointHistory(**history, values=PointValues(**now))
        return history, (Stabilization(**frozen), weights)

    def _same_points(self, places: NDArray[np.float64]) -> NDArray[np.intp]:
        """Stored point (nf, points of a facet) at the place of every point of the facets."""
        q = self._active.quadrature
        mine = q.points[q.points_of_facet]
        distance = np.linalg.norm(mine[:, :, None] - places[:, None], axis=3)
        source = distance.argmin(axis=2)
        nearest = distance.min(axis=2, initial=np.inf)
        far = (nearest > SAME_POINT * q.extent[:, None]).any(axis=1)
        if far.any():
            first = int(np.argmax(far))
            where = ", ".join(f"{x:.6g}" for x in mine[first, 0])
            raise ValueError(f"the facet at ({where}) lies at another place than in the checkpoint")
        return source
