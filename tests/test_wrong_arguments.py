"""Generated wrong arguments of every public name end in words, never in an error from inside.

VMDG_CALLS is their number, VMDG_SEED draws others.
"""

from __future__ import annotations

import inspect
import os
import random
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from support.problems import joined

import vmdg
from vmdg import meshes
from vmdg.meshes import blocks

CALLS, SEED = (int(os.environ.get(f"VMDG_{name}", n)) for name, n in (("CALLS", 200), ("SEED", 1)))

#: Errors whose words are the system's or Python's own: they name a file, or an argument.
NAMED = (OSError, ImportError, vmdg.StepFailure)

ROOT = str(Path(vmdg.__file__).resolve().parent.parent)

#: Numbers, words, containers, arrays and functions that hardly anything accepts.
JUNK: list[Any] = [
    None,
    True,
    -1,
    0,
    3,
    10**9,
    2**70,
    -2.5,
    0.0,
    1e308,
    np.nan,
    np.inf,
    -np.inf,
    1j,
]
JUNK += ["", "x", "bond", "1", b"x", [], [1], [1, "a"], [None], [np.nan], (), (1, 2, 3), set()]
JUNK += [{}, {"a": 1}, {1: None}, {3: 4}, {"bond.strength": -1.0}, range(3), np.float32(1), object]
JUNK += [np.zeros(0), np.zeros(3), np.zeros((3, 3)), np.full((2, 2), np.nan), np.array(["a"])]
JUNK += [np.array(None), np.array([1 + 2j]), object(), MPI.COMM_WORLD]
JUNK += [lambda: 0, lambda *a: None, lambda *a: "x", lambda *a: np.nan, lambda *a: [1, 2]]


def scene() -> tuple[dict[str, Any], dict[str, Callable]]:
    """Right values by the names of arguments, and all calls by name."""
    tagged = blocks(MPI.COMM_WORLD, "quadrilateral", (2, 2))
    problem = joined(tagged, vmdg.Debonding(15.0, 0.05))
    body = vmdg.NeoHookean(E=1000.0, nu=0.3)
    right = {
        "E": 1000.0,
        "nu": 0.3,
        "strength": 15.0,
        "critical_gap": 0.05,
        "yield_stress": 10.0,
        "mesh": tagged.mesh,
        "cell_tags": tagged.cell_tags,
        "tags": tagged.cell_tags,
        "names": {"a": 1},
        "materials": {1: body, 2: body},
        "interfaces": [vmdg.Interface(between=(1, 2), law=vmdg.Bonded())],
        "problem": problem,
        "loads": [1e-3],
        "times": [1e-6],
        "make_problem": lambda values: (problem, lambda p: {}),
        "measured": vmdg.Curve([0.1, 0.2], [1.0, 2.0]),
        "start": {"bond.strength": 1.0},
        "folder": "folder",
        "interface": 0,
        "quantity": "opening",
        "comm": MPI.COMM_WORLD,
        "function": lambda x: x[0],
    }
    calls = {n: getattr(vmdg, n) for n in vmdg.__all__ if n != "ModelWarning"}
    calls |= {f"meshes.{name}": getattr(meshes, name) for name in meshes.__all__}
    for of in (problem, vmdg.History(), vmdg.Debonding(15.0, 0.05)):
        public = [n for n in dir(type(of)) if n[0] != "_" and callable(getattr(type(of), n))]
        if isinstance(of, vmdg.Law):
            public = ["return_map"]
        methods = {f"{type(of).__name__}.{name}": getattr(of, name) for name in public}
        calls |= {name: method for name, method in methods.items() if inspect.ismethod(method)}
    other = blocks(MPI.COMM_WORLD, "triangle", (1, 1))
    JUNK.extend([*other, *tagged, problem, body])
    return right, calls


def said(error: Exception) -> bool:
    """Whether an error was raised on purpose: the last line is one of ours, and a ``raise``."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    ours = str(Path(last.filename).resolve()).startswith(ROOT) and "/tests/" not in last.filename
    of_call = "required" in str(error) or "unexpected keyword" in str(error)
    return isinstance(error, NAMED) or of_call or (ours and "raise" in (last.line or ""))


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="a wrong argument of one rank is another test")
def test_words(tmp_path, monkeypatch):
    """One argument of each call is wrong, the others are right or missing."""
    monkeypatch.chdir(tmp_path)
    right, calls = scene()
    draw, raw = random.Random(SEED), []
    names = sorted(calls)
    for number in range(CALLS):
        name = names[number % len(names)]
        parameters = [
            one
            for one in inspect.signature(calls[name]).parameters.values()
            if one.kind in (one.POSITIONAL_OR_KEYWORD, one.KEYWORD_ONLY)
        ]
        if not parameters:
            continue
        wrong = draw.choice(parameters).name
        given = {p.name: right.get(p.name, 1.0) for p in parameters if p.default is p.empty}
        given[wrong] = draw.choice(JUNK)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                calls[name](**given)
            except Exception as error:
                if not said(error):
                    raw.append(f"{name}({wrong}={given[wrong]!r:.60}): {type(error)}: {error}")
    assert not raw, "\n".join(raw)
