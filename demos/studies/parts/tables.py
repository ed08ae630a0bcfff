"""Tables of the pages, where studies write them, and progress bars."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from mpi4py import MPI

from matplotlib.figure import Figure
from tqdm import tqdm


def progress(items: Iterable, unit: str, shown: bool = True) -> tqdm:
    """The items with a bar, which writes a line now and then where the output is a file."""
    return tqdm(
        items, unit=unit, mininterval=0.1 if sys.stderr.isatty() else 30.0, disable=not shown
    )


def markdown(head: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    """A Markdown table; floats with four digits.

    Args:
        rows: Cells of every line, as they are to be shown.
    """

    def shown(cell: object) -> str:
        return f"{cell:.4g}" if isinstance(cell, float) else str(cell)

    first, *others = (f"| {' | '.join(map(shown, cells))} |" for cells in [head, *rows])
    return "\n".join([first, "|" + "---|" * len(head), *others])


def report(out: str, name: str, text: str, figure: Figure | None = None) -> None:
    """Print a table, and write it and a picture to the folder ``out``, on the first rank."""
    if MPI.COMM_WORLD.rank > 0:
        return
    print(f"{text}\n\nresults are in {out}")
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.md").write_text(text + "\n")
    if figure is not None:
        figure.savefig(folder / f"{name}.png")
