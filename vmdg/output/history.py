"""The history of a run, one row per converged load step, and its file."""

from __future__ import annotations

import csv
import io
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, KeysView, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, SupportsIndex, overload

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ..base.claims import Claim
from ..base.disk import put_aside, replacing
from ..base.door import door
from ..base.parallel import raise_together
from ..base.tables import html_table, short
from ..base.words import checked_path, pip_install

if TYPE_CHECKING:
    from pandas import DataFrame

_WITH_UNIT = re.compile(r"(.*\S)\s+\[([^\[\]]*)\]")


def split_unit(column: str) -> tuple[str, str | None]:
    """Name and unit of a column such as "force [N]"; None without a unit."""
    found = _WITH_UNIT.fullmatch(column)
    return (found[1], found[2]) if found else (column, None)


class History:
    """Rows of named values; ``history["load"]`` is a column, ``history[-1]`` the last row by name,
    and ``history[10:]`` a history of some rows.

    A name may include its unit in square brackets: a row with "force [N]" adds to the column
    "force" with unit N.

    Attributes:
        rows: Values by name, without units.
        units: Units of columns that have one, "-" for pure numbers.
    """

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        self.units: dict[str, str] = {}

    @door
    def append(self, row: Mapping[str, Any]) -> None:
        """Add a row.

        Args:
            row: Values by name, with or without a unit.

        Raises:
            ValueError: a name occurs twice, or with a different unit than before.
        """
        plain: dict[str, Any] = {}
        for column, value in row.items():
            name, unit = split_unit(column)
            if name in plain:
                raise ValueError(
                    f"history: the row has two values called {name!r}; rename one of them (a "
                    "monitor must not use names of the standard columns)"
                )
            if unit is not None and self.units.setdefault(name, unit) != unit:
                raise ValueError(
                    f"history: column {name!r} is in {self.units[name]} so far, now in {unit}; use "
                    "one unit"
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

    def __contains__(self, column: object) -> bool:
        return isinstance(column, str) and self._name(column) is not None

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def keys(self) -> KeysView[str]:
        """Names of all columns, so that ``dict(history)`` is a dictionary of columns."""
        return dict.fromkeys(self.columns).keys()

    @overload
    def __getitem__(self, key: str) -> NDArray: ...

    @overload
    def __getitem__(self, key: SupportsIndex) -> dict[str, Any]: ...

    @overload
    def __getitem__(self, key: slice) -> History: ...

    def __getitem__(self, key: str | SupportsIndex | slice) -> NDArray | dict[str, Any] | History:
        """A column by its name, with or without its unit; a row by its number; or some rows.

        Raises:
            KeyError: there is no such column.
            IndexError: there is no such row.
        """
        if isinstance(key, slice):
            return self._of(self.rows[key])
        if isinstance(key, SupportsIndex):
            return self._row(key)
        name = self._name(key)
        if name is None:
            raise KeyError(f"history has no column {key!r}; it has {self.columns}")
        return np.array([row.get(name, np.nan) for row in self.rows])

    def _row(self, number: SupportsIndex) -> dict[str, Any]:
        try:
            return dict(self.rows[number])
        except IndexError:
            raise IndexError(f"history has {len(self)} rows, and none of number {number}") from None

    def _of(self, rows: Iterable[dict[str, Any]]) -> History:
        result = History()
        result.units, result.rows = dict(self.units), list(rows)
        return result

    def _name(self, column: str) -> str | None:
        """The name of a column that may be given with its unit; None if no row has it."""
        names = column, split_unit(column)[0]
        return next((name for name in names for row in self.rows if name in row), None)

    @door
    def peak(self, column: str = "load") -> float:
        """The largest value of a column, in its unit.

        A run has rows between the given load factors where the force on the supports is largest and
        where the load turns back, so that a peak hardly depends on their number.

        Raises:
            KeyError: there is no such column.
            ValueError: no row has a number there.
        """
        values = self[column].astype(float)
        if np.isnan(values).all():
            raise ValueError(f"history: no row has a number in column {column!r}")
        return float(np.nanmax(values))

    @door
    def envelope(self, column: str = "load") -> History:
        """The rows at which a column is larger than in all rows before.

        For an equilibrium path with decreasing load factors, these are the states that a machine
        with monotonic load or displacement passes.

        Raises:
            KeyError: there is no such column.
        """
        values = self[column]
        before = np.maximum.accumulate(np.concatenate([[-np.inf], values[:-1]]))
        return self._of(self.rows[i] for i in np.flatnonzero(values > before))

    def __repr__(self) -> str:
        size = f"{len(self)} rows x {len(self.columns)} columns"
        last = [f"{name}={short(value)}" for row in self.rows[-1:] for name, value in row.items()]
        return f"<History: {size}{'; last row: ' if last else ''}{', '.join(last)}>"

    def _repr_html_(self) -> str:
        rows = [[row.get(name, "") for name in self.columns] for row in self.rows]
        if len(rows) > 21:
            rows[10:-10] = [["..."] * len(self.columns)]
        return html_table(self.header, rows)

    def to_pandas(self) -> DataFrame:
        """The history as a pandas data frame, with units in ``attrs["units"]``.

        Raises:
            ImportError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise ImportError(
                f"History.to_pandas needs pandas ({error}): {pip_install('pandas')} (Debian's own "
                "Python: apt install python3-pandas; conda install pandas); or use to_csv"
            ) from error
        frame = pandas.DataFrame(self.rows, columns=self.columns)
        frame.attrs["units"] = dict(self.units)
        return frame

    @door
    def to_csv(self, path: str | Path) -> None:
        """Write the history with a header line, "force [N]" for a column with a unit.

        Arrays are written as lists; missing values are empty.

        Args:
            path: The file.
        """
        Path(path).write_bytes(self._as_csv())

    def _as_csv(self) -> bytes:
        return _csv([self.header, *_lines(self.rows, self.columns)])

    @classmethod
    @door
    def from_csv(cls, path: str | Path) -> History:
        """Read a history written by :meth:`to_csv` or a run.

        Numbers, lists and words keep their type; a word that reads like a number becomes one.

        Args:
            path: The file.
        """
        history = cls()
        place = checked_path("History.from_csv: path", path)
        with open(place, newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                history.append({name: _value(text) for name, text in row.items() if text})
        return history


#: json.dumps makes one for every call with an option.
_JSON = json.JSONEncoder(default=str)


def _lines(rows: Iterable[Mapping[str, Any]], columns: Sequence[str]) -> Iterator[list[str]]:
    for row in rows:
        yield [_text(row[name]) if name in row else "" for name in columns]


def _csv(lines: Iterable[Sequence[str]]) -> bytes:
    text = io.StringIO(newline="")
    csv.writer(text).writerows(lines)
    return text.getvalue().encode()


def _text(value: Any) -> str:
    if hasattr(value, "tolist"):
        value = value.tolist()
    return value if isinstance(value, str) else _JSON.encode(value)


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text


class HistoryFile:
    """A CSV file of the history that is complete whenever a run is killed.

    A row is one line, written and flushed at once, completely or not at all if the disk is full. A
    new column changes the header: then a new file is written and replaces the old one atomically.
    The same happens at the start, when a run that continues from a checkpoint finds rows that it
    will repeat. Anything else of this name is kept: history.csv becomes history.1.csv, etc. Only
    one run at a time may write the file.
    """

    def __init__(self, comm: MPI.Comm, path: str | Path | None, history: History):
        self._comm = comm
        self._path = None if path is None else checked_path("history: csv", path).absolute()
        self._history = history
        self._file: BinaryIO | None = None
        self._claim: Claim | None = None
        if self._path is not None:
            lock = self._path.with_name(f".{self._path.name}.lock")
            self._claim = Claim(comm, lock, f"the table {path}")
        self._columns: list[str] = []
        self._units: dict[str, str] = {}
        self._written = 0
        try:
            self._do(self._begin)
        except OSError:
            self.close()
            raise

    def update(self) -> None:
        """Append the rows added since the last call; collective."""
        self._do(self._extend)

    def _do(self, action: Callable[[], None]) -> None:
        if self._path is None:
            return
        message = None
        if self._comm.rank == 0:
            try:
                action()
            except OSError as error:
                message = (
                    f"the table {self._path} cannot be written: {error}; free some space or choose "
                    "a file in a writable folder"
                )
        raise_together(self._comm, message, OSError)

    def _begin(self) -> None:
        assert self._path is not None
        if os.path.lexists(self._path) and not self._continues(self._path):
            put_aside(self._path)
        self._replace()

    def _continues(self, path: Path) -> bool:
        if not path.stat().st_size:
            return True
        try:
            with open(path, newline="", encoding="utf-8") as file:
                header, *lines = csv.reader(file)
        except (ValueError, csv.Error):
            return False
        rows = list(_lines(self._history.rows, [split_unit(column)[0] for column in header]))
        return bool(rows) and lines[: len(rows)] == rows

    def _check_place(self) -> None:
        """An OSError where the file has been removed or replaced."""
        assert self._path is not None and self._file is not None
        try:
            there = os.path.samestat(os.fstat(self._file.fileno()), os.stat(self._path))
        except FileNotFoundError:
            there = False
        if not there:
            raise OSError("it was removed or replaced while the run wrote it")

    def _extend(self) -> None:
        self._check_place()
        rows = self._history.rows[self._written :]
        new = any(name not in self._columns for row in rows for name in row)
        if new or self._history.units != self._units:
            self._replace()
            return
        assert self._file is not None
        whole = self._file.tell()
        try:
            left = memoryview(_csv(_lines(rows, self._columns)))
            while left:
                left = left[self._file.write(left) :]
        except OSError:
            self._file.truncate(whole)
            raise
        self._written += len(rows)

    def _replace(self) -> None:
        assert self._path is not None
        self._close_file()
        with replacing(self._path) as file:
            file.write(self._history._as_csv())
        self._file = open(self._path, "ab", buffering=0)  # closed by close()
        self._columns, self._written = self._history.columns, len(self._history)
        self._units = dict(self._history.units)

    def close(self) -> None:
        self._close_file()
        if self._claim is not None:
            self._claim.release()

    def _close_file(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def __enter__(self) -> HistoryFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
