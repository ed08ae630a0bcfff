"""The table of a run: one row a converged load step."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_WITH_UNIT = re.compile(r"(.*\S)\s+\[([^\[\]]*)\]")


def split_unit(column: str) -> tuple[str, str | None]:
    """Name and unit of a column called "force [N]", for example; None where it says no unit."""
    found = _WITH_UNIT.fullmatch(column)
    return (found[1], found[2]) if found else (column, None)


class History:
    """Rows of named values; ``history["load"]`` is a column.

    A name may say its unit once, in square brackets: a row with "force [N]" adds to the column
    "force", whose unit is N from then on.

    Attributes:
        rows: Values by name, without units.
        units: Unit of the columns that say one, "-" for pure numbers.
    """

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        self.units: dict[str, str] = {}

    def append(self, row: Mapping[str, Any]) -> None:
        """Add a row.

        Args:
            row: Values by name, with or without a unit.

        Raises:
            ValueError: a name occurs twice, or with another unit than before.
        """
        plain: dict[str, Any] = {}
        for column, value in row.items():
            name, unit = split_unit(column)
            if name in plain:
                raise ValueError(
                    f"history: the row has two values called {name!r}; rename one of them (what a "
                    "monitor returns must not be called as a column that the run has by itself)"
                )
            if unit is not None and self.units.setdefault(name, unit) != unit:
                raise ValueError(
                    f"history: column {name!r} is in {self.units[name]} so far, now in {unit}; "
                    "give it one unit"
                )
            plain[name] = value
        self.rows.append(plain)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def columns(self) -> list[str]:
        """Names of all columns, in order of first appearance."""
        return list(dict.fromkeys(name for row in self.rows for name in row))

    @property
    def header(self) -> list[str]:
        """Names of all columns, with their units."""
        return [
            f"{name} [{self.units[name]}]" if name in self.units else name for name in self.columns
        ]

    def __getitem__(self, column: str) -> NDArray:
        name = column if column in self.columns else split_unit(column)[0]
        if name not in self.columns:
            raise KeyError(f"history has no column {column!r}; it has {self.columns}")
        return np.array([row.get(name, np.nan) for row in self.rows])

    def to_csv(self, path: str | Path) -> None:
        """Write the table with a header line, "force [N]" where a unit is known.

        Arrays are written as lists; what a row does not have is left empty.

        Args:
            path: The file.
        """
        with open(path, "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(self.header)
            writer.writerows(lines(self.rows, self.columns))

    @classmethod
    def from_csv(cls, path: str | Path) -> History:
        """Read a table that :meth:`to_csv` or a run has written.

        Numbers, lists and words keep their kind; a word that reads like a number becomes one.

        Args:
            path: The file.
        """
        history = cls()
        with open(path, newline="") as file:
            for row in csv.DictReader(file):
                history.append({name: _value(text) for name, text in row.items() if text})
        return history


def lines(rows: Iterable[Mapping[str, Any]], columns: Sequence[str]) -> Iterator[list[str]]:
    """Rows as a CSV file with these columns has them."""
    for row in rows:
        yield [_text(row[name]) if name in row else "" for name in columns]


def _text(value: Any) -> str:
    if hasattr(value, "tolist"):
        value = value.tolist()
    return value if isinstance(value, str) else json.dumps(value, default=str)


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text
