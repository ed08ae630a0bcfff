"""Progress bars of the studies."""

from __future__ import annotations

from collections.abc import Iterable

from tqdm import tqdm

from vmdg.output.bar import interval


def progress(items: Iterable, unit: str, shown: bool = True) -> tqdm:
    """The items with a bar, which writes a line now and then where the output is a file."""
    return tqdm(items, unit=unit, mininterval=interval(), disable=not shown)
