"""The state of a run on disk, to go on from after a crash."""

from __future__ import annotations

import json
import os
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .history import History
from .parallel import global_any, raise_together
from .point_values import PointHistory, PointValues
from .problem import Problem, Snapshot

_VALUES = [field.name for field in fields(PointValues) if field.name != "update"]
_HISTORY = [field.name for field in fields(PointHistory) if field.name != "values"]


def write_checkpoint(problem: Problem, folder: str | Path, history: History | None = None) -> None:
    """Write the converged state and the table of the run, one file a rank; collective.

    A checkpoint is complete or not visible: the files are written beside the old ones and take
    their place by renaming once all ranks have written theirs.

    Args:
        problem: The problem.
        folder: Made if missing; an older checkpoint in it is replaced.
        history: The table so far.
    """
    comm, folder = problem.comm, Path(folder)
    if comm.rank == 0:
        folder.mkdir(parents=True, exist_ok=True)
    comm.barrier()
    path = _path(problem, folder)
    partial = path.with_suffix(".partial")
    with open(partial, "wb") as file:
        rows = json.dumps([] if history is None else history.rows, default=float)
        np.savez(file, **_arrays(problem), history=np.array(rows))
        file.flush()
        os.fsync(file.fileno())
    comm.barrier()
    partial.replace(path)
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
        ValueError: the checkpoint belongs to another problem or number of ranks, or the run ended
            while its files were being replaced.
    """
    path = _path(problem, Path(folder))
    if not global_any(problem.comm, path.is_file()):
        others = Path(folder).glob("rank_*.npz")
        message = f"{folder} holds a checkpoint of another number of ranks" if any(others) else None
        raise_together(problem.comm, message)
        return None
    message, arrays = None, {}
    if path.is_file():
        with np.load(path) as file:
            arrays = dict(file)
    else:
        message = f"{path} is missing: the checkpoint is of another number of ranks"
    times = problem.comm.allgather(float(arrays.get("t", np.nan)))
    if message is None and len(set(times)) > 1:
        message = f"{folder} is incomplete: its ranks are at the load factors {sorted(set(times))}"
    mine = _fingerprint(problem)
    if message is None and not (
        arrays["fingerprint"].shape == mine.shape and np.allclose(arrays["fingerprint"], mine)
    ):
        message = f"{path} belongs to another mesh, partition or set of interfaces"
    raise_together(problem.comm, message)
    _restore(problem, arrays)
    history = History()
    history.rows = json.loads(str(arrays["history"]))
    return history


def _path(problem: Problem, folder: Path) -> Path:
    return folder / f"rank_{problem.comm.rank}_of_{problem.comm.size}.npz"


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
        arrays |= {f"{name}_{i}": getattr(history, name) for name in _HISTORY}
        values = {name: getattr(history.values, name) for name in _VALUES}
        arrays |= {f"now_{name}_{i}": v for name, v in values.items() if v is not None}
    return arrays


def _restore(problem: Problem, arrays: dict[str, NDArray[Any]]) -> None:
    histories = []
    count = sum(name.startswith("softening_") for name in arrays)
    for i in range(count):
        values = PointValues(**{name: arrays.get(f"now_{name}_{i}") for name in _VALUES})
        histories.append(
            PointHistory(**{name: arrays[f"{name}_{i}"] for name in _HISTORY}, values=values)
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
