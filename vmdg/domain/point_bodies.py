"""Bodies whose stress is computed at points: their history, and their coefficients in the forms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from .. import compat
from ..base.agreement import together
from ..base.kernels import compile_expression
from ..base.quadrature import bulk_degree
from ..base.timers import timer
from ..forms.geometry import Geometry
from ..forms.kinematics import PointFields
from ..materials.point import PointMaterial, Response
from .shapes import GeometryMap, determinants

Array = NDArray[np.float64]

#: Number of points that a material is given at once: the arrays of a batch fit in a core's cache.
_BATCH = 2048


@dataclass(frozen=True)
class PointState:
    """State of the bodies at points; its arrays are never modified.

    Attributes:
        history: History of the points of every material (n, m).
        stress: P (cells, points, 3, 3) [MPa].
        moduli: dP/dF (cells, points, entries, entries) [MPa].
        frozen: Those at the start of the step [MPa].
        stored: Stored energy (cells, points) [MPa].
        dissipated: Dissipated energy in the step (cells, points) [MPa].
        next: History at the end of the step.
        deformation: F, at small strain the strain, of these stresses (n, 3, 3).
    """

    history: tuple[Array, ...]
    stress: Array
    moduli: Array
    frozen: Array
    stored: Array
    dissipated: Array
    next: tuple[Array, ...]
    deformation: Array


@dataclass(frozen=True)
class BodyState:
    """Values at the points of the cells of one tag, of the cells this rank owns.

    Attributes:
        points: Reference positions (n, 3) [mm].
        weights: Reference volumes (n,) [mm3]; of the full circle in axisymmetry.
        stress: First Piola-Kirchhoff stress, at small strain the stress (n, 3, 3) [MPa].
        history: The quantities of the history by name, (n,) or (n, m).
    """

    points: Array
    weights: Array
    stress: Array
    history: dict[str, Array]


class PointBodies:
    """The bodies of a mesh whose materials are evaluated at points.

    All local cells are evaluated, ghosts included, so ranks need not communicate.

    Args:
        mesh: The mesh.
        cells_of: Local cells of every tag, ghosts included.
        materials: Material of those tags that have one at points.
        small: Small-strain kinematics.
        geometry: Gradient and measure.
        degree: Degree of the displacement.

    Attributes:
        cells: Local cells, by tag in the order of ``materials``, (n,).
        rule: Quadrature degree in the cells.
        points: Reference points in a cell (q, d).
        fields: Coefficients of the forms.
        extrapolation: Values of the points in a cell to coefficients of the facet fields (m, q).
        element: Scalar element of the facet fields.
        symmetric: Whether all moduli have major symmetry.
        viscous: Whether a stress depends on the time step.
        state: Current state.
    """

    def __init__(
        self,
        mesh: Mesh,
        cells_of: Mapping[int, NDArray[np.integer]],
        materials: Mapping[int, PointMaterial],
        small: bool,
        geometry: Geometry,
        degree: int,
    ):
        self._mesh, self._small, self._geometry = mesh, small, geometry
        self.materials = dict(materials)
        self._deformed: PointDeformation | None = None
        self.symmetric = all(material.symmetric for material in materials.values())
        self.viscous = any(material.viscous for material in materials.values())
        chosen = [cells_of[tag] for tag in materials]
        self.cells = np.concatenate(chosen).astype(np.int32)
        bounds = np.cumsum([0, *map(len, chosen)])
        self._parts = list(zip(materials.values(), bounds[:-1], bounds[1:], strict=True))
        cell_map = mesh.topology.index_map(mesh.topology.dim)
        self._local = cell_map.size_local + cell_map.num_ghosts
        self._row = np.full(self._local, -1)
        self._row[self.cells] = np.arange(len(self.cells))
        name, d = mesh.topology.cell_name(), mesh.geometry.dim
        self.rule = order = bulk_degree(name, degree, geometry)
        cell = mesh.basix_cell()
        self.points, self._weights = basix.make_quadrature(cell, order)
        self._n = geometry.size(d)
        self.entries = tuple(geometry.entries(d))
        self._rows, self._columns = np.array(self.entries).T
        size = len(self.entries)
        self.element, self.extrapolation = extrapolation(cell, self.points)

        def at_points(shape: tuple[int, ...]) -> fem.Function:
            element = basix.ufl.quadrature_element(cell, value_shape=shape, degree=order)
            return fem.Function(fem.functionspace(mesh, element))

        def in_cells(shape: tuple[int, ...]) -> fem.Function:
            element = basix.ufl.blocked_element(self.element, shape=shape)
            return fem.Function(fem.functionspace(mesh, element))

        self.fields = PointFields(
            at_points((self._n, self._n)),
            at_points((size, size)),
            at_points(()),
            in_cells((3, 3)),
            in_cells((size, size)),
            self.entries,
        )
        count = len(self.cells) * len(self.points)
        history = tuple(
            material.start((stop - start) * len(self.points))
            for material, start, stop in self._parts
        )
        grid = len(self.cells), len(self.points)
        one = np.tile(np.eye(3) * (not small), (count, 1, 1))
        empty = np.zeros((*grid, size, size))
        self.state = PointState(
            history,
            np.zeros((*grid, 3, 3)),
            empty,
            empty,
            np.zeros(grid),
            np.zeros(grid),
            history,
            one,
        )
        self.take(together(mesh.comm, lambda: self._evaluated(one, np.inf)))
        self.begin()

    # Evaluation

    def deformation(self, u: fem.Function) -> Array:
        """F, at small strain the strain, of a displacement at all points (n, 3, 3); collective
        the first time."""
        if self._deformed is None or self._deformed.u is not u:
            given = self._geometry, self.points, self.cells, self._small
            self._deformed = PointDeformation(u, *given)
        return self._deformed()

    def update(self, deformation: Array, dt: float, hold: bool = False) -> None:
        """Stress and moduli for a deformation; collective.

        Args:
            deformation: From :meth:`deformation` (n, 3, 3).
            dt: Time step [s].
            hold: Keep the moduli of the last evaluation, for a predictor: those of the last
                iteration are closer to those of the step than the elastic ones of a state at rest.

        Raises:
            ValueError: a material answers with arrays of the wrong shape, on every rank.
        """
        with timer("bodies at points"):
            state = together(self._mesh.comm, lambda: self._evaluated(deformation, dt))
            if hold:
                state = _with(state, moduli=self.state.moduli)
            self.take(state)

    def extrapolate(self, deformation: Array) -> None:
        """Stress on facets for a small change of the deformation, by the moduli.

        For derivatives of tractions; :meth:`take` restores the stress.
        """
        rows, columns = self._rows, self._columns
        change = (deformation - self.state.deformation)[:, rows, columns]
        change = change.reshape(*self.state.moduli.shape[:3])
        stress = self.state.stress.copy()
        stress[:, :, rows, columns] += (self.state.moduli @ change[..., None])[..., 0]
        _write(self.fields.facet_stress, self.cells, self._on_facets(stress))

    def _evaluated(self, deformation: Array, dt: float) -> PointState:
        count, old = len(self.points), self.state
        stress, stored, dissipated = (
            np.empty_like(a) for a in (old.stress, old.stored, old.stored)
        )
        moduli, history = np.empty_like(old.moduli), []
        rows, columns = self._rows, self._columns
        for (material, start, stop), before in zip(self._parts, old.history, strict=True):
            after = np.empty_like(before)
            for first in range(start * count, stop * count, _BATCH):
                batch = slice(first, min(first + _BATCH, stop * count))
                own = slice(batch.start - start * count, batch.stop - start * count)
                found = self._answer(material, deformation[batch], before[own], dt)
                stress.reshape(-1, 3, 3)[batch] = found.stress
                of_entries = found.moduli.reshape(-1, 9, 9)
                if len(rows) < 9:
                    of_entries = of_entries[:, (3 * rows + columns)[:, None], 3 * rows + columns]
                moduli.reshape(-1, len(rows), len(rows))[batch] = of_entries
                stored.reshape(-1)[batch], dissipated.reshape(-1)[batch] = found[3:]
                after[own] = found.state
            history.append(after)
        return PointState(
            old.history,
            stress,
            moduli,
            old.frozen,
            stored,
            dissipated,
            tuple(history),
            deformation,
        )

    def _answer(
        self, material: PointMaterial, deformation: Array, before: Array, dt: float
    ) -> Response:
        """What a material answers at some points, with checked shapes; not a number where an
        iteration that diverges asks for it."""
        n = len(deformation)
        shapes = (n, 3, 3), (n, 3, 3, 3, 3), before.shape, (n,), (n,)
        if not np.isfinite(deformation).all():
            return Response(*(np.full(shape, np.nan) for shape in shapes))
        found = material(deformation, before, dt, self._small)
        for name, value, shape in zip(Response._fields, found, shapes, strict=True):
            if np.shape(value) != shape:
                raise ValueError(
                    f"{type(material).__name__}: {name} of {n} points has shape "
                    f"{np.shape(value)}, expected {shape}, see vmdg.Response"
                )
        return found

    def take(self, state: PointState) -> None:
        """Make a state the current one, also in the forms."""
        before, self.state, n = self.state, state, self._n
        _write(self.fields.stress, self.cells, state.stress[..., :n, :n])
        _write(self.fields.stored, self.cells, state.stored)
        if state.moduli is not before.moduli and self._mesh.topology.dim == 2:
            _write(self.fields.moduli, self.cells, state.moduli)
        _write(self.fields.facet_stress, self.cells, self._on_facets(state.stress))
        if state.frozen is not before.frozen:
            _write(self.fields.facet_moduli, self.cells, self._on_facets(state.frozen))

    def _on_facets(self, values: Array) -> Array:
        """Coefficients (cells, m, ...) of values at the points (cells, q, ...)."""
        flat = values.reshape(*values.shape[:2], -1)
        return self.extrapolation @ flat

    def moduli_in(self, cells: NDArray[np.integer]) -> Array:
        """Current moduli in some of the cells (n, q, entries, entries) [MPa]."""
        return self.state.moduli[self._row[cells]]

    def frozen_in(self, cells: NDArray[np.integer]) -> Array:
        """Moduli at the start of the step, likewise."""
        return self.state.frozen[self._row[cells]]

    def has(self, cells: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Which of some local cells are evaluated at points."""
        return self._row[cells] >= 0

    # Steps

    def begin(self) -> None:
        """Start a step: the moduli so far are those of the adjoint term."""
        self.take(_with(self.state, frozen=self.state.moduli))

    def commit(self) -> None:
        """Accept the last evaluation as the converged history."""
        self.state = _with(
            self.state, history=self.state.next, dissipated=np.zeros_like(self.state.dissipated)
        )

    # Files

    def rows(self, state: PointState) -> Array:
        """A converged state, one row per local cell of the mesh (cells, n)."""
        count, size = len(self.points), max(material.size for material, *_ in self._parts)
        history = np.zeros((len(self.cells), count, size))
        for (material, start, stop), values in zip(self._parts, state.history, strict=True):
            history[start:stop, :, : material.size] = values.reshape(-1, count, material.size)
        deformation = state.deformation.reshape(len(self.cells), count, 3, 3)
        arrays = [history, state.stress, state.moduli, state.frozen, deformation, state.stored]
        values = np.concatenate([a.reshape(len(self.cells), -1) for a in arrays], axis=1)
        rows = np.zeros((self._local, values.shape[1]))
        rows[self.cells] = values
        return rows

    def from_rows(self, rows: Array) -> PointState:
        """The state of :meth:`rows`."""
        now, count = self.state, len(self.points)
        size = max(material.size for material, *_ in self._parts)
        shapes = [(count, size), *(a.shape[1:] for a in (now.stress, now.moduli, now.frozen))]
        shapes += [(count, 3, 3), (count,)]
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
        blocks = np.split(rows[self.cells], ends[:-1], axis=1)
        history, stress, moduli, frozen, deformation, stored = (
            block.reshape(-1, *shape).copy() for block, shape in zip(blocks, shapes, strict=True)
        )
        own = tuple(
            history[start:stop, :, : material.size].reshape(-1, material.size).copy()
            for material, start, stop in self._parts
        )
        still = np.zeros(history.shape[:2])
        where = deformation.reshape(-1, 3, 3)
        return PointState(own, stress, moduli, frozen, stored, still, own, where)

    # Integrals and values

    @cached_property
    def _volumes(self) -> Array:
        """Reference volume of the points of owned cells (n, q), zero in ghosts [mm3]."""
        geometry_map = GeometryMap(self._mesh, self.points)
        nodes = geometry_map.nodes(self.cells)
        J = np.abs(determinants(geometry_map.jacobians(nodes)))
        around = self._geometry.circumference(geometry_map.positions(nodes))
        owned = self.cells < self._mesh.topology.index_map(self._mesh.topology.dim).size_local
        return J * around * self._weights * owned[:, None] * float(self._geometry.thickness)

    def of_tag(self, tag: int) -> BodyState:
        """Values at the points of a tag; its converged history."""
        number = list(self.materials).index(tag)
        material, start, stop = self._parts[number]
        volumes = self._volumes[start:stop].ravel()
        owned = volumes > 0
        geometry_map = GeometryMap(self._mesh, self.points)
        nodes = geometry_map.nodes(self.cells[start:stop])
        places = np.zeros((len(volumes), 3))
        d = self._mesh.geometry.dim
        places[:, :d] = geometry_map.positions(nodes).reshape(d, -1).T
        names, sizes = list(material.fields), list(material.fields.values())
        columns = np.split(self.state.history[number], np.cumsum(sizes)[:-1], axis=1)
        history = {
            name: column[owned, 0] if size == 1 else column[owned]
            for name, size, column in zip(names, sizes, columns, strict=True)
        }
        stress = self.state.stress[start:stop].reshape(-1, 3, 3)
        return BodyState(places[owned], volumes[owned], stress[owned], history)

    def dissipation(self) -> float:
        """Dissipated energy of this rank's cells in the step [N mm]."""
        return float((self._volumes * self.state.dissipated).sum())


class PointDeformation:
    """F, at small strain the strain, at the points of cells.

    Args:
        u: Displacement.
        geometry: Gradient and measure.
        points: Reference points in a cell.
        cells: Local cells.
        small: Whether the strain is wanted.

    Attributes:
        u: As given.
    """

    def __init__(
        self,
        u: fem.Function,
        geometry: Geometry,
        points: Array,
        cells: NDArray[np.int32],
        small: bool,
    ):
        self.u = u
        self._mesh, self._cells, self._small = u.function_space.mesh, cells, small
        F = geometry.deformation(u)
        self._n = n = F.ufl_shape[0]
        vector = ufl.as_vector([F[i, j] for i in range(n) for j in range(n)])
        self._count = len(points)
        self._expression = compile_expression(
            vector, points, self._mesh.comm, name="deformation at points"
        )

    def __call__(self) -> Array:
        """(n, 3, 3), n all points of all cells."""
        values = np.zeros((len(self._cells) * self._count, 3, 3))
        values[:] = np.eye(3)
        found = compat.evaluate(self._expression, self._mesh, self._cells)
        values[:, : self._n, : self._n] = found.reshape(-1, self._n, self._n)
        if not self._small:
            return values
        return (values + values.transpose(0, 2, 1)) / 2 - np.eye(3)


def _with(state: PointState, **changes: object) -> PointState:
    return PointState(**(vars(state) | changes))


def _write(field: fem.Function, cells: NDArray[np.int32], values: Array) -> None:
    """Values (cells, points or nodes of a cell, ...) into a discontinuous field."""
    dofmap = field.function_space.dofmap
    size = dofmap.index_map_bs
    field.x.array.reshape(-1, size)[dofmap.list[cells]] = values.reshape(*values.shape[:2], size)


def extrapolation(cell: basix.CellType, points: Array) -> tuple[basix.ufl._ElementBase, Array]:
    """The discontinuous element with at most as many coefficients as points, and its coefficients
    from values at the points (m, q): their interpolation, or else least squares."""
    degree = 0

    def discontinuous(degree: int) -> basix.ufl._ElementBase:
        family = basix.ElementFamily.P
        variant = basix.LagrangeVariant.gll_warped if degree else basix.LagrangeVariant.unset
        return basix.ufl.element(family, cell, degree, variant, discontinuous=True)

    while discontinuous(degree + 1).dim <= len(points):
        degree += 1
    element = discontinuous(degree)
    return element, np.linalg.pinv(element.tabulate(0, points)[0])
