"""The state as arrays of records per cell and per facet, independent of the partition of the mesh.

Cells are identified by their number in the input of the mesh, ``original_cell_index``: DOLFINx
numbers them in input order, so meshes from gmsh, from a file and from DOLFINx's generators have the
same numbers on any number of ranks. Cells also keep the order of their nodes, hence of their
Lagrange dofs, of any degree, and of their facets: a facet is identified by the cell of its side 1
(independent of the partition, :func:`vmdg.points.facets.find_facets`) and its number in it. The
pairs of surfaces that slide follow from the displacement and from the facets whose bond holds.

The order of the points of a facet depends on the partition, since nodes of the facet submesh are
ordered by global numbers. So every point is stored with its position, by which values are assigned.
All components are global or, in a rotating frame, relative to N.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import fields, replace
from typing import Any

from petsc4py import PETSc

import basix
import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from ..base.graph import occurrences
from ..interface.active import ActiveInterface
from ..interface.history import HISTORY_ARRAYS, InterfaceSnapshot, PointHistory
from ..interface.moving import MovingInterface
from ..interface.stabilization import Stabilization
from ..interface.values import VALUE_ARRAYS, PointValues
from ..points.facets import InterfaceFacets
from ..points.points import Points

#: Tolerance for node positions, relative to the size of the mesh.
SAME_PLACE = 1e-9

#: Tolerance for point positions, far below the distance of the points of a facet.
SAME_POINT = 1e-6

_SHARE, _GRADIENT, _ELASTIC = "fluid.share", "gradient", "elastic"

#: Fields of a stabilization, one row per facet.
_OF_FACETS = fields(Stabilization)


NO_RECORDS: NDArray = np.zeros(0, dtype=[("key", np.int64)])


def cell_records(
    space: fem.FunctionSpace,
    arrays: Mapping[str, NDArray],
    places: fem.FunctionSpace,
    rows: Mapping[str, NDArray] | None = None,
) -> NDArray:
    """Fields and node positions of every cell, in input order; collective.

    Args:
        places: The same space, for a periodic cell the one without merged opposite faces.

    Returns:
        This rank's part of the records, in rank order; the fields of a record, by their names and
        "place", are (dofs of a cell, d).
    """
    mesh, d = space.mesh, space.dofmap.index_map_bs
    cells = mesh.topology.index_map(mesh.topology.dim)
    values = {name: (array, space) for name, array in arrays.items()}
    values["place"] = _places(places), places
    columns = [(name, float, (space.dofmap.list.shape[1], d)) for name in values]
    columns += [(name, float, row.shape[1:]) for name, row in (rows or {}).items()]
    kind = np.dtype(columns)
    records = np.empty(cells.size_local, dtype=kind)
    for name, row in (rows or {}).items():
        records[name] = row[: cells.size_local]
    for name, (array, own) in values.items():
        records[name] = array.reshape(-1, d)[own.dofmap.list[: cells.size_local]]
    width = kind.itemsize // np.dtype(float).itemsize
    ordered = PETSc.Vec().createMPI(cells.size_global * width, bsize=width, comm=mesh.comm)
    numbers = _input_numbers(mesh)[: cells.size_local].astype(PETSc.IntType)
    ordered.setValuesBlocked(numbers, records.view(float))
    ordered.assemble()
    records = ordered.array.copy().view(kind)
    ordered.destroy()
    return records


def restore_rows(mesh: Mesh, records: NDArray, name: str) -> NDArray[np.float64]:
    """Values of every local cell, ghosts included, from the records of all cells."""
    return records[name][_input_numbers(mesh)]


def restore_fields(
    space: fem.FunctionSpace,
    records: NDArray,
    places: fem.FunctionSpace,
    rows: Collection[str] = (),
) -> dict[str, NDArray[np.float64]]:
    """Fields by name, ghosts included, from the records of all cells; zero at dofs outside all
    cells."""
    mine, present = records[_input_numbers(space.mesh)], _places(places)
    arrays = {}
    for name in set(records.dtype.names or ()) - set(rows):
        own = places if name == "place" else space
        imap, bs = own.dofmap.index_map, own.dofmap.index_map_bs
        arrays[name] = np.zeros((imap.size_local + imap.num_ghosts) * bs)
        arrays[name].reshape(-1, bs)[own.dofmap.list] = mine[name]
    away, x = np.abs(present - arrays.pop("place")), space.mesh.geometry.x
    if len(x) and away.max() > SAME_PLACE * np.ptp(x, axis=0).max():
        raise ValueError(f"a node is {away.max():.3g} mm from its position")
    return arrays


def facet_records(active: ActiveInterface) -> NDArray:
    """The state of an interface: key, stabilization, and values at the points of each facet."""
    points = active.quadrature.points_of_facet
    columns = {"key": facet_keys(active.quadrature.mesh, active.facets)}
    columns |= {field.name: getattr(active.stabilization, field.name) for field in _OF_FACETS}
    columns |= {name: values[points] for name, values in _at_points(active).items()}
    return _records(columns)


def surface_records(active: MovingInterface) -> NDArray:
    """The state of the owned facets of two surfaces that slide, by key."""
    mesh = active.quadrature.mesh
    owned = mesh.topology.index_map(mesh.topology.dim - 1).size_local
    facets = np.concatenate([side.facets for side in active.facets.surfaces.sides])
    columns = {"key": _surface_keys(active)} | active.facet_state()
    return _records({name: values[facets < owned] for name, values in columns.items()})


def near_records(active: MovingInterface) -> NDArray:
    """The pairs of facets of two surfaces that are coupled in matrices, by key."""
    one, two = (keys[rows] for keys, rows in zip(_both_keys(active), active.near.T, strict=True))
    return _records({"key": one * _facet_count(active.quadrature.mesh) + two})


def _restored_near(active: MovingInterface, records: NDArray) -> NDArray[np.intp]:
    """Rows of this rank's part of them (n, 2)."""
    both, own = np.divmod(records["key"], _facet_count(active.quadrature.mesh)), _both_keys(active)
    known = np.logical_and(*map(np.isin, both, own))
    rows = []
    for stored, keys in zip(both, own, strict=True):
        order = np.argsort(keys)
        rows.append(order[np.searchsorted(keys, stored[known], sorter=order)])
    return np.unique(np.column_stack(rows), axis=0)


def _records(columns: Mapping[str, NDArray]) -> NDArray:
    kind = [(name, values.dtype, values.shape[1:]) for name, values in columns.items()]
    records = np.empty(len(columns["key"]), dtype=kind)
    for name, values in columns.items():
        records[name] = values
    return records


def find_records(records: NDArray, keys: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray]:
    _, positions, found = np.intersect1d(keys, records["key"], return_indices=True)
    order = np.argsort(positions)
    return positions[order], records[found[order]]


def restore_interface(active: ActiveInterface, records: NDArray) -> InterfaceSnapshot:
    quadrature = active.quadrature
    source = _same_points(quadrature, records["place"])
    arrays, at_points = {}, _at_points(active)
    if _SHARE in (records.dtype.names or ()):
        # Fluids are added to a discretization when it is loaded.
        at_points[_SHARE] = np.empty(len(quadrature.weights))
    for name, array in at_points.items():
        arrays[name] = np.empty_like(array)
        stored = records[name][np.arange(len(records))[:, None], source]
        arrays[name][quadrature.points_of_facet] = stored
    # A field of records is a strided view, whose sums round differently from an array's.
    of_facets = {field.name: records[field.name].copy() for field in _OF_FACETS}
    return _snapshot(active, arrays, Stabilization(**of_facets))


def restore_pairs(
    active: MovingInterface,
    u: fem.Function,
    records: NDArray,
    surfaces: NDArray,
    near: NDArray,
) -> InterfaceSnapshot:
    """The state of surfaces that slide at a displacement, from the records of all pairs, of all
    facets, and of what is coupled."""
    keys = _surface_keys(active)
    order = np.argsort(surfaces["key"])
    rows = order[np.searchsorted(surfaces["key"], keys, sorter=order) % len(order)]
    if not np.array_equal(surfaces["key"][rows], keys):
        raise ValueError("a facet of the surfaces that slide is not in the checkpoint")
    own, norm, bonded = (surfaces[name][rows] for name in ("own", "norm", "bonded"))
    facets = active.pairs_at(u, bonded)
    positions, found = find_records(records, facet_keys(active.quadrature.mesh, facets))
    if len(positions) < len(facets.facets):
        raise ValueError("the surfaces that slide have other pairs than in the checkpoint")
    arrays = {
        name: found[name].reshape(-1, *found[name].shape[2:]).copy() for name in _at_points(active)
    }
    given = own, norm, bonded, arrays[_ELASTIC], _restored_near(active, near)
    stabilization, pairs = active.restored(facets, *given)
    return replace(_snapshot(active, arrays, stabilization), pairs=pairs)


def _snapshot(
    active: ActiveInterface, arrays: Mapping[str, NDArray], stabilization: Stabilization
) -> InterfaceSnapshot:
    """The state with these arrays of :func:`_at_points`."""
    present = active.history
    # A tie has values but no history.
    history = {
        name: arrays.get(f"history.{name}", getattr(present, name)) for name in HISTORY_ARRAYS
    }
    values: dict[str, Any] = {name: arrays.get(f"values.{name}") for name in VALUE_ARRAYS}
    return InterfaceSnapshot(
        PointHistory(**history),
        PointValues(**values),
        stabilization,
        arrays.get(_SHARE),
        arrays.get(_GRADIENT),
    )


def facet_keys(mesh: Mesh, facets: InterfaceFacets) -> NDArray[np.int64]:
    """Keys of the facets (nf,), independent of the partition of the mesh.

    Where meshes do not match, of the segments: by facets of both sides, then by their order.
    """
    sides = _keys_of(mesh, facets.cells, facets.local)
    if not facets.paired:
        return sides[:, 0]
    pairs = sides[:, 0] * _facet_count(mesh) + sides[:, 1]
    # Both facets have at most four corners: their intersection has at most eight.
    return 8 * pairs + occurrences(pairs)


def _surface_keys(active: MovingInterface) -> NDArray[np.int64]:
    """Keys of the facets of both surfaces, those of side 1 first."""
    return np.concatenate(_both_keys(active))


def _both_keys(active: MovingInterface) -> list[NDArray[np.int64]]:
    mesh, sides = active.quadrature.mesh, active.facets.surfaces.sides
    return [_keys_of(mesh, side.cells, side.local) for side in sides]


def _keys_of(mesh: Mesh, cells: NDArray[np.int32], local: NDArray[np.int32]) -> NDArray[np.int64]:
    return _input_numbers(mesh)[cells] * _facets_of_cell(mesh) + local


def _facet_count(mesh: Mesh) -> int:
    return mesh.topology.index_map(mesh.topology.dim).size_global * _facets_of_cell(mesh)


def _facets_of_cell(mesh: Mesh) -> int:
    return len(basix.topology(mesh.basix_cell())[mesh.topology.dim - 1])


def _input_numbers(mesh: Mesh) -> NDArray[np.int64]:
    return np.asarray(mesh.topology.original_cell_index, dtype=np.int64)


def _places(space: fem.FunctionSpace) -> NDArray[np.float64]:
    """Reference position of every node, flattened like a displacement [mm]."""
    return space.tabulate_dof_coordinates()[:, : space.dofmap.index_map_bs].ravel()


def _at_points(active: ActiveInterface) -> dict[str, NDArray]:
    """Arrays with one value per point; their selection depends on law and frame and is the same on
    every rank."""
    arrays = {"place": active.quadrature.points}
    if active.law.inelastic:
        arrays |= {f"history.{name}": getattr(active.history, name) for name in HISTORY_ARRAYS}
        # For continued damage; rate-dependent laws, with another time step, do not use it.
        arrays[_GRADIENT] = active.work_gradient(1.0)
    if isinstance(active, MovingInterface):
        arrays[_ELASTIC] = active.elastic
    values = {f"values.{name}": getattr(active.values, name) for name in VALUE_ARRAYS}
    if active.fluid is not None:
        arrays[_SHARE] = active.fluid.share
    return arrays | {name: array for name, array in values.items() if array is not None}


def _same_points(quadrature: Points, places: NDArray[np.float64]) -> NDArray[np.intp]:
    """Stored point (nf, points per facet) at the position of every point of the facets."""
    mine = quadrature.points[quadrature.points_of_facet]
    distance = np.linalg.norm(mine[:, :, None] - places[:, None], axis=3)
    nearest = distance.min(axis=2, initial=np.inf)
    far = (nearest > SAME_POINT * quadrature.extent[:, None]).any(axis=1)
    if far.any():
        where = ", ".join(f"{x:.6g}" for x in mine[far][0, 0])
        raise ValueError(f"the facet at ({where}) has another position than in the checkpoint")
    return distance.argmin(axis=2)
