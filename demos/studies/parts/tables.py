"""Tables of the pages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def markdown(head: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    """A Markdown table.

    Args:
        head: Titles of the columns.
        rows: Cells of every line, as they are to be shown.
    """
    first, *others = (f"| {' | '.join(map(str, cells))} |" for cells in [head, *rows])
    return "\n".join([first, "|" + "---|" * len(head), *others])
