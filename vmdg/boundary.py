"""Prescribed displacements and the values of loads, as functions of the load factor t."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from dolfinx.mesh import locate_entities_boundary
from numpy.typing import ArrayLike, NDArray

from .parallel import global_sum

Locator = Callable[[NDArray[np.float64]], NDArray[np.bool_]]
Where = ArrayLike | Locator
Value = float | ArrayLike | Callable[..., Any]

_AXES = ("x", "y", "z")


def find_boundary_facets(mesh, where: Where, what: str) -> NDArray[np.int32]:
    """Facets given by index or by a predicate on the coordinates (3, n) of the boundary.

    Raises:
        ValueError: nothing is selected on any rank.
    """
    if callable(where):
        facets = locate_entities_boundary(mesh, mesh.topology.dim - 1, where)
    else:
        facets = np.asarray(where, dtype=np.int32)
    if global_sum(mesh.comm, len(facets)) == 0:
        raise ValueError(f"{what}: no facet is selected on any rank")
    return facets


def component_index(component: int | str | None, d: int, what: str) -> int | None:
    """0, 1, 2 or "x", "y", "z" as an index; None for all components.

    Raises:
        ValueError: no such component.
    """
    if component is None:
        return None
    names = _AXES[:d]
    if component in names:
        return names.index(component)
    if isinstance(component, (int, np.integer)) and 0 <= component < d:
        return int(component)
    raise ValueError(
        f"{what}: unknown component {component!r}; in {d}D it is one of 0..{d - 1} or "
        f"{', '.join(names)}, or None for all"
    )


def takes_points(value: Value) -> bool:
    """Whether a value is f(x, t), not a number, an array or f(t)."""
    return callable(value) and len(inspect.signature(value).parameters) > 1


def value_at(value: Value, t: float, points: NDArray[np.float64] | None = None) -> NDArray:
    """Value at load factor t: a number, an array, f(t), or f(x, t) with points x (3, n)."""
    if not callable(value):
        return np.asarray(value, dtype=float)
    return np.asarray(value(points, t) if takes_points(value) else value(t), dtype=float)


@dataclass(frozen=True)
class _Condition:
    dofs: NDArray[np.int32]
    component: int | None
    value: Value
    points: NDArray[np.float64]
    base: NDArray[np.float64]


class DirichletConditions:
    """Prescribed components of the displacement.

    Args:
        space: Space of the displacement.
        held: Local dofs (component-wise numbers) that are zero, whatever else is prescribed.

    Attributes:
        dofs: Prescribed local dofs (component-wise numbers), ghosts included, ascending.
    """

    def __init__(self, space: fem.FunctionSpace, held: NDArray[np.int32]):
        self._space = space
        self._d = space.dofmap.index_map_bs
        self._conditions: list[_Condition] = []
        self._held = held
        self.dofs = np.unique(held)

    def add(
        self,
        dofs: NDArray[np.int32],
        value: Value,
        component: int | str | None,
        what: str,
        base: NDArray[np.float64] | None = None,
    ) -> None:
        """Prescribe nodal dofs (block numbers).

        Args:
            dofs: The dofs (n,).
            value: What the user gave.
            component: One of them, or None for all.
            what: Name of the condition for messages.
            base: Displacement to which the value is added (n, d) [mm]; default zero.

        Raises:
            ValueError: no dof is selected, the component or the shape of the value is wrong.
        """
        if global_sum(self._space.mesh.comm, len(dofs)) == 0:
            raise ValueError(f"{what}: no degree of freedom is selected on any rank")
        index = component_index(component, self._d, what)
        points = self._space.tabulate_dof_coordinates()[dofs].T
        base = np.zeros((len(dofs), self._d)) if base is None else base
        condition = _Condition(dofs, index, value, points, base)
        shape = np.shape(value_at(value, 0.0, points))
        count = len(dofs)
        allowed = [(), (count,)] if index is not None else [(self._d,), (self._d, count)]
        if shape not in allowed and not (index is None and shape == ()):
            raise ValueError(
                f"{what}: a value of shape {shape} does not fit "
                + ("one component" if index is not None else f"{self._d} components")
            )
        self._conditions.append(condition)
        components = np.arange(self._d) if index is None else np.array([index])
        flat = (dofs[:, None] * self._d + components).ravel()
        self.dofs = np.union1d(self.dofs, flat).astype(np.int32)

    def values(self, t: float) -> NDArray[np.float64]:
        """Prescribed values at load factor ``t``, one for each of :attr:`dofs`.

        Where conditions overlap, the one that was added last holds.
        """
        result = np.zeros(len(self.dofs))
        for condition in self._conditions:
            value = value_at(condition.value, t, condition.points)
            if condition.component is None:
                if value.ndim == 1:
                    value = value[:, None]
                value = np.broadcast_to(value, (self._d, len(condition.dofs)))
                components = np.arange(self._d)
            else:
                value = np.broadcast_to(value, (1, len(condition.dofs)))
                components = np.array([condition.component])
            flat = condition.dofs[:, None] * self._d + components
            result[np.searchsorted(self.dofs, flat)] = value.T + condition.base[:, components]
        result[np.searchsorted(self.dofs, self._held)] = 0
        return result
