"""User-defined values: numbers, arrays, Constants, functions of load factor and position."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol, TypeAlias

from mpi4py import MPI

import numpy as np
from dolfinx import fem
from numpy.typing import ArrayLike, NDArray

from ..base.parallel import raise_together
from ..base.tables import rounded
from ..base.words import as_numbers, at_points


class Part(NamedTuple):
    """Values of one user-defined load or support at a load factor, on this rank."""

    what: str
    values: NDArray[np.float64]
    places: NDArray[np.float64]  # Positions (3, n), or a single one for all; n may be 0


class Load(Protocol):
    """All loads, or all supports, of one kind."""

    kind: str

    def values(self, t: float) -> NDArray[np.float64]:
        """All values at load factor ``t``, flat."""

    def parts(self, t: float) -> Iterable[Part]:
        """Values of each at load factor ``t``, with the call by which it was given."""


Value: TypeAlias = float | ArrayLike | fem.Constant | Callable[..., Any]

_WAYS = (
    "write lambda t: ... of the load factor or lambda x, t: ... at points x (3, n); arguments with "
    "a default, as in lambda t, v=v: ..., are ignored"
)


def takes_points(value: Value, what: str) -> bool:
    """Whether a value is f(x, t), rather than a number, an array, a Constant or f(t).

    Arguments with a default are ignored, since they bind loop variables.
    """
    if not callable(value) or isinstance(value, fem.Constant):
        return False
    names = _arguments(value)
    # Callable objects may name their argument differently: CubicSpline(...)(x).
    of_place = inspect.isfunction(value) and names in (["x"], ["X"])
    if len(names) not in (1, 2) or (len(names) == 2 and names[0] == "t") or of_place:
        raise ValueError(f"{what}: the function takes ({', '.join(names)}); {_WAYS}")
    return len(names) == 2


def _arguments(function: Callable[..., Any]) -> list[str]:
    try:
        parameters = inspect.signature(function).parameters.values()
    except ValueError:  # functions in C, like those of numpy
        return ["t"]
    positional = [p for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    if not positional and any(p.kind == p.VAR_POSITIONAL for p in parameters):
        return ["t"]
    return [p.name for p in positional if p.default is p.empty]


def value_at(value: Value, t: float, points: NDArray[np.float64] | None = None) -> NDArray:
    """Value at load factor t: a number, an array, the current value of a Constant, f(t), or f(x, t)
    if points x (3, n) are given.

    Callers check once whether it :func:`takes_points`.
    """
    if isinstance(value, fem.Constant):
        return np.array(value.value)
    if not callable(value):
        return as_numbers(value)
    return as_numbers(value(t) if points is None else at_points(value, points, t))


def not_finite(load: Load, values: NDArray[np.float64], t: float) -> str:
    if np.isfinite(values).all():
        return ""
    found = _culprit(list(load.parts(t)))
    return (
        f"{load.kind}{found and f' ({found})'} is not finite at load factor {t:.8g}: check its "
        "function of the load factor there, for example a root or a quotient"
    )


def _culprit(parts: Sequence[Part]) -> str:
    """Description of the first part that is not finite, to identify its call; empty for none."""
    calls = [part.what for part in parts]
    for i, (what, values, places) in enumerate(parts):
        bad = np.flatnonzero(~np.isfinite(values).all(axis=tuple(range(1, np.ndim(values)))))
        if len(bad):
            number = f"call {calls[: i + 1].count(what)} of " if calls.count(what) > 1 else ""
            first = bad[0] if len(values) == places.shape[1] else 0
            near = f", with a point at {rounded(places.T)[first]}" if places.size else ""
            return f"{number}{what}{near}"
    return ""


def check_resultant(
    comm: MPI.Comm, value: Value, shapes: Sequence[tuple[int, ...]], what: str
) -> None:
    """Check for a number or array of one of these shapes, or f(t) that returns one; collective."""
    if takes_points(value, what):
        raise ValueError(
            f"{what}: the value must be a number, array or f(t); call it once for each point"
        )
    check_shape(comm, first_value(comm, value, what).shape, shapes, what)


def check_shape(
    comm: MPI.Comm, shape: tuple[int, ...], allowed: Sequence[tuple[int, ...]], what: str
) -> None:
    message = None
    if shape not in allowed:
        expected = " or ".join(map(str, allowed))
        message = f"{what}: the value has shape {shape}, expected {expected}"
    raise_together(comm, message)


def first_value(
    comm: MPI.Comm, value: Value, what: str, points: NDArray[np.float64] | None = None
) -> NDArray:
    """Value at load factor 0, to check user input; collective."""
    message, result = None, np.zeros(0)
    try:
        result = value_at(value, 0.0, points)
    except Exception as error:  # a user's function may raise anything
        message = (
            f"{what}: the value {value!r} is not a number, an array or a function that returns "
            f"one: {error}"
        )
        if callable(value):
            message += f"; {_WAYS}"
    if not np.isfinite(result).all():
        message = (
            f"{what}: the value at load factor 0 is {result.ravel()[:3]}; it must be finite "
            "(a function must return the value)"
        )
    raise_together(comm, message)
    return result
