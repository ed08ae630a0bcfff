"""Scalars and vectors of an interface by name, for files and pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.agreement import together
from ..interface.values import InterfaceState
from ..points.interface import Which
from ..problem.problem import Problem

#: A scalar of :func:`scalar` by name, or a function of a state with one value per point.
Quantity = str | Callable[[InterfaceState], ArrayLike]

#: Vectors at the points, which are attributes of the state, with their units.
VECTORS = {"traction": "MPa", "opening": "mm", "gap": "mm"}

#: Scalars at the points and their labels in pictures.
LABELS: Mapping[str, str] = {
    "opening": r"normal opening $g_N$ [mm]",
    "gap": r"normal gap $\zeta_N$ [mm]",
    "slip": r"slip $|\zeta_T|$ [mm]",
    "traction": r"normal traction $T_N$ [MPa]",
    "shear": r"shear traction $|T_T|$ [MPa]",
    "damage": r"damage $Q/P_c$",
    "mode": "mode",
    "fine_scale": "fine-scale error [mm]",
    "indicator": "fine scales / critical gap",
}


def scalar(problem: Problem, interface: Which, name: str) -> NDArray[np.float64]:
    """A scalar at the points of an interface this rank owns (nq,).

    Args:
        name: "opening", "gap" and "traction": g, zeta and T along the current normal, positive in
            opening and tension [mm, mm, MPa]; "slip" and "shear": norm of the tangential part of
            zeta and of T [mm, MPa]; "damage": Q relative to the strength, 1 where there is no bond
            [-]; "mode": of the return map, :class:`vmdg.Mode`; "fine_scale": size of the fine
            scales (24) of both sides, (|du_1|^2 + |du_2|^2)^1/2 [mm]; "indicator": the value of the
            facet by :meth:`vmdg.Problem.indicator` [-].
    """
    if name not in LABELS:
        raise ValueError(f"{name!r} is not a scalar of an interface; use one of {tuple(LABELS)}")
    if name == "fine_scale":
        return np.sqrt((problem.fine_scale(interface) ** 2).sum(axis=(1, 2)))
    state = problem.state[interface]
    if name == "indicator":
        return problem.indicator(interface)[np.searchsorted(open_facets(state), state.facet)]
    if name == "mode":
        return state.mode.astype(float)
    if name == "damage":
        return state.damage
    if name in VECTORS:
        return _along(getattr(state, name), state)
    return _across(state.gap if name == "slip" else state.traction, state)


def values_at_points(problem: Problem, interface: Which, quantity: Quantity) -> NDArray[np.float64]:
    """Values of a quantity at the points of an interface this rank owns (nq,); collective."""

    def evaluated() -> NDArray[np.float64]:
        if isinstance(quantity, str):
            return scalar(problem, interface, quantity)
        state = problem.state[interface]
        values = np.asarray(quantity(state), dtype=float)
        if values.shape != (len(state.weights),):
            raise ValueError(
                f"the function of an interface's state returns an array of shape {values.shape}; "
                f"it must be one number for each of the {len(state.weights)} points, for example "
                "lambda state: state.traction[:, 0]"
            )
        return values

    return together(problem.comm, evaluated)


def traction_integrals(state: InterfaceState) -> NDArray[np.float64]:
    """Integrals of T_N and |T_T| over this rank's points, and their area (3,) [N, N, mm2]."""
    T = state.traction
    return state.weights @ np.column_stack([_along(T, state), _across(T, state), np.ones(len(T))])


def _normal(state: InterfaceState) -> NDArray[np.float64]:
    """R.N (nq, d), outward from side 1 in the deformed body."""
    return np.einsum("pij,pj->pi", state.rotation, state.normal)


def _along(vector: NDArray[np.float64], state: InterfaceState) -> NDArray[np.float64]:
    return np.einsum("pi,pi->p", vector, _normal(state))


def _across(vector: NDArray[np.float64], state: InterfaceState) -> NDArray[np.float64]:
    return np.linalg.norm(vector - _along(vector, state)[:, None] * _normal(state), axis=1)


def facet_means(state: InterfaceState, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over the facets of :func:`open_facets` (nf, ...) of values at the points (nq, ...)."""
    facets, where = np.unique(state.facet, return_inverse=True)
    integrals = np.zeros((len(facets), *values.shape[1:]))
    np.add.at(integrals, where, (values.T * state.weights).T)
    return (integrals.T / np.bincount(where, state.weights, minlength=len(facets))).T


def open_facets(state: InterfaceState) -> NDArray[np.int32]:
    """Facets of side 1 that have points, ascending (nf,)."""
    return np.unique(state.facet)


def facet_modes(state: InterfaceState) -> NDArray[np.float64]:
    """The predominant mode of each facet of :func:`open_facets` (nf,), the later one of equals."""
    kinds = np.unique(state.mode)
    if not len(kinds):
        return np.zeros(0)
    shares = facet_means(state, (state.mode[:, None] == kinds).astype(float))
    # Halves of a facet are equal up to rounding.
    most = shares >= (1 - 1e-6) * shares.max(axis=1, keepdims=True)
    return kinds[len(kinds) - 1 - np.argmax(most[:, ::-1], axis=1)].astype(float)


def facet_scalar(problem: Problem, interface: Which, name: str) -> NDArray[np.float64]:
    """A scalar of :func:`scalar` for every facet of :func:`open_facets` (nf,).

    Means; the predominant mode, and the root mean square of the fine scales (24): a local measure
    of the error (Figures 18 and 22 of the report), of order h^(k+1).
    """
    state, values = problem.state[interface], scalar(problem, interface, name)
    if name == "fine_scale":
        return np.sqrt(facet_means(state, values**2))
    return facet_modes(state) if name == "mode" else facet_means(state, values)
