"""A measured curve, and the same curve of a run with its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..output.history import History

Array = NDArray[np.float64]


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
        column: Column of the values, without its unit.
        along: Column of the abscissae.
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

    def of_run(self, history: History, names: Sequence[str]) -> tuple[Array, Array]:
        """The values of a run at the abscissae (n,), and p d/dp of them by every parameter (n, k).

        Between two rows the curve is straight. Abscissae that the run does not reach have the value
        at the nearest point of the remaining path.

        Args:
            history: Of a run with derivatives by these parameters.
            names: Names of the parameters.

        Raises:
            KeyError: there is no such column.
        """
        x, y = (np.concatenate([[0.0], history[name]]) for name in (self.along, self.column))
        rates = [
            np.vstack([np.zeros(len(names)), _known(history, column, names)])
            for column in (self.along, self.column)
        ]
        values, slopes, start = np.empty(len(self.x)), np.empty((len(self.x), len(names))), 0.0
        for i, target in enumerate(self.x):
            if np.isinf(target):
                top = int(y.argmax())
                values[i], slopes[i] = y[top], rates[1][top]
                continue
            start = place = _place(x, target, start)
            j = min(int(place), len(x) - 2)
            w = place - j
            ends = slice(j, j + 2)
            dx, dy = ((1 - w) * rate[j] + w * rate[j + 1] for rate in rates)
            values[i] = (1 - w) * y[j] + w * y[j + 1]
            rise, run = np.diff(y[ends])[0], np.diff(x[ends])[0]
            reached = abs((1 - w) * x[j] + w * x[j + 1] - target) <= 1e-9 * np.abs(x).max()
            slopes[i] = dy - (dx * rise / run if reached and run != 0 else 0.0)
        return values, slopes


def _known(history: History, column: str, names: Sequence[str]) -> Array:
    """Derivatives of a column (rows, k); those of a jump are that of the next row."""
    found = np.column_stack([history[f"d {column}/d {name}"] for name in names])
    for i in range(len(found) - 2, -1, -1):
        found[i] = np.where(np.isnan(found[i]), found[i + 1], found[i])
    return np.nan_to_num(found)


def _place(x: Array, target: float, start: float) -> float:
    """Where a path first has an abscissa after a place: number of a point, and fraction of the way
    to the next one; where it comes nearest if it does not reach it.

    Args:
        x: Abscissae of the points of the path.
        target: The abscissa.
        start: The place after which to look.
    """
    j, w = min(int(start), len(x) - 2), start - min(int(start), len(x) - 2)
    here = (1 - w) * x[j] + w * x[j + 1]
    rest, places = np.append(here, x[j + 1 :]), np.append(start, np.arange(j + 1, len(x)))
    off = rest - target
    if off[0] == 0:
        return start
    passed = np.flatnonzero(off[1:] * off[0] <= 0)
    if not passed.size:
        return float(places[np.abs(off).argmin()])
    i = int(passed[0])
    share = off[i] / (off[i] - off[i + 1])
    return float(places[i] + share * (places[i + 1] - places[i]))
