"""The state of a run on disk, to go on from after a crash."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .history import History
from .parallel import raise_together
from .point_values import HISTORY_ARRAYS, VALUE_ARRAYS, PointHistory, PointValues
from .problem import Problem, Snapshot

#: Two places that are written in turn, and the file that names the one that is complete.
_SLOTS, _LATEST = ("a", "b"), "latest"


def write_checkpoint(problem: Problem, folder: str | Path, history: History | None = None) -> None:
    """Write the converged state and the table of the run, one file a rank; collective.

    A checkpoint is complete or not visible: the ranks write beside the former one, which stays
    the valid one until all have written theirs.

    Args:
        problem: The problem.
        folder: Made if missing; holds this checkpoint and the former one.
        history: The table so far.
    """
    comm, folder = problem.comm, Path(folder)
    if comm.rank == 0:
        folder.mkdir(parents=True, exist_ok=True)
    slot = _SLOTS[_latest(problem, folder) == _SLOTS[0]]
    rows = json.dumps([] if history is None else history.rows, default=float)
    with open(_path(problem, folder, slot), "wb") as file:
        np.savez(file, **_arrays(problem), history=np.array(rows))
        file.flush()
        os.fsync(file.fileno())
    comm.barrier()
    if comm.rank == 0:
        partial = folder / f"{_LATEST}.partial"
        partial.write_text(slot)
        partial.replace(folder / _LATEST)
    comm.barrier()


def read_checkpoint(problem: Problem, folder: str | Path) -> History | None:
    """Continue from a checkpoint; collective.

    The problem must be set up as the one that wrote it, on as many ranks.

    Args:
        problem: The problem; its state is replaced.
        folder: Where :func:`write_checkpoint` put it.

    Returns:
        The table of the run up to there; None where there is no checkpoint.

    Raises:
        ValueError: the checkpoint belongs to another problem or number of ranks.
    """
    slot = _latest(problem, Path(folder))
    if slot is None:
        return None
    path, message, arrays = _path(problem, Path(folder), slot), None, {}
    if path.is_file():
        with np.load(path) as file:
            arrays = dict(file)
        mine = _fingerprint(problem)
        if arrays["fingerprint"].shape != mine.shape or not np.allclose(
            arrays["fingerprint"], mine
        ):
            message = f"{path} belongs to another mesh, partition or set of interfaces"
    else:
        message = f"{path} is missing: the checkpoint is of another number of ranks"
    raise_together(problem.comm, message)
    _restore(problem, arrays)
    history = History()
    history.rows = json.loads(str(arrays["history"]))
    return history


def _latest(problem: Problem, folder: Path) -> str | None:
    """The slot of the complete checkpoint, None where there is none; collective."""
    slot = None
    if problem.comm.rank == 0 and (folder / _LATEST).is_file():
        slot = (folder / _LATEST).read_text()
    return problem.comm.bcast(slot)


def _path(problem: Problem, folder: Path, slot: str) -> Path:
    return folder / f"{slot}_rank_{problem.comm.rank}_of_{problem.comm.size}.npz"


def _fingerprint(problem: Problem) -> NDArray[np.float64]:
    """Numbers that differ between problems: places of cells and of interface facets, in order."""
    x = problem.mesh.geometry.x
    order = np.arange(1, len(x) + 1) / max(len(x), 1)
    sizes = [len(problem.interface_facets(i).facets) for i in range(len(problem.interfaces))]
    return np.array([*(order @ x), float(len(x)), problem.discretization.degree, *sizes])


def _arrays(problem: Problem) -> dict[str, NDArray[Any]]:
    state = problem.snapshot()
    arrays: dict[str, NDArray[Any]] = {
        "fingerprint": _fingerprint(problem),
        "t": np.array(state.t),
        "u": state.u,
        "forces": state.forces,
        "dissipated": state.dissipated,
        "external": np.array(state.external),
        "force_scale": np.array(problem.force_scale),
    }
    arrays |= {f"open_{i}": mark for i, mark in enumerate(state.open)}
    for i, history in enumerate(state.histories):
        arrays |= {f"{name}_{i}": getattr(history, name) for name in HISTORY_ARRAYS}
        values = {name: getattr(history.values, name) for name in VALUE_ARRAYS}
        arrays |= {f"now_{name}_{i}": v for name, v in values.items() if v is not None}
    return arrays


def _restore(problem: Problem, arrays: dict[str, NDArray[Any]]) -> None:
    histories = []
    count = sum(name.startswith("softening_") for name in arrays)
    for i in range(count):
        values = PointValues(**{name: arrays.get(f"now_{name}_{i}") for name in VALUE_ARRAYS})
        histories.append(
            PointHistory(**{name: arrays[f"{name}_{i}"] for name in HISTORY_ARRAYS}, values=values)
        )
    marks = [arrays[f"open_{i}"] for i in range(len(problem.interfaces))]
    problem.return_to(
        Snapshot(
            float(arrays["t"]),
            problem.discretization_of(marks),
            arrays["u"],
            arrays["forces"],
            histories,
            marks,
            arrays["dissipated"],
            float(arrays["external"]),
        )
    )
    problem.force_scale = float(arrays["force_scale"])
    problem.update_stabilization(None)
