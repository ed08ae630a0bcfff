"""Timers of vmdg, in DOLFINx's table under "vmdg: ...", and their readings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from dolfinx.common import Timer

from .. import compat

_names: dict[str, None] = {}


class Timing(NamedTuple):
    """What a timer has measured on this rank; ``seconds`` of wall time."""

    name: str
    runs: int
    seconds: float  # Wall time [s]


def timer(name: str) -> Timer:
    """A timer "vmdg: ``name``", for a with statement."""
    _names.setdefault(name)
    return Timer(f"vmdg: {name}")


def timings() -> dict[str, Timing]:
    return {name: Timing(name, *compat.timing(f"vmdg: {name}")) for name in _names}


def timings_since(before: Mapping[str, Timing]) -> list[Timing]:
    """Timings since :func:`timings` returned ``before``, longest first."""
    found = []
    for name, (_, runs, seconds) in timings().items():
        _, former_runs, former_seconds = before.get(name, Timing(name, 0, 0.0))
        if runs > former_runs:
            found.append(Timing(name, runs - former_runs, seconds - former_seconds))
    return sorted(found, key=lambda timing: -timing.seconds)
