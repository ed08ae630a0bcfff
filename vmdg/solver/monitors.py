"""User functions called during a run: values for the history, and when to stop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from reprlib import repr as short
from typing import Any, TypeVar

import numpy as np
from dolfinx import fem
from ufl.core.expr import Expr

from ..base.agreement import together
from ..base.parallel import global_any, raise_together
from ..problem.problem import Problem
from ..problem.step import energy_of

Monitor = Callable[[Problem], Mapping[str, Any] | None]
Until = Callable[[Problem], bool]

#: Largest relative difference of a column between ranks due to rounding.
SAME_ROW = 1e-9

T = TypeVar("T")


class Sampled(np.ndarray):
    """Values at many points, one column of the history."""


def row_of(problem: Problem, monitor: Monitor | None) -> dict[str, Any]:
    """The values returned by a monitor, for a neighbouring state; collective."""
    return {} if monitor is None else _numbers(monitor(problem))


def watched_row(problem: Problem, monitor: Monitor | None) -> dict[str, Any]:
    """The values returned by a monitor for a row of the history; collective."""
    if monitor is None:
        return {}
    row = _unchanged(problem, "the monitor", lambda: _numbers(monitor(problem)))
    rows, message = problem.comm.gather(row), None
    if problem.comm.rank == 0:
        others = (_difference(row, other) for other in enumerate(rows[1:], 1))
        message = next(filter(None, others), None)
    raise_together(problem.comm, problem.comm.bcast(message))
    return row


def sliding_column(problem: Problem) -> dict[str, float]:
    """The largest slip of points in contact, for a row; nothing where no interface can fail;
    collective."""
    if not any(interface.law.inelastic for interface in problem.interfaces):
        return {}
    return {"sliding [-]": problem.step.watch_sliding()}


def energy_columns(problem: Problem) -> dict[str, float]:
    """The energies and their imbalance, for a row; collective."""
    energy = energy_of(problem.step)
    energies = asdict(energy) | {"imbalance": energy.imbalance}
    return {f"{name} [N mm]": value for name, value in energies.items()}


def differentiable_energies(problem: Problem) -> dict[str, float]:
    """The energies that have derivatives, for a row; collective."""
    kinds = "bulk", "interface", "springs", "damage", "friction"
    energy = energy_of(problem.step)
    return {f"{name} [N mm]": float(getattr(energy, name)) for name in kinds}


def check_functions(**functions: Monitor | Until | None) -> None:
    for name, given in functions.items():
        if given is not None and not callable(given):
            raise TypeError(
                f"solve: {name} = {short(given)} must be a function of the problem, such as "
                f"{name}=lambda problem: ..., or None"
            )


def ends(problem: Problem, until: Until | None) -> bool:
    """Whether any rank stops the run; collective."""

    def answer() -> bool:
        value = until(problem)
        if not isinstance(value, bool | np.bool_ | int | np.integer):
            raise TypeError(
                f"solve: until gave {short(value)} at load factor {problem.t:.8g}; it must return "
                "True or False, for example problem.debonded() > 0.5"
            )
        return bool(value)

    return until is not None and global_any(problem.comm, _unchanged(problem, "until", answer))


def _unchanged(problem: Problem, what: str, call: Callable[[], T]) -> T:
    """The result of a user function, which must not change the problem; collective."""
    u, t, count = problem.u.x.array.copy(), problem.t, len(problem.loading.given.calls)

    def watched() -> T:
        result = call()
        if len(problem.loading.given.calls) != count:
            raise ValueError(
                f"solve: {what} has added a support or a load at load factor {t:.8g}; a run keeps "
                "those it began with: end it by until=, add them, and solve again"
            )
        if problem.t != t or not np.array_equal(u, problem.u.x.array):
            raise ValueError(
                f"solve: {what} has changed the problem, which must continue from its state at "
                f"load factor {t:.8g}: use copies, problem.u.copy(), or restore the state at the "
                "end, problem.step.return_to(snapshot)"
            )
        return result

    return together(problem.comm, watched)


def _numbers(row: Any) -> dict[str, Any]:
    if row is None:
        return {}
    if not isinstance(row, Mapping):
        raise TypeError(
            f"solve: the monitor returned {short(row)}; it must return a dict of columns, for "
            'example {"force": problem.reaction(facets)[0]}, or None'
        )
    numbers = {}
    for name, given in row.items():
        if not isinstance(name, str):
            raise TypeError(
                f"solve: the monitor returned a column {short(name)}; its name must be a str, such "
                'as "force [N]"'
            )
        if isinstance(given, Sampled):
            numbers[name] = np.asarray(given)
            continue
        try:
            value = np.asarray(given.value if isinstance(given, fem.Constant) else given)
        except ValueError:  # lists of different lengths
            value = np.zeros(0)
        if value.shape != () or value.dtype.kind not in "biuf":
            words = "a UFL expression" if isinstance(given, Expr) else short(given)
            raise TypeError(
                f"solve: column {name!r} of the monitor is {words}; it must be a number, such as "
                "problem.t for the load factor; use one column per component of a vector"
            )
        numbers[name] = value.item()
    return numbers


def _difference(row: Mapping[str, Any], numbered: tuple[int, Mapping[str, Any]]) -> str | None:
    """Message on the difference between the row of a rank and that of rank 0."""
    rank, other = numbered
    for name in dict.fromkeys([*row, *other]):
        first, second = row.get(name, "nothing"), other.get(name, "nothing")
        both = name in row and name in other
        if both and np.allclose(first, second, rtol=SAME_ROW, atol=0.0, equal_nan=True):
            continue
        return (
            f"solve: column {name!r} of the monitor is {first} on rank 0 and {second} on rank "
            f"{rank}: problem.state and problem.u are local to a rank. Return values that are "
            "equal on all ranks, such as problem.mean, problem.reaction or vmdg.extremes"
        )
    return None
