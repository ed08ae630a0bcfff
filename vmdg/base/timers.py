"""Timers of vmdg and their readings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter
from typing import NamedTuple

#: Runs and seconds of every timer so far on this rank.
_measured: dict[str, tuple[int, float]] = {}


class Timing(NamedTuple):
    """What a timer has measured on this rank; ``seconds`` of wall time."""

    name: str
    runs: int
    seconds: float  # Wall time [s]


@contextmanager
def timer(name: str) -> Iterator[None]:
    """Measure the body of a with statement.

    Those of DOLFINx ask the operating system for processor times, which in a busy virtual machine
    takes up to a millisecond, a sixth of a run with some thousand unknowns.
    """
    begin = perf_counter()
    try:
        yield
    finally:
        runs, seconds = _measured.get(name, (0, 0.0))
        _measured[name] = runs + 1, seconds + perf_counter() - begin


def timings() -> dict[str, Timing]:
    return {name: Timing(name, *measured) for name, measured in _measured.items()}


def timings_since(before: Mapping[str, Timing]) -> list[Timing]:
    """Timings since :func:`timings` returned ``before``, longest first."""
    found = []
    for name, (_, runs, seconds) in timings().items():
        _, former_runs, former_seconds = before.get(name, Timing(name, 0, 0.0))
        if runs > former_runs:
            found.append(Timing(name, runs - former_runs, seconds - former_seconds))
    return sorted(found, key=lambda timing: -timing.seconds)
