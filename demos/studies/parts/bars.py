"""Progress bars of the studies."""

from __future__ import annotations

import sys
from collections.abc import Iterable

from tqdm import tqdm


def progress(items: Iterable, unit: str, shown: bool = True) -> tqdm:
    """The items with a bar, which writes a line now and then where the output is a file."""
    return tqdm(
        items, unit=unit, mininterval=0.1 if sys.stderr.isatty() else 30.0, disable=not shown
    )
