"""A measured curve, and the same curve of a run with its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..output.history import History, split_unit

Array = NDArray[np.float64]


class Compared(NamedTuple):
    """What a run has in the place of n measured values."""

    values: Array  # The values (n,)
    slopes: Array  # Their derivatives by k parameters (n, k)
    reached: bool


@dataclass(frozen=True)
class Curve:
    """A measured curve: values of one column of the history over another one.

    Where the path of a run turns back its curve is no function of the abscissa. So the points are
    taken in the order in which they were measured: each is where the run reaches its abscissa for
    the first time after the point before. A machine that jumps over a snap-back is compared with
    the branches that it passes.

    Args:
        x: Abscissae in the order of the measurement (n,); ``np.inf`` for the largest value of all.
        y: Measured values (n,).
        column: Column of the values, with its unit where pictures are to have it.
        along: Column of the abscissae, likewise.
        sigma: Standard deviation of the noise of the values, one number or (n,); None for that of
            :func:`vmdg.identify`.

    Raises:
        ValueError: shapes do not match, a value is not finite, or a deviation not positive.
    """

    x: Any
    y: Any
    column: str = "force"
    along: str = "load"
    sigma: Any = field(default=None, kw_only=True)

    #: Number of unknown motions that are removed from the residuals.
    nuisances = 0

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            values = np.array(getattr(self, name), dtype=float)
            object.__setattr__(self, name, values)
            known = np.isfinite(values) | ((name == "x") & np.isposinf(values))
            if values.ndim != 1 or not len(values) or not known.all():
                raise ValueError(f"Curve: {name} must be an array of finite numbers (n,)")
        if self.x.shape != self.y.shape:
            raise ValueError(f"Curve: {len(self.x)} abscissae and {len(self.y)} values")
        if self.sigma is not None:
            sigma = np.broadcast_to(np.array(self.sigma, dtype=float), self.y.shape)
            if not (sigma > 0).all():
                raise ValueError("Curve: sigma must be positive")
            object.__setattr__(self, "sigma", sigma)

    @property
    def data(self) -> Array:
        """The measured values (n,)."""
        return self.y

    @property
    def places(self) -> dict[str, Any]:
        """Where it was measured, in JSON types."""
        return {"column": self.column, "along": self.along, "x": self.x.tolist()}

    @property
    def abscissae(self) -> Array:
        """Abscissa of every value (n,); that of the last one before a peak for the peak."""
        finite = np.isfinite(self.x)
        return np.where(finite, self.x, self.x[finite].max(initial=0.0))

    def draw(self, axes: Any, fitted: Array, sigma: Any) -> None:
        """Draw the measurement and a run.

        Args:
            axes: Of matplotlib.
            fitted: Values of the run (n,).
            sigma: Standard deviations (n,), or one; None for none.
        """
        bars = None if sigma is None else np.broadcast_to(sigma, self.y.shape)
        axes.errorbar(self.abscissae, self.y, bars, fmt="ko", ms=3, lw=0.8, label="measured")
        axes.plot(self.abscissae, fitted, "C0-", label="model")
        axes.set(ylabel=self.column)
        axes.legend()

    def at(self, i: int) -> str:
        """Name of value number i."""
        return f"the {self.column} at {self.along} {self.x[i]:.6g}"

    def without_nuisances(self, weighted: Array) -> Array:
        """Residuals, ``weighted`` (n,), or derivatives (n, k), without what is not compared."""
        return weighted

    def of_run(self, history: History, names: Sequence[str]) -> Compared:
        """The values of a run at the abscissae.

        Between two rows the curve is straight. Abscissae that the run does not reach have the value
        at the nearest point of the remaining path.

        Args:
            history: Of a run with derivatives by these parameters.
            names: Names of the parameters.

        Raises:
            KeyError: there is no such column.
        """
        peaks = np.isposinf(self.x)
        found = along_path(history, self.along, self.column, self.x[~peaks], names)
        values, slopes = np.empty(len(self.x)), np.empty((len(self.x), len(names)))
        values[~peaks], slopes[~peaks] = found.values[:, 0], found.slopes[:, 0]
        reached = found.reached
        if peaks.any():
            y, top = history[self.column], int(history[self.column].argmax())
            # A run that has not begun to fall may still rise.
            reached &= top < len(y) - 1
            values[peaks], slopes[peaks] = y[top], known_rates(history, self.column, names)[top, 0]
        return Compared(values, slopes, reached)


def along_path(
    history: History, along: str, column: str, targets: Array, names: Sequence[str]
) -> Compared:
    """Values of a column, of numbers or of arrays (N,), where a run has these abscissae.

    Args:
        targets: Abscissae (m,), each after the one before on the path.

    Returns:
        Values (m, N) and derivatives at fixed abscissae (m, N, k).
    """
    x, y = (_with_origin(_rows_of(history, name)) for name in (along, column))
    dx, dy = (_with_origin(known_rates(history, name, names)) for name in (along, column))
    x, dx, start, reached = x[:, 0], dx[:, 0], 0.0, True
    values = np.empty((len(targets), y.shape[1]))
    slopes = np.empty((*values.shape, len(names)))
    size = np.abs(x).max()
    for i, target in enumerate(targets):
        start, found = _place(x, target, start)
        reached &= found
        j = min(int(start), len(x) - 2)
        w, ends = start - j, slice(j, j + 2)
        parts = np.array([1 - w, w])
        values[i] = parts @ y[ends]
        slopes[i] = np.tensordot(parts, dy[ends], 1)
        run = x[j + 1] - x[j]
        if run != 0 and abs(parts @ x[ends] - target) <= 1e-9 * size:
            slopes[i] -= np.outer((y[j + 1] - y[j]) / run, parts @ dx[ends])
    return Compared(values, slopes, reached)


def _rows_of(history: History, column: str) -> Array:
    found = history[column]
    return found.reshape(len(found), -1)


def _with_origin(rows: Array) -> Array:
    """Rows after one of zeros, that of the undeformed state."""
    return np.concatenate([np.zeros((1, *rows.shape[1:])), rows])


def known_rates(history: History, column: str, names: Sequence[str]) -> Array:
    """Derivatives of a column (rows, N, k); those of a jump are that of the next row."""
    shape = (*_rows_of(history, column).shape, len(names))
    found, plain = np.empty(shape), split_unit(column)[0]
    for k, name in enumerate(names):
        found[..., k] = _rows_of(history, f"d {plain}/d {name}")
    for i in range(len(found) - 2, -1, -1):
        found[i] = np.where(np.isnan(found[i]), found[i + 1], found[i])
    return np.nan_to_num(found)


def _place(x: Array, target: float, start: float) -> tuple[float, bool]:
    """Where a path first has an abscissa after a place: number of a point, and fraction of the way
    to the next one; where it comes nearest if it does not reach it, and whether it does.
    """
    j, w = min(int(start), len(x) - 2), start - min(int(start), len(x) - 2)
    here = (1 - w) * x[j] + w * x[j + 1]
    rest, places = np.append(here, x[j + 1 :]), np.append(start, np.arange(j + 1, len(x)))
    off = rest - target
    if off[0] == 0:
        return start, True
    passed = np.flatnonzero(off[1:] * off[0] <= 0)
    if not passed.size:
        nearest = int(np.abs(off).argmin())
        return float(places[nearest]), bool(abs(off[nearest]) <= 1e-9 * np.abs(x).max())
    i = int(passed[0])
    share = off[i] / (off[i] - off[i + 1])
    return float(places[i] + share * (places[i + 1] - places[i])), True
