"""Lines of the table, and the metal that several cases share."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from time import process_time
from typing import TypeVar

from parts.tables import markdown

import vmdg

T = TypeVar("T")

#: The steel of Simo's necking bar and of the membrane of Simo and Armero (1992).
STEEL = vmdg.J2(206.9e3, 0.29, 450.0, hardening=129.24, saturation=715.0, exponent=16.93)


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    case: str  # Name of the case
    quantity: str  # What is compared, with its unit
    computed: float  # By vmdg, with the interface
    reference: float  # What it is compared with
    source: str  # Where that comes from
    mesh: str  # Cells and degree
    seconds: float = 0.0  # Of processor time of the whole case, of this rank

    @property
    def error(self) -> float:
        return self.computed / self.reference - 1


def measured(case: Callable[[bool], tuple[list[Row], T]], coarse: bool) -> tuple[list[Row], T]:
    """The rows of a case with the time it took, and what else it gives."""
    start = process_time()
    rows, more = case(coarse)
    return [replace(row, seconds=process_time() - start) for row in rows], more


def table(rows: Iterable[Row]) -> str:
    return markdown(
        "case quantity computed reference difference source mesh s".split(),
        [
            (
                *(row.case, row.quantity, f"{row.computed:.5g}", f"{row.reference:.5g}"),
                *(f"{100 * row.error:+.2g} %", row.source, row.mesh, f"{row.seconds:.0f}"),
            )
            for row in rows
        ],
    )
