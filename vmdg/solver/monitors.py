"""What users' functions say while a run goes on: numbers for the table, and where it ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from reprlib import repr as short
from typing import Any, TypeVar

import numpy as np
from dolfinx import fem
from ufl.core.expr import Expr

from ..base.agreement import together
from ..base.parallel import global_any, raise_together
from ..problem.problem import Problem

Monitor = Callable[[Problem], Mapping[str, Any] | None]
Until = Callable[[Problem], bool]

#: Largest relative difference of a column between ranks: rounding.
SAME_ROW = 1e-9

T = TypeVar("T")


def watched_row(problem: Problem, monitor: Monitor | None) -> dict[str, Any]:
    """What a monitor returns, as a part of the history's row; collective.

    Raises:
        TypeError: it is no dict, or a column is no number.
        ValueError: ranks have other columns or values, or the monitor has changed the problem.
        Exception: what the monitor raises on any rank; all of them on all ranks.
    """
    if monitor is None:
        return {}
    row = _unchanged(problem, "the monitor", lambda: _numbers(monitor(problem)))
    rows, message = problem.comm.gather(row), None
    if problem.comm.rank == 0:
        message = next(filter(None, (_difference(row, other) for other in enumerate(rows))), None)
    raise_together(problem.comm, problem.comm.bcast(message))
    return row


def check_functions(**functions: Monitor | Until | None) -> None:
    """Refuse what cannot be called, before a run.

    Args:
        functions: What the user gave, by the names of the arguments.

    Raises:
        TypeError: one is no function.
    """
    for name, given in functions.items():
        if given is not None and not callable(given):
            raise TypeError(
                f"solve: {name} = {short(given)} must be a function of the problem, such as "
                f"{name}=lambda problem: ..., or None"
            )


def ends(problem: Problem, until: Until | None) -> bool:
    """Whether a run is to end, for any rank; collective.

    Raises:
        TypeError: it says neither yes nor no.
        ValueError: it has changed the problem.
        Exception: what the function raises on any rank; all of them on all ranks.
    """

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
    """What a function of the user gives, which may look at the problem only; collective."""
    u, t = problem.u.x.array.copy(), problem.t

    def watched() -> T:
        result = call()
        if problem.t != t or not np.array_equal(u, problem.u.x.array):
            raise ValueError(
                f"solve: {what} has changed the problem, which is to go on from its state at load "
                f"factor {t:.8g}: work with copies there, problem.u.copy(), or return to the state "
                "at its end, problem.step.return_to(snapshot)"
            )
        return result

    return together(problem.comm, watched)


def _numbers(row: Any) -> dict[str, Any]:
    """The row of a monitor, a constant of UFL as its value.

    Raises:
        TypeError: it is no dict, or a column is no number.
    """
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
                f"solve: the monitor calls a column {short(name)}; its name must be a word, such "
                'as "force [N]"'
            )
        value = np.asarray(given.value if isinstance(given, fem.Constant) else given)
        if value.shape != () or value.dtype.kind not in "biuf":
            words = "an expression of UFL" if isinstance(given, Expr) else short(given)
            raise TypeError(
                f"solve: column {name!r} of the monitor is {words}; it must be a number, such as "
                "problem.t for the load factor, or one component of a vector a column"
            )
        numbers[name] = value.item()
    return numbers


def _difference(row: Mapping[str, Any], numbered: tuple[int, Mapping[str, Any]]) -> str | None:
    """How the row of another rank differs from that of rank 0, in words."""
    rank, other = numbered
    for name in dict.fromkeys([*row, *other]):
        first, second = row.get(name, "nothing"), other.get(name, "nothing")
        both = name in row and name in other
        if both and np.isclose(first, second, rtol=SAME_ROW, atol=0.0, equal_nan=True):
            continue
        return (
            f"solve: column {name!r} of the monitor is {first} on rank 0 and {second} on rank "
            f"{rank}: problem.state and problem.u have this rank's part only. Return what is the "
            "same on all ranks, such as problem.mean, problem.reaction or vmdg.extremes"
        )
    return None
