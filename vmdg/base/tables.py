"""Values as text, and tables for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

#: Significant digits of numbers in text.
DIGITS = 6


def rounded(values: ArrayLike) -> list[Any]:
    numbers = np.asarray(values, dtype=float)
    largest = np.abs(numbers).max(initial=0.0)
    if not 0 < largest < np.inf:
        return numbers.tolist()
    return np.round(numbers, DIGITS - 1 - int(np.floor(np.log10(largest)))).tolist()


def short(value: Any) -> str:
    """A value as text, numbers with six digits."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def html_table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    lines = [("th", header), *(("td", row) for row in rows)]
    body = (
        "".join(f"<{cell}>{escape(short(value))}</{cell}>" for value in values)
        for cell, values in lines
    )
    return f"<table>{''.join(f'<tr>{line}</tr>' for line in body)}</table>"
