"""Derivatives of rows of the history, and of the works of a step."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..problem.states import Rate, Works
from .neighbours import Neighbours
from .parameters import Parameter
from .records import CHANGE, NEAR, shifted

#: Values by name for the current state of a problem.
Row = Callable[[], Mapping[str, Any]]

#: Relative change of a parameter for energies between two neighbours: small differences at finite
#: strain.
FAR = 1e-4


class Rows:
    """Derivatives of rows by parameters; all methods are collective."""

    def __init__(self, neighbours: Neighbours, parameters: Sequence[Parameter]):
        self._neighbours, self._problem = neighbours, neighbours.problem
        self._parameters = parameters

    def columns(self, row: Mapping[str, Any], watched: Row, energies: Row | None) -> dict[str, Any]:
        """Derivatives of a row of the history, of values by name with or without a unit, after the
        step is committed."""
        rates, found = self._problem.step.rates, {}
        names = [name for name, value in row.items() if isinstance(value, float | np.ndarray)]
        for parameter in self._parameters:
            rate = rates.by_name[parameter.name]
            changes = {"load": rate.t if rates.known else np.nan}
            near = self._near(parameter, rate, NEAR, watched) if rates.known else {}
            for name in names:
                changes[name] = (near[name] - row[name]) / NEAR if near else np.nan * row[name]
            if energies is not None:
                ends = [self._near(parameter, rate, h, energies) for h in (FAR, -FAR)]
                for name in ends[0]:
                    change = (ends[0][name] - ends[1][name]) / (2 * FAR)
                    changes[name] = change if rates.known else np.nan
            for name, change in changes.items():
                found[f"d {_plain(name)}/d {parameter.name}"] = change / parameter.value
        return found | {"frozen [-]": rates.jumps}

    def _near(self, parameter: Parameter, rate: Rate, h: float, row: Row) -> Mapping[str, Any]:
        """A row at p (1 + h)."""
        ledger = self._problem.step.ledger
        works = ledger.works
        # Not numbers if they are not known.
        moved = Works(np.full(3, np.nan), np.full(2, np.nan))
        if rate.works is not None:
            ends = (one.dissipated for one in rate.works)
            dissipated = works.dissipated + h * np.subtract(*ends) / (2 * CHANGE)
            moved = replace(works, dissipated=dissipated, pending=None)
        ledger.works = moved
        try:
            with self._neighbours.at(parameter, rate, h):
                return row()
        finally:
            ledger.works = works

    def works(self, parameter: Parameter, rate: Rate, last: Rate, h: float, before: Works) -> Works:
        problem, ledger = self._problem, self._problem.step.ledger
        start, loads = ledger.begun
        t = start.t + h * last.t
        if last.t and problem.loading.ray is not None:
            loads = problem.loading.at(problem.loading.dead, t)
        interfaces = [
            replace(one, history=shifted(one.history, other.history, h))
            for one, other in zip(start.interfaces, last.interfaces, strict=True)
        ]
        moved = replace(
            start,
            t=t,
            u=start.u + h * last.u,
            forces=start.forces + h * last.forces,
            interfaces=interfaces,
        )
        with self._neighbours.at(parameter, rate, h):
            return ledger.works_beside(moved, loads, before, finish=True)


def _plain(column: str) -> str:
    """A column without its unit."""
    return column.rpartition(" [")[0] or column
