"""Messages for frequent mistakes: unknown names, text as numbers, functions of one point, paths."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def near(name: str, names: Iterable[str], others: Mapping[str, str] | None = None) -> str:
    """A "Did you mean ...?" for the end of a message; empty where no name is close."""
    lower = {name.lower(): name for name in names}
    lower |= {word.lower(): meant for word, meant in (others or {}).items()}
    close = dict.fromkeys(lower[word] for word in get_close_matches(name.lower(), lower, n=3))
    if name.lower() in lower:
        close = {lower[name.lower()]: None}
    return f". Did you mean {' or '.join(map(repr, close))}?" if close else ""


def pip_install(packages: str) -> str:
    return f"{os.environ.get('VMDG_PIP') or f'{sys.executable} -m pip install'} {packages}"


def checked_path(what: str, path: Any) -> Path:
    if not isinstance(path, str | PathLike):
        raise TypeError(f"{what} = {path!r} must be a str or a Path")
    return Path(path)


def as_numbers(values: Any) -> NDArray[np.float64]:
    """The user's values as an array of floats; numpy alone would convert text such as "3.0"."""
    array = np.asarray(values)
    if array.dtype.kind == "c":
        raise ValueError("it is complex; give its real part")
    if array.dtype.kind in "USO":
        for one in array.flat:
            if isinstance(one, str | bytes):
                raise ValueError(f"{str(one)!r} is text, not a number; write it without quotes")
    return array.astype(float, copy=False)


def at_points(function: Callable[..., Any], *arguments: Any, what: str = "") -> Any:
    """Call a user's function of points x (3, n)."""
    try:
        return function(*arguments)
    except ValueError as error:
        if "truth value" not in str(error):
            raise
        raise ValueError(
            f"{what}the function is called with all points at once, x (3, n); `and`, `or`, `not`, "
            "`if` and 0 < x[0] < 1 work for one point only: write (0 < x[0]) & (x[0] < 1), with | "
            "and ~ for the others, and np.where(x[0] < 1, a, b)"
        ) from error
