"""Files that are written: what vmdg did not make is neither deleted nor cut."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import BinaryIO


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """A new file that takes the place of another one, atomically, when the block is complete."""
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        with open(partial, "xb") as file:
            yield file
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def put_aside(path: Path) -> None:
    """Keep what has this name: t.csv becomes t.1.csv, or the first number that is not used."""
    names = (path.with_name(f"{path.stem}.{number}{path.suffix}") for number in count(1))
    path.rename(next(name for name in names if not os.path.lexists(name)))


def plain_file(path: Path) -> bool:
    return path.is_file() and not path.is_symlink()
