"""The protocol of a load step."""

from __future__ import annotations

from .states import RunScales


class Step:
    """What a solver does with a problem in a load step.

    Attributes:
        scales: Largest forces and work of the run so far; the solver updates them.
    """

    def __init__(self):
        self.scales = RunScales()
