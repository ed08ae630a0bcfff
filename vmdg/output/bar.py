"""A progress bar of a run or a study, with the last row of its history."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from .history import History, split_unit

#: Update interval of the bar in seconds on a terminal, and in a file, where each update is a new
#: line.
TERMINAL, FILE = 0.1, 30.0

#: Name patterns of force columns, and the number of columns in the bar.
FORCES, MOST = ("force", "reaction"), 3

BAR = "{desc}{percentage:3.0f}%|{bar:8}| {n:.4g}/{total:.0f} [{elapsed}<{remaining}]{postfix}"


def interval() -> float:
    """Update interval of a bar in seconds; longer if the output is a file."""
    return TERMINAL if sys.stderr.isatty() else FILE


def shown(history: History, wanted: Sequence[str] | str | None) -> list[str]:
    """Columns of the last row that the bar shows: those wanted, else the first ones called force or
    reaction, possibly with suffixes as in "force_x"."""
    row = history.rows[-1]
    if wanted is None:
        forces = [name for name in row if set(name.lower().split("_")) & set(FORCES)]
        return [name for name in forces if np.ndim(row[name]) == 0][:MOST]
    names = [split_unit(name)[0] for name in ([wanted] if isinstance(wanted, str) else wanted)]
    if missing := [name for name in names if name not in row]:
        raise ValueError(
            f"SolveOptions: show = {wanted!r}: the history has no column {missing[0]!r}, only "
            f"{', '.join(row)}"
        )
    return names


def row_in_words(history: History, wanted: Sequence[str] | str | None) -> list[str]:
    row, names = history.rows[-1], shown(history, wanted)
    columns = [f"{name} {_text(row[name])}{_unit(history, name)}" for name in names]
    where = "load" if "load" in row else "time"
    return [f"{where} {row[where]:.4g}", *columns]


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float | np.floating) else str(value)


def _unit(history: History, name: str) -> str:
    unit = history.units.get(name, "-")
    return "" if unit == "-" else f" {unit}"
