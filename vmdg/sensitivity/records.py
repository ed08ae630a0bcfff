"""Neighbouring values and differences of records of arrays, one row per point."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import is_dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Record = TypeVar("Record")

#: Relative change of a parameter for differences between two neighbours: rounding is as small as
#: the rest.
CHANGE = 5e-6

#: The same for differences between the state itself and one neighbour, of what is smooth and hardly
#: curved.
NEAR = 1e-7


def combined(combine: Callable[..., Array], first: Record, *others: Record) -> Record:
    """A record whose arrays of floats are combined from those of others, and of records in it.

    Everything else, such as modes, is that of the first; so is an array that another one lacks.
    """
    found = {name: getattr(first, name) for name in type(first).__match_args__}
    for name, mine in found.items():
        array = isinstance(mine, np.ndarray)
        if mine is None or (array and mine.dtype.kind != "f"):
            continue
        theirs = [getattr(one, name) for one in others]
        if any(other is None for other in theirs):
            continue
        if array:
            found[name] = combine(mine, *theirs)
        elif is_dataclass(mine):
            found[name] = combined(combine, mine, *theirs)
    return type(first)(**found)


def shifted(record: Record, rate: Record, h: float) -> Record:
    """A record moved by h times its rate."""
    return combined(lambda x, dx: x + h * dx, record, rate)


def stacked(records: Sequence[Record]) -> Record:
    """A record of stacks, arrays with a first axis for the records."""
    return combined(lambda *rows: np.stack(rows), *records)


def one_of(stack: Record, part: int | slice) -> Record:
    return combined(lambda x: x[part], stack)


def flat(stack: Record) -> Record:
    """A stack with the points of its records one after the other."""
    return combined(lambda x: x.reshape(-1, *x.shape[2:]), stack)


def unflat(record: Record, count: int) -> Record:
    return combined(lambda x: x.reshape(count, -1, *x.shape[1:]), record)


def aligned(weights: Array, values: Array) -> Array:
    """Weights of points (..., nq), with the axes of values there (nq, ...)."""
    return weights[(..., *[None] * (values.ndim - 1))]


def zeros(record: Record) -> Record:
    """A record of zeros."""
    return combined(np.zeros_like, record)


def plus(record: Record, other: Record) -> Record:
    return combined(np.add, record, other)


def difference(higher: Record, lower: Record, width: float) -> Record:
    """The rate between two values, this far apart."""
    return combined(lambda a, b: (a - b) / width, higher, lower)


def rate_of(
    here: Record,
    higher: Record,
    lower: Record,
    modes: tuple[NDArray[np.int8], NDArray[np.int8], NDArray[np.int8]],
    h: float,
) -> Record:
    """The rate of values at points, on the branch of the return map that is active here.

    Next to a kink, where one of the neighbouring values is on another branch, the rate is that
    towards the other neighbour.
    """
    after, before = modes[1] == modes[0], modes[2] == modes[0]
    if (after & before).all():
        return combined(lambda _, a, b: (a - b) / (2 * h), here, higher, lower)
    # Both neighbours, or none of them.
    both = after == before
    forward = np.where(both, 0.5, np.where(after, 1.0, 0.0)) / h
    backward = np.where(both, 0.5, np.where(before, 1.0, 0.0)) / h

    def combine(x: Array, a: Array, b: Array) -> Array:
        return aligned(forward, x) * (a - x) + aligned(backward, x) * (x - b)

    return combined(combine, here, higher, lower)
