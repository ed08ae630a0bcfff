"""Bodies whose stress is computed at points: their history, and their coefficients in the forms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from reprlib import repr as short

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from .. import compat
from ..base.agreement import together
from ..base.arrays import joined_axes
from ..base.kernels import compile_expression
from ..base.quadrature import bulk_degree
from ..base.timers import timer
from ..forms.dilatation import MeanDilatation
from ..forms.geometry import Cartesian, Geometry
from ..forms.kinematics import PointFields
from ..materials.gradient_damage import GradientDamage
from ..materials.point import PointMaterial
from .mean_points import MeanPoints
from .point_evaluator import PointEvaluator
from .shapes import GeometryMap, determinants, places_in_cells

Array = NDArray[np.float64]

#: Number of points that a material is given at once: the arrays of a batch fit in a core's cache.
_BATCH = 2048


@dataclass(frozen=True)
class PointState:
    """State of the bodies at points; its arrays are never modified.

    With mean dilatation F is diag(F, theta) (4, 4), at small strain diag(strain, theta - 1), and
    stress and moduli are those of :class:`.MeanPoints`.
    """

    history: tuple[Array, ...]  # History of the points of every material (n, m)
    stress: Array  # Conjugate to F (cells, points, 3, 3) [MPa]
    moduli: Array  # Its derivative by F (cells, points, entries, entries) [MPa]
    frozen: Array  # Derivative of P in the adjoint term, likewise [MPa]
    stored: Array  # Stored energy (cells, points) [MPa]
    dissipated: Array  # Dissipated energy in the step (cells, points) [MPa]
    next: tuple[Array, ...]
    deformation: Array  # F, at small strain the strain, of these stresses (n, 3, 3)
    damage: Array  # d at the corners of cells (cells, corners); (cells, 0) where no body cracks


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

    Attributes:
        cells: Local cells, by tag in the order of ``materials``, (n,).
        points: Reference points in a cell (q, d).
        extrapolation: Values of the points in a cell to coefficients of the facet fields (m, q).
        cracking: Place in ``cells`` of those of bodies with a damage field, by tag.
        viscous: Material and tag of a body whose stress depends on the time step; empty for none.
        lost: Material and tag of this rank's points whose stress or moduli were not finite for a
            finite F at the last evaluation; empty for none.
    """

    def __init__(
        self,
        mesh: Mesh,
        cells_of: Mapping[int, NDArray[np.integer]],
        materials: Mapping[int, PointMaterial],
        small: bool,
        geometry: Geometry,
        degree: int,
        plane_stress: bool = False,
        eigenstrain: fem.Function | None = None,
    ):
        self._mesh, self._small, self._geometry = mesh, small, geometry
        self._plane_stress, self._eigenstrain = plane_stress, eigenstrain
        self.materials = dict(materials)
        self._deformed: PointDeformation | None = None
        self.lost = ""
        self.symmetric = all(material.symmetric for material in materials.values())
        timed = [f"{type(m).__name__} (tag {tag})" for tag, m in materials.items() if m.viscous]
        self.viscous = next(iter(timed), "")
        chosen = [cells_of[tag] for tag in materials]
        self.cells = np.concatenate(chosen).astype(np.int32)
        bounds = np.cumsum([0, *map(len, chosen)])
        self._parts = list(zip(materials.values(), bounds[:-1], bounds[1:], strict=True))
        self.cracking = {
            tag: slice(int(start), int(stop))
            for tag, (material, start, stop) in zip(materials, self._parts, strict=True)
            if isinstance(material, GradientDamage)
        }
        cell_map = mesh.topology.index_map(mesh.topology.dim)
        self._local = cell_map.size_local + cell_map.num_ghosts
        self._row = np.full(self._local, -1)
        self._row[self.cells] = np.arange(len(self.cells))
        name, d = mesh.topology.cell_name(), mesh.geometry.dim
        self.rule = order = bulk_degree(name, degree, geometry)
        cell = mesh.basix_cell()
        self.points, self._weights = basix.make_quadrature(cell, order)
        n = geometry.size(d)
        self.entries = tuple(geometry.entries(d))
        size = len(self.entries)
        # Axes of the forms among those of F in space, after which theta comes.
        self._axes, self._mean = np.arange(n), None
        if isinstance(geometry, MeanDilatation):
            self._axes[-1], self._pressure = 3, geometry.pressure
            self._mean = MeanPoints(geometry.entries(d)[:-1], n - 1, small)
        self._rows, self._columns = self._axes[np.array(self.entries).T]
        # In space the tangent of the displacement is no form, those of means are.
        periodic = isinstance(geometry, Cartesian) and geometry.macroscopic is not None
        self._in_forms = d == 2 or periodic or self._mean is not None
        self.element, self.extrapolation = extrapolation(cell, self.points)

        def at_points(shape: tuple[int, ...]) -> fem.Function:
            element = basix.ufl.quadrature_element(cell, value_shape=shape, degree=order)
            return fem.Function(fem.functionspace(mesh, element))

        def in_cells(shape: tuple[int, ...]) -> fem.Function:
            element = basix.ufl.blocked_element(self.element, shape=shape)
            return fem.Function(fem.functionspace(mesh, element))

        self.fields = PointFields(
            at_points((n, n)),
            at_points((size, size)),
            at_points(()),
            in_cells((3, 3)),
            in_cells((size, size)),
            in_cells(()),
            self.entries,
        )
        count = len(self.cells) * len(self.points)
        history = tuple(
            material.start((stop - start) * len(self.points))
            for material, start, stop in self._parts
        )
        grid = len(self.cells), len(self.points)
        dimension, corners = 4 if self._mean else 3, len(basix.geometry(cell))
        one = np.tile(np.eye(dimension) * (not small), (count, 1, 1))
        empty = np.zeros((*grid, size, size))
        self.state = PointState(
            history,
            np.zeros((*grid, dimension, dimension)),
            empty,
            empty,
            np.zeros(grid),
            np.zeros(grid),
            history,
            one,
            np.zeros((len(self.cells), corners if self.cracking else 0)),
        )
        self.take(together(mesh.comm, lambda: self._evaluated(one, np.inf)))
        self.renew()

    # Evaluation

    def deformation(self, u: fem.Function) -> Array:
        """F, at small strain the strain, of a displacement at all points (n, 3, 3), see
        :class:`PointState`; collective the first time."""
        if self._deformed is None or self._deformed.u is not u:
            given = self._geometry, self.points, self.cells, self._small, self._axes
            self._deformed = PointDeformation(u, *given)
        return self._deformed()

    def update(self, deformation: Array, dt: float, hold: bool = False) -> None:
        """Stress and moduli for a deformation; collective.

        Args:
            hold: Keep the moduli of the last evaluation, for a predictor: those of the last
                iteration are closer to those of the step than the elastic ones of a state at rest.
        """
        with timer("bodies at points"):
            evaluated = lambda: self._checked(self._evaluated(deformation, dt))  # noqa: E731
            state = together(self._mesh.comm, evaluated)
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
        changed = _with(self.state, stress=stress, deformation=deformation)
        _write(self.fields.facet_stress, self.cells, self._on_facets(self._piola(changed)))

    def strained(self, since: PointState, dt: float) -> PointState:
        """A state with the current eigenstrain at its own deformation, from the end of its step on:
        what has been dissipated on the way counts as stored, dW = P : dF; collective.

        For derivatives of the energy by eigenstrains, for which :meth:`take` sets it.

        Args:
            dt: A time in which bodies whose stress depends on it hardly flow [s].
        """
        start = _with(since, history=since.next)
        found = together(self._mesh.comm, lambda: self._evaluated(since.deformation, dt, start))
        return _with(found, stored=found.stored + found.dissipated, moduli=since.moduli)

    def _evaluated(
        self, deformation: Array, dt: float, start: PointState | None = None
    ) -> PointState:
        """The state for a deformation from a history, by default that of the current state."""
        count, old = len(self.points), self.state if start is None else start
        stress, stored, dissipated = (
            np.empty_like(a) for a in (old.stress, old.stored, old.stored)
        )
        moduli, history = np.empty_like(old.moduli), []
        deformation, strain = deformation.copy(), self._strain()
        if self._plane_stress:
            deformation[:, 2, 2] = old.deformation[:, 2, 2]
        # Entries of F alone, as the material knows them.
        count_F = len(self.entries) - (self._mean is not None)
        rows, columns = self._rows[:count_F], self._columns[:count_F]
        for (material, start, stop), before in zip(self._parts, old.history, strict=True):
            after = np.empty_like(before)
            evaluate = PointEvaluator(material, dt, self._small, self._plane_stress)
            for first in range(start * count, stop * count, _BATCH):
                batch = slice(first, min(first + _BATCH, stop * count))
                own = slice(batch.start - start * count, batch.stop - start * count)
                F, e = deformation[batch], None if strain is None else strain[batch]
                effective = F if self._mean is None else self._mean.effective(F)
                found, reached = evaluate(effective, before[own], e)
                S, A = found.stress, found.moduli.reshape(-1, 9, 9)
                if len(rows) < 9:
                    A = A[:, (3 * rows + columns)[:, None], 3 * rows + columns]
                if self._mean is not None:
                    S, A = self._mean.conjugate(F, S, A)
                elif self._plane_stress:
                    F[:] = reached
                stress.reshape(-1, *S.shape[1:])[batch] = S
                moduli.reshape(-1, *A.shape[1:])[batch] = A
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
            old.damage,
        )

    def _checked(self, state: PointState) -> PointState:
        """A new state, if all is finite, or if a stress or moduli are not, with which an attempt of
        a step fails."""
        self.lost = ""
        arrays = state.stress, state.moduli, state.stored, state.dissipated
        points = [a.reshape(state.stored.size, *a.shape[2:]) for a in arrays]
        for number, (material, start, stop) in enumerate(self._parts):
            own = slice(start * len(self.points), stop * len(self.points))
            stress, moduli, stored, dissipated = (array[own] for array in points)
            label = f"{type(material).__name__} (tag {list(self.materials)[number]})"
            known = _finite(stress) & _finite(moduli)
            stress[~known] = np.nan  # no iteration continues with such moduli
            if (_finite(state.deformation[own]) & ~known).any():
                self.lost = label
            others = {"state": state.next[number], "stored": stored, "dissipated": dissipated}
            for name, array in others.items():
                wrong = np.flatnonzero(known & ~_finite(array))
                if not len(wrong):
                    continue
                cell, point = divmod(own.start + int(wrong[0]), len(self.points))
                geometry_map = GeometryMap(self._mesh, self.points)
                X = geometry_map.positions(geometry_map.nodes(self.cells[cell : cell + 1]))
                place = ", ".join(
                    f"{x:.6g}" for x in np.reshape(X, (-1, len(self.points)))[:, point]
                )
                raise ValueError(
                    f"{label}: {name} is {short(array[wrong[0]].tolist())} at the point ({place}), "
                    "where the stress is finite; it must be finite too, see vmdg.Response"
                )
        return state

    def _strain(self) -> Array | None:
        """Eigenstrain of all points (n, 3, 3); None for none."""
        if self._eigenstrain is None:
            return None
        function = self._eigenstrain
        rows = function.function_space.dofmap.list[self.cells, 0]
        values = function.x.array.reshape(-1, *function.ufl_shape)[rows]
        tensors = values if function.ufl_shape else values[:, None, None] * np.eye(3)
        return np.repeat(tensors, len(self.points), axis=0)

    def take(self, state: PointState) -> None:
        before, self.state, axes = self.state, state, self._axes
        _write(self.fields.stress, self.cells, state.stress[..., axes[:, None], axes])
        _write(self.fields.stored, self.cells, state.stored)
        if state.moduli is not before.moduli and self._in_forms:
            _write(self.fields.moduli, self.cells, state.moduli)
        _write(self.fields.facet_stress, self.cells, self._on_facets(self._piola(state)))
        if self._plane_stress:
            stretch = state.deformation[:, 2, 2].reshape(state.stored.shape)
            _write(self.fields.facet_stretch, self.cells, self._on_facets(stretch))
        if state.frozen is not before.frozen:
            _write(self.fields.facet_moduli, self.cells, self._on_facets(state.frozen))

    def _on_facets(self, values: Array) -> Array:
        """Coefficients (cells, m, ...) of values at the points (cells, q, ...)."""
        return self.extrapolation @ joined_axes(values, 2)

    def _piola(self, state: PointState) -> Array:
        """P at the points, that of tractions (cells, points, 3, 3) [MPa]."""
        if self._mean is None:
            return state.stress
        P = self._mean.stress(state.deformation, state.stress.reshape(-1, 4, 4))
        return P.reshape(*state.stress.shape[:2], 3, 3)

    def _piola_moduli(self, state: PointState, rows: NDArray[np.integer] | slice) -> Array:
        """Derivative of P in some rows of cells (n, points, entries, entries) [MPa]."""
        if self._mean is None:
            return state.moduli[rows]
        moduli, stress = state.moduli[rows], state.stress[rows]
        deformation = state.deformation.reshape(state.stress.shape)[rows]
        size = moduli.shape[-1]
        return self._mean.stress_moduli(
            deformation.reshape(-1, 4, 4),
            stress.reshape(-1, 4, 4),
            moduli.reshape(-1, size, size),
        ).reshape(moduli.shape)

    def moduli_in(self, cells: NDArray[np.integer]) -> Array:
        """Current derivative of the stress of the forms in some of the cells (n, q, entries,
        entries), with mean dilatation also that of p J [MPa]."""
        rows = self._row[cells]
        moduli = self.state.moduli[rows]
        if self._mean is None:
            return moduli
        deformation = self.state.deformation.reshape(self.state.stress.shape)[rows]
        size = moduli.shape[-1] - 1
        d2J = self._mean.volume_moduli(deformation.reshape(-1, 4, 4))
        d2J = d2J.reshape(*moduli.shape[:2], size, size)
        pressure = self._pressure
        p = pressure.x.array[pressure.function_space.dofmap.list[cells, 0]]
        moduli = moduli.copy()
        moduli[..., :size, :size] += p[:, None, None, None] * d2J
        return moduli

    def flux_moduli_in(self, cells: NDArray[np.integer]) -> Array:
        """Current derivative of P in some of the cells, likewise."""
        return self._piola_moduli(self.state, self._row[cells])

    def frozen_in(self, cells: NDArray[np.integer]) -> Array:
        return self.state.frozen[self._row[cells]]

    def stress_slopes(self, cells: NDArray[np.int32], places: Array) -> Array:
        """GRAD of the stress on facets at a reference point of each of some cells, from places
        (n, d), (n, 3, 3, d) [MPa/mm]."""
        slopes = np.array(self.element.tabulate(1, places)[1:])
        stress = self.fields.facet_stress
        values = stress.x.array.reshape(-1, 9)[stress.function_space.dofmap.list[cells]]
        J = places_in_cells(self._mesh, cells, places[:, None])[1][:, 0]
        of_reference = np.einsum("tnm,nmi->nit", slopes, values, optimize=True)
        return (of_reference @ np.linalg.inv(J)).reshape(-1, 3, 3, places.shape[1])

    def has(self, cells: NDArray[np.integer]) -> NDArray[np.bool_]:
        return self._row[cells] >= 0

    # Damage

    def drive(self, tag: int) -> Array:
        """Energy that drives the damage of a body at its last deformation (cells, points) [MPa]."""
        values = self.state.next[list(self.materials).index(tag)][:, 1]
        return values.reshape(-1, len(self.points))

    def soften(self, damage: Array, at_points: Array) -> None:
        """Another damage, before the iteration of a step; collective.

        Args:
            damage: At the corners of cells (cells, corners).
            at_points: Damage and surface energy there [MPa] (cells, points, 2).
        """
        history = list(self.state.history)
        for tag, own in self.cracking.items():
            number = list(self.materials).index(tag)
            values = history[number] = history[number].copy()
            values[:, [0, 2]] = at_points[own].reshape(-1, 2)
        self.state = _with(self.state, history=tuple(history), damage=damage)
        self.update(self.state.deformation, np.inf)
        self.renew()

    # Steps

    def renew(self) -> None:
        self.take(_with(self.state, frozen=self._piola_moduli(self.state, slice(None))))

    def commit(self) -> None:
        self.state = _with(
            self.state, history=self.state.next, dissipated=np.zeros_like(self.state.dissipated)
        )

    # Files

    def rows(self, state: PointState) -> Array:
        """A converged state, one row per local cell of the mesh (cells, n)."""
        count, size = len(self.points), max(material.size for material, *_ in self._parts)
        history = np.zeros((len(self.cells), count, size))
        for (material, start, stop), values in zip(self._parts, state.history, strict=True):
            shape = stop - start, count, material.size
            history[start:stop, :, : material.size] = values.reshape(shape)
        deformation = state.deformation.reshape(state.stress.shape)
        arrays = [history, state.stress, state.moduli, state.frozen, deformation, state.stored]
        arrays.append(state.damage)
        values = np.concatenate([joined_axes(array, 1) for array in arrays], axis=1)
        rows = np.zeros((self._local, values.shape[1]))
        rows[self.cells] = values
        return rows

    def from_rows(self, rows: Array) -> PointState:
        now, count = self.state, len(self.points)
        size = max(material.size for material, *_ in self._parts)
        shapes = [(count, size), *(a.shape[1:] for a in (now.stress, now.moduli, now.frozen))]
        shapes += [now.stress.shape[1:], (count,), now.damage.shape[1:]]
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
        blocks = np.split(rows[self.cells], ends[:-1], axis=1)
        history, stress, moduli, frozen, deformation, stored, damage = (
            block.reshape(len(self.cells), *shape).copy()
            for block, shape in zip(blocks, shapes, strict=True)
        )
        own = tuple(
            history[start:stop, :, : material.size]
            .reshape((stop - start) * count, material.size)
            .copy()
            for material, start, stop in self._parts
        )
        still = np.zeros(history.shape[:2])
        where = deformation.reshape(now.deformation.shape)
        return PointState(own, stress, moduli, frozen, stored, still, own, where, damage)

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

    def places(self, tag: int) -> Array:
        """X of the points of a body, in all local cells (n, 3) [mm]."""
        _, start, stop = self._parts[list(self.materials).index(tag)]
        geometry_map, d = GeometryMap(self._mesh, self.points), self._mesh.geometry.dim
        x = geometry_map.positions(geometry_map.nodes(self.cells[start:stop]))
        places = np.zeros(((stop - start) * len(self.points), 3))
        places[:, :d] = x.reshape(d, -1).T
        return places

    def of_tag(self, tag: int) -> BodyState:
        number = list(self.materials).index(tag)
        material, start, stop = self._parts[number]
        volumes = self._volumes[start:stop].ravel()
        owned = volumes > 0
        places = self.places(tag)
        names, sizes = list(material.fields), list(material.fields.values())
        columns = np.split(self.state.history[number], np.cumsum(sizes)[:-1], axis=1)
        history = {
            name: column[owned, 0] if size == 1 else column[owned]
            for name, size, column in zip(names, sizes, columns, strict=True)
        }
        stress = self._piola(self.state)[start:stop].reshape(-1, 3, 3)
        return BodyState(places[owned], volumes[owned], stress[owned], history)

    def dissipation(self) -> float:
        """Dissipated energy of this rank's cells in the step [N mm]."""
        return float((self._volumes * self.state.dissipated).sum())


class PointDeformation:
    """F at the points of cells, at small strain the strain; with mean dilatation diag(F, theta)."""

    def __init__(
        self,
        u: fem.Function,
        geometry: Geometry,
        points: Array,
        cells: NDArray[np.int32],
        small: bool,
        axes: NDArray[np.integer],
    ):
        self.u = u
        self._mesh, self._cells, self._small = u.function_space.mesh, cells, small
        F = geometry.deformation(u)
        n = F.ufl_shape[0]
        self._axes = axes
        vector = ufl.as_vector([F[i, j] for i in range(n) for j in range(n)])
        self._count = len(points)
        self._expression = compile_expression(
            vector, points, self._mesh.comm, name="deformation at points"
        )

    def __call__(self) -> Array:
        """(n, 3, 3), n all points of all cells; (n, 4, 4) with mean dilatation."""
        axes, one = self._axes, np.eye(max(3, self._axes[-1] + 1))
        values = np.tile(one, (len(self._cells) * self._count, 1, 1))
        found = compat.evaluate(self._expression, self._mesh, self._cells)
        values[:, axes[:, None], axes] = found.reshape(-1, len(axes), len(axes))
        return values if not self._small else (values + values.transpose(0, 2, 1)) / 2 - one


def _finite(array: Array) -> NDArray[np.bool_]:
    return np.isfinite(joined_axes(array, 1)).all(axis=1)


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
