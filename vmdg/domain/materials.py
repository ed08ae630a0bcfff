"""Materials on the mesh: cell-wise constant parameters, grouped into regions that share a
kernel."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from numbers import Real
from typing import Any, Protocol
from zlib import crc32

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh, compute_midpoints
from numpy.typing import ArrayLike, NDArray

from ..base.parallel import raise_together
from ..base.words import as_numbers
from ..forms.dilatation import MeanDilatation
from ..forms.geometry import Geometry
from ..forms.kinematics import Body
from ..forms.materials import FromOthers, Material
from ..forms.rigid import Rigid
from ..materials.point import PointMaterial
from .point_bodies import PointBodies
from .topology import UNTAGGED
from .weibull import Weibull


class Strain(Protocol):
    """Eigenstrain of the cells of a tag."""

    tensor: bool  # A tensor (3, 3), not the factor of the identity
    uniform: bool

    def __call__(self, t: float) -> NDArray[np.float64]:
        """Strain at load factor t: one for all cells, or one per cell (n, ...), ghosts included."""


@dataclass(frozen=True)
class Region:
    """Cells whose materials differ only in the values of their parameters."""

    body: Body
    cells: NDArray[np.int32]  # Local cells of the region, owned ones, (n,)


class Bodies:
    """The regions of a mesh.

    Attributes:
        walls: Displacement of every tag that is a rigid wall.
        rigid: Marks of local cells that belong to a rigid wall.
        mean_dilatation: Whether J is constant in a cell, from the geometry.
        points: Bodies whose stress is computed at points; None for none.
    """

    def __init__(
        self,
        mesh: Mesh,
        tags: NDArray[np.int32],
        materials: Mapping[int, Material],
        small: bool,
        eigenstrain: Mapping[int, Strain] | None,
        geometry: Geometry,
        degree: int,
        plane_stress: bool = False,
    ):
        _check_tags(mesh, tags, materials, eigenstrain)
        space = fem.functionspace(mesh, ("DG", 0))
        self._mesh, self._nodes = mesh, crc32(mesh.geometry.x)
        self.tags = tags
        self.small = small
        self.geometry = geometry
        self.plane_stress = plane_stress
        self.walls = {tag: m.displacement for tag, m in materials.items() if isinstance(m, Rigid)}
        self.rigid = np.isin(tags, list(self.walls))
        self.mean_dilatation = isinstance(geometry, MeanDilatation)
        self.cells_of = {tag: np.flatnonzero(tags == tag) for tag in materials}
        at_points = {tag: m for tag, m in materials.items() if isinstance(m, PointMaterial)}
        self._eigenstrains = dict(eigenstrain or {})
        self._comm = mesh.comm
        self._tensor = any(strain.tensor for strain in self._eigenstrains.values())
        self._eigenstrain = None
        self._factors: dict[int, float] = {}
        if self._eigenstrains:
            shape = ((3, 3),) if self._tensor else ()
            self._eigenstrain = fem.Function(fem.functionspace(mesh, ("DG", 0, *shape)))
        self.points = None
        if at_points:
            given = self.cells_of, at_points, small, geometry, degree, plane_stress
            self.points = PointBodies(mesh, *given, self._eigenstrain)
        self.regions: list[Region] = []
        self.region = np.full(len(tags), -1, dtype=np.int32)
        owned = mesh.topology.index_map(mesh.topology.dim).size_local
        for key in dict.fromkeys(material.kernel_key for material in materials.values()):
            members = {tag: m for tag, m in materials.items() if m.kernel_key == key}
            representative = next(iter(members.values()))
            parameters = {name: fem.Function(space) for name in representative.parameters}
            for tag, material in members.items():
                cells = self.cells_of[tag]
                for name, value in material.parameters.items():
                    what = f"{name} of the material of tag {tag}"
                    parameters[name].x.array[cells] = cell_values(mesh, value, cells, what)
                self.region[cells] = len(self.regions)
            cells = np.flatnonzero(self.region[:owned] == len(self.regions))
            own = isinstance(representative, PointMaterial)
            body = Body(
                representative,
                parameters,
                small,
                self._eigenstrain,
                self.mean_dilatation,
                plane_stress=plane_stress,
                points=self.points.fields if own and self.points else None,
            )
            self.regions.append(Region(body, cells.astype(np.int32)))

    @property
    def linear(self) -> bool:
        """Whether stress is proportional to strain: small strain, and no history of the bodies."""
        return self.small and self.points is None

    @property
    def hyperelastic(self) -> bool:
        """Whether the energy of the bodies is a function of F that is not quadratic."""
        return not self.small and self.points is None

    @property
    def fields(self) -> list[fem.Function]:
        geometry = self.geometry
        mean = [geometry.theta, geometry.pressure] if isinstance(geometry, MeanDilatation) else []
        return mean if self._eigenstrain is None else [self._eigenstrain, *mean]

    @property
    def grow(self) -> bool:
        return self._eigenstrain is not None

    def eigenstrains(self, t: float) -> NDArray[np.float64]:
        """The given eigenstrains at load factor ``t``, of all local cells, flat."""
        if self._eigenstrain is None:
            return np.zeros(0)
        array = np.zeros((len(self.tags), *(9,) * self._tensor))
        for tag, strain in self._eigenstrains.items():
            value = strain(t)
            if self._tensor:
                value = value if strain.tensor else value[..., None, None] * np.eye(3)
                value = value.reshape(*value.shape[:-2], 9)
            array[self.cells_of[tag]] = value
        return array.ravel()

    def strains(self, t: float) -> Iterator[tuple[int, NDArray[np.float64]]]:
        """Tag and given eigenstrain at load factor ``t``."""
        for tag, strain in self._eigenstrains.items():
            yield tag, strain(t)

    @property
    def moved(self) -> bool:
        """Whether nodes of the mesh were moved on this rank after the set-up."""
        return crc32(self._mesh.geometry.x) != self._nodes

    def least_stretch(self, values: NDArray[np.float64]) -> float:
        """Smallest eigenvalue of F_s = I + e over the cells of this rank, or a positive lower
        bound."""
        if not self._tensor:
            return 1 + float(values.min(initial=0.0))
        stretches = np.eye(3) + values.reshape(-1, 3, 3)
        diagonal = np.diagonal(stretches, axis1=1, axis2=2)
        # Gershgorin circles; eigenvalues only where these are inconclusive.
        bounds = (2 * diagonal - np.abs(stretches).sum(axis=2)).min(axis=1)
        doubtful = bounds <= 0
        if doubtful.any():
            bounds[doubtful] = np.linalg.eigvalsh(stretches[doubtful])[:, 0]
        return float(bounds.min(initial=1.0))

    def set_eigenstrains(self, values: NDArray[np.float64]) -> None:
        if self._eigenstrain is not None:
            self._eigenstrain.x.array[:] = values
            size = self._eigenstrain.function_space.dofmap.index_map_bs
            for tag, factor in self._factors.items():
                rows = self._eigenstrain.x.array.reshape(-1, size)
                rows[self.cells_of[tag]] *= factor

    @property
    def swelling(self) -> list[int]:
        return list(self._eigenstrains)

    @contextmanager
    def swollen(self, tag: int, factor: float) -> Iterator[None]:
        """The eigenstrain of a group multiplied by a factor, from the next
        :meth:`set_eigenstrains` on."""
        self._factors[tag] = factor
        try:
            yield
        finally:
            del self._factors[tag]


def cell_values(
    mesh: Mesh, value: Any, cells: NDArray[np.integer], what: str
) -> NDArray[np.float64] | float:
    """A parameter on local cells, one number or (n,); collective.

    Given is a number, f(x) at midpoints x (3, n), a Function of degree 0, or an array with a value
    for each local cell of the mesh, ghosts included.
    """
    if isinstance(value, Real):
        return float(value)
    if isinstance(value, FromOthers):
        return _found_from(mesh, value, cells, what)
    if isinstance(value, Weibull):
        value = value.on(mesh)
    message, values = None, np.zeros(len(cells))
    try:
        values[:] = _given_on(mesh, value, cells)
    except Exception as error:  # a user's function may raise anything
        message = (
            f"{what}: {value!r} is not a number, f(x) with a number for each of the points x (3, "
            f"n), a Function of degree 0, or an array with a value for each local cell: {error}"
        )
    if not np.isfinite(values).all():
        message = f"{what}: not finite in {np.count_nonzero(~np.isfinite(values))} cells"
    raise_together(mesh.comm, message)
    return values


def _found_from(
    mesh: Mesh, value: FromOthers, cells: NDArray[np.integer], what: str
) -> NDArray[np.float64] | float:
    """A parameter computed from others, cell by cell; collective."""
    given = [cell_values(mesh, one, cells, f"{what}, {name}") for name, one in value.given.items()]
    message, result = None, 0.0
    try:
        result = value.function(*given)
    except ValueError as error:
        message = f"{what}: {error}"
    raise_together(mesh.comm, message)
    return result


def _given_on(mesh: Mesh, value: Any, cells: NDArray[np.integer]) -> NDArray[np.float64]:
    if callable(value) and not isinstance(value, fem.Function):
        midpoints = compute_midpoints(mesh, mesh.topology.dim, cells)
        return as_numbers(value(midpoints.T))
    return rows_of_cells(mesh, value, cells)


def rows_of_cells(
    mesh: Mesh, value: fem.Function | ArrayLike, cells: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Values of a Function of degree 0, or rows of an array of local cells, at cells (n, ...)."""
    if isinstance(value, fem.Function):
        space = value.function_space
        if space.mesh is not mesh or space.dofmap.list.shape[1:] != (1,):
            raise ValueError("a Function must be of degree 0 on the mesh of the problem")
        return value.x.array.reshape(-1, *value.ufl_shape)[space.dofmap.list[cells, 0]]
    values = as_numbers(value)
    index_map = mesh.topology.index_map(mesh.topology.dim)
    if values.ndim == 0 or len(values) != index_map.size_local + index_map.num_ghosts:
        raise ValueError(
            f"it has shape {values.shape}, and there are {index_map.size_local} cells and "
            f"{index_map.num_ghosts} ghosts"
        )
    return values[cells]


def _check_tags(
    mesh: Mesh,
    tags: NDArray[np.int32],
    materials: Mapping[int, Material],
    eigenstrain: Mapping[int, Strain] | None,
) -> None:
    present = set(np.unique(np.concatenate(mesh.comm.allgather(np.unique(tags)))).tolist())
    untagged = np.flatnonzero(tags == UNTAGGED)
    message = None
    if len(untagged):
        message = f"cell {untagged[0]} has no tag: cell_tags must cover all cells of the mesh"
    raise_together(mesh.comm, message)
    if missing := sorted(present - set(materials)):
        raise ValueError(
            f"no material for cell tag {missing[0]}: materials has {sorted(materials)}, the mesh "
            f"has {sorted(present)}"
        )
    for what, given in (("materials", materials), ("eigenstrain", eigenstrain or {})):
        if unknown := sorted(set(given) - present):
            raise ValueError(
                f"{what} names cell tag {unknown[0]}, but the mesh has only {sorted(present)}"
            )
