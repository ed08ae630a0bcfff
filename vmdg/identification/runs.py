"""The file of the runs of an identification: for one model only, checked, locked, written whole."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ..base.claims import Claim
from ..base.parallel import global_max, global_sum, raise_together
from ..checkpoint.identity import differences, identity
from ..problem.problem import Problem
from ..solver.options import SolveOptions

#: Version of the file.
FORMAT = 2

#: Length of the longest description of a difference.
LONGEST = 160

#: Options that do not change what a run gives.
_SHOWN = ("progress", "show", "verbose", "csv", "checkpoint", "checkpoint_every")


class RunFile:
    """Runs by their parameters in a JSON file; all methods are collective."""

    def __init__(self, comm: MPI.Comm, path: str | Path | None):
        self._comm, self._path = comm, None if path is None else Path(path)
        self._head: dict[str, Any] = {}
        self.runs: dict[str, Any] = {}

    @property
    def kept(self) -> bool:
        return self._path is not None

    def claimed(self) -> AbstractContextManager:
        """The exclusive right to write the file.

        Raises:
            OSError: another process writes it.
        """
        if self._path is None:
            return nullcontext()
        lock = self._path.with_name(f".{self._path.name}.lock")
        return Claim(self._comm, lock, f"the file of runs {self._path}", nested=True)

    def first(self) -> dict[str, float] | None:
        """Parameters at which the model of the file is described; None without a file.

        Raises:
            ValueError: it is no file of runs, or damaged.
        """
        message, content = None, None
        if self._path is not None and self._comm.rank == 0 and self._path.is_file():
            try:
                content = _checked(self._path.read_bytes())
            except (OSError, ValueError) as error:
                message = (
                    f"identify: {self._path} cannot be read: {error}; give another file, or delete "
                    "it"
                )
        raise_together(self._comm, message)
        content = self._comm.bcast(content)
        if content is None:
            return None
        self._head, self.runs = content["head"], content["runs"]
        return self._head["at"]

    def accept(self, head: Mapping[str, Any]) -> None:
        """Use the file for a model with this description, or begin one.

        Raises:
            ValueError: the runs in it are those of another model.
        """
        head = json.loads(json.dumps(head))
        if self._head and (found := _differences(self._head, head)):
            raise ValueError(
                f"identify: {self._path} has runs of another model: {'; '.join(found[:3])}. Give "
                "another file, or delete it"
            )
        self._head = head

    def add(self, key: str, run: Any) -> None:
        self.runs[key] = run
        message = None
        if self._path is not None and self._comm.rank == 0:
            try:
                self._write()
            except OSError as error:
                message = (
                    f"identify: {self._path} cannot be written: {error}; free some space or choose "
                    "a file in a writable folder"
                )
        raise_together(self._comm, message, OSError)

    def _write(self) -> None:
        """Write a file next to it, and put it in its place when it is whole."""
        assert self._path is not None
        self._path.parent.mkdir(parents=True, exist_ok=True)
        content = json.dumps({"head": self._head, "runs": self.runs})
        near = self._path.with_name(f".{self._path.name}.part")
        with near.open("w") as file:
            file.write(f'{{"format": {FORMAT}, "sum": "{_sum(content)}", "content": {content}}}')
            file.flush()
            os.fsync(file.fileno())
        near.replace(self._path)


def _sum(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()


def _checked(text: bytes) -> dict[str, Any]:
    """What a file says.

    Raises:
        ValueError: it is no file of runs, or damaged.
    """
    try:
        found = json.loads(text)
    except ValueError:
        raise ValueError("it is no file of runs, or was truncated") from None
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise ValueError(f"it is no file of runs of this version (format {FORMAT})")
    if found.get("sum") != _sum(json.dumps(found.get("content"))):
        raise ValueError("it was changed after it was written")
    return found["content"]


def _flat(description: Mapping[str, Any], of: str = "") -> dict[str, Any]:
    """A description with the names of its parts joined."""
    found: dict[str, Any] = {}
    for name, value in description.items():
        found |= _flat(value, f"{of}{name}, ") if isinstance(value, dict) else {of + name: value}
    return found


def _differences(stored: Mapping[str, Any], present: Mapping[str, Any]) -> list[str]:
    one, other = _flat(stored), _flat(present)
    lines = [
        (name, line)
        for name in dict.fromkeys([*one, *other])
        for line in differences(
            *({name: many[name]} if name in many else {} for many in (one, other))
        )
    ]
    return [line if len(line) < LONGEST else f"{name}: differs" for name, line in lines]


def of_options(options: SolveOptions) -> dict[str, str]:
    """Options that change what a run gives, as text."""
    return {k: repr(v) for k, v in asdict(options).items() if k not in _SHOWN}


def of_model(problem: Problem, loads: NDArray[np.float64]) -> dict[str, Any]:
    """Mesh, bodies and interfaces, as of a checkpoint, and loads at their load factors; collective.

    Supports and dead loads are compared by their resultants and first moments, other loads by their
    largest values.
    """
    return {"model": identity(problem), "loading": _of_loads(problem, loads)}


def _of_loads(problem: Problem, loads: NDArray[np.float64]) -> dict[str, Any]:
    comm, loading = problem.comm, problem.loading
    bs = problem.space.dofmap.index_map_bs
    x = np.repeat(problem.space.tabulate_dof_coordinates(), bs, axis=0)
    local, owned = len(x), problem.space.dofmap.index_map.size_local * bs
    component = np.arange(local) % bs
    kinds = [load.kind for load in loading.loads]
    found: dict[str, list[float]] = {kind: [] for kind in kinds}
    for t in loads:
        held, dead, *others = loading.check_finite(float(t))
        dofs = loading.prescribed
        mine = dofs < owned
        moved = np.zeros(local)
        moved[dofs[mine]] = held[mine]
        # Loads are not yet added to owners, so that all local dofs count.
        for kind, values in zip(kinds, (moved, dead[:local]), strict=False):
            by_component = values[:, None] * (component[:, None] == np.arange(bs))
            moments = np.vstack([by_component.sum(axis=0), x.T @ by_component])
            found[kind] += global_sum(comm, moments).ravel().tolist()
        for kind, values in zip(kinds[2:], others, strict=True):
            found[kind].append(global_max(comm, float(np.abs(values).max(initial=0.0))))
    dofs = global_sum(comm, int((loading.prescribed < owned).sum()))
    return found | {"number of prescribed dofs": int(dofs)}
