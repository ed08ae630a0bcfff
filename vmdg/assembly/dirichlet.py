"""Prescribed displacements, as functions of the load factor t."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh, locate_entities_boundary
from numpy.typing import ArrayLike, NDArray
from ufl.core.expr import Expr

from .. import compat
from ..base.parallel import global_sum, raise_together
from ..base.tables import rounded
from ..domain.topology import Locator, checked_facets, located
from .values import Part, Value, first_value, takes_points, value_at

Where = ArrayLike | Locator

AXES = ("x", "y", "z")

#: Relative tolerance for equal prescribed values.
SAME_VALUE = 1e-12


def find_boundary_facets(mesh: Mesh, where: Where, what: str) -> NDArray[np.int32]:
    """Boundary facets given by index or by a predicate on coordinates (3, n)."""
    if callable(where):
        dim = mesh.topology.dim - 1
        mesh.topology.create_connectivity(dim, dim + 1)
        facets = located(mesh, lambda f: locate_entities_boundary(mesh, dim, f), where, what)
    else:
        facets = checked_facets(mesh, where, what)
    if global_sum(mesh.comm, len(facets)) == 0:
        raise ValueError(f"{what}: no facet is selected on any rank")
    return facets


def nodes_where(space: fem.FunctionSpace, where: Locator, what: str) -> NDArray[np.int32]:
    """Local nodes (block numbers) by a predicate on coordinates (3, n), without those of means;
    collective."""

    def find(marker: Locator) -> NDArray[np.int32]:
        return fem.locate_dofs_geometrical(space, marker)

    nodes = located(space.mesh, find, where, what)
    return nodes[np.isin(nodes, space.dofmap.list)]


def nodes_of_cells(space: fem.FunctionSpace, cells: NDArray[np.integer]) -> NDArray[np.int32]:
    """Local nodes of cells, block numbers, including cells of other ranks; collective."""
    dim = space.mesh.topology.dim
    space.mesh.topology.create_connectivity(dim, dim)
    return fem.locate_dofs_topological(space, dim, cells.astype(np.int32))


def nodes_of_facets(space: fem.FunctionSpace, facets: NDArray[np.int32]) -> NDArray[np.int32]:
    """Local nodes of facets, block numbers; collective."""
    return fem.locate_dofs_topological(space, space.mesh.topology.dim - 1, facets)


def find_nodes(space: fem.FunctionSpace, where: Locator, what: str) -> NDArray[np.int32]:
    """Local nodes (block numbers) by a predicate on coordinates (3, n); collective."""
    nodes = nodes_where(space, where, what)
    if global_sum(space.mesh.comm, len(nodes)) == 0:
        raise ValueError(
            f"{what}: no node is selected on any rank; where a node has to be, give the geometry a "
            "point, or the condition an interval"
        )
    return nodes


def component_index(component: int | str | None, d: int, what: str) -> int | None:
    """0, 1, 2 or "x", "y", "z" as an index; None for all components."""
    if component is None:
        return None
    names = AXES[:d]
    if component in names:
        return names.index(component)
    whole = isinstance(component, int | np.integer) and not isinstance(component, bool)
    if whole and 0 <= component < d:
        return int(component)
    raise ValueError(
        f"{what}: unknown component {component!r}; in {d}D it is one of 0..{d - 1} or "
        f"{', '.join(names)}, or None for all"
        + (" (in axisymmetry x is r, y is z)" if component in ("r", "z") else "")
    )


@dataclass(frozen=True)
class _Condition:
    """Prescribed components of some nodes."""

    dofs: NDArray[np.int32]  # Component-wise numbers (n, components)
    base: NDArray[np.float64]  # Displacement to which the value is added (n, components) [mm]
    value: Value
    points: NDArray[np.float64]  # Positions of the nodes (3, n)
    replaces: bool
    what: str
    takes_points: bool  # Whether the value is f(x, t)

    def at(self, t: float) -> NDArray[np.float64]:
        """Prescribed values at ``t``, as :attr:`dofs`."""
        value = value_at(self.value, t, self.points if self.takes_points else None)
        if value.ndim == 1 and self.base.shape[1] == 1:
            value = value[None]
        return value.T + self.base


class DirichletConditions:
    """Prescribed components of the displacement, (2) with any value.

    Args:
        zeros: Local dofs (component-wise numbers) fixed at zero, which overrides other conditions.
    """

    kind = "a prescribed displacement"

    def __init__(self, space: fem.FunctionSpace, zeros: NDArray[np.int32]):
        self._space = space
        self._d = space.dofmap.index_map_bs
        self._conditions: list[_Condition] = []
        self.fix(zeros)

    def fix(self, zeros: NDArray[np.int32]) -> None:
        self._zeros = zeros
        every = [zeros, *(one.dofs.ravel() for one in self._conditions)]
        self.dofs = np.unique(np.concatenate(every)).astype(np.int32)
        # Positions in them of the zeros and of the dofs of every condition.
        self._fixed = np.searchsorted(self.dofs, zeros)
        self._places = [np.searchsorted(self.dofs, one.dofs) for one in self._conditions]

    def add(
        self,
        dofs: NDArray[np.int32],
        value: Value | Expr,
        component: int | str | None,
        what: str,
        base: NDArray[np.float64] | None = None,
    ) -> None:
        """Prescribe nodal dofs (block numbers); the value is added to ``base`` (n, d) [mm], default
        zero."""
        if global_sum(self._space.mesh.comm, len(dofs)) == 0:
            raise ValueError(f"{what}: no degree of freedom is selected on any rank")
        index = component_index(component, self._d, what)
        points = self._space.tabulate_dof_coordinates()[dofs].T
        replaces = base is not None
        base = base if replaces else np.zeros((len(dofs), self._d))
        value, comm = self._known(value, dofs, index, what), self._space.mesh.comm
        local = takes_points(value, what)
        shape = first_value(comm, value, what, points if local else None).shape
        count, message = len(dofs), None
        allowed = [(), (count,)] if index is not None else [(), (self._d,), (self._d, count)]
        if shape not in allowed:
            fitting = "one component" if index is not None else f"{self._d} components"
            message = f"{what}: a value of shape {shape} does not fit {fitting}"
        raise_together(comm, message)
        components = np.arange(self._d) if index is None else np.array([index])
        each, base = dofs[:, None] * self._d + components, base[:, components]
        condition = _Condition(each, base, value, points, replaces, what, local)
        self._conditions.append(condition)
        self.fix(self._zeros)

    def _known(
        self, value: Value | Expr, dofs: NDArray[np.int32], index: int | None, what: str
    ) -> Value:
        """A value as a function at the dofs; a Function is interpolated again at each call."""
        if isinstance(value, fem.Constant) or not isinstance(value, Expr):
            return value
        if not isinstance(value, fem.Function):
            raise ValueError(
                f"{what}: a UFL expression has no nodal values; write lambda x, t: ... at points x "
                "(3, n), or interpolate it into a Function"
            )
        d, space = self._d, self._space
        same = value.ufl_domain() == space.mesh.ufl_domain()
        if value.ufl_shape != (d,) or not same:
            raise ValueError(
                f"{what}: the Function has shape {value.ufl_shape}"
                + ("" if same else " and another mesh")
                + f"; it must be a displacement on the mesh of the problem, of shape ({d},), of "
                "which component= takes one"
            )

        def nodal(t: float) -> NDArray[np.float64]:
            field = fem.Function(space)
            cells = np.arange(len(space.dofmap.list), dtype=np.int32)
            compat.interpolate(field, value, cells)
            values = field.x.array.reshape(-1, d)[dofs].T
            return values if index is None else values[index]

        return nodal

    def values(self, t: float) -> NDArray[np.float64]:
        """Prescribed values at load factor ``t``, one for each of :attr:`dofs`.

        Where conditions overlap, the last one added applies.
        """
        result = np.zeros(len(self.dofs))
        for condition, places in zip(self._conditions, self._places, strict=True):
            result[places] = condition.at(t)
        result[self._fixed] = 0
        return result

    @property
    def relative(self) -> NDArray[np.int32]:
        """Those of :attr:`dofs` whose value is added to an earlier displacement."""
        added = np.zeros(len(self.dofs), dtype=bool)
        for condition, places in zip(self._conditions, self._places, strict=True):
            added[places] = condition.replaces
        added[self._fixed] = False
        return self.dofs[added]

    def parts(self, t: float) -> Iterator[Part]:
        for condition in self._conditions:
            yield Part(condition.what, condition.at(t), condition.points)

    def conflict(self, t: float) -> str | None:
        """Message on two conditions with different values for a dof at load factor ``t``, or None.

        A condition relative to the current displacement replaces those before it.
        """
        given = np.full(len(self.dofs), np.nan)
        given[self._fixed] = 0
        for condition, place in zip(self._conditions, self._places, strict=True):
            values = condition.at(t)
            scale = np.abs(values).max(initial=0.0)
            differ = np.abs(given[place] - values) > SAME_VALUE * np.maximum(
                np.abs(given[place]), scale
            )
            if differ.any() and not condition.replaces:
                i, k = np.argwhere(differ)[0]
                axis = AXES[condition.dofs[i, k] % self._d]
                return (
                    f"{condition.what}: the displacement along {axis} of the node at "
                    f"{rounded(condition.points[:, i])} is prescribed as "
                    f"{given[place[i, k]]:.6g} and as {values[i, k]:.6g} at load factor {t:g}; the "
                    "last one applies. Remove the node from one of them"
                )
            given[place] = values
        return None
