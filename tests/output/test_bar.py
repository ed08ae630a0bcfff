"""Bars of runs and of studies: what they show, and how often."""

from __future__ import annotations

import sys
from io import StringIO
from time import sleep

import numpy as np
import pytest
from parts.tables import progress

import vmdg
from vmdg.output.bar import interval, shown


def test_forces_by_name():
    """Columns called force or reaction, alone or with other words, three at most; no arrays."""
    history = vmdg.History()
    names = ["reinforced", "force", "Force_x", "top_reaction", "force_y"]
    history.append({"forces": 1.0, "reaction_all": np.zeros(2)} | dict.fromkeys(names, 1.0))
    assert shown(history, None) == ["force", "Force_x", "top_reaction"]
    assert shown(history, "forces") == ["forces"]


@pytest.mark.parametrize(("terminal", "longest"), [(True, 1.0), (False, 60.0)])
def test_seconds_between_lines(monkeypatch, terminal, longest):
    """Bars of runs and of studies write a line now and then in a file."""
    monkeypatch.setattr("sys.stderr", Stream(terminal))
    assert longest / 10 <= interval() <= longest
    for _ in progress(range(5), "run"):
        sleep(0.15)
    assert terminal == (sys.stderr.getvalue().count("\r") > 4)


class Stream(StringIO):
    """A file, or a terminal."""

    def __init__(self, terminal: bool):
        super().__init__()
        self._terminal = terminal

    def isatty(self) -> bool:
        return self._terminal
