"""The state of a run on disk, to continue after a crash on any number of ranks.

A checkpoint is a folder with ``checkpoint.json``, which describes the problem and contains the
history of the run; ``cells.npy``, one record per cell with displacement and forces; and
``interface_0.npy``, ..., one record per facet with the state of an interface
(:mod:`vmdg.checkpoint.records`). Whenever a run is killed, there is a complete checkpoint
(:mod:`vmdg.checkpoint.files`).

The mesh must come from the same input. Violations (a mesh refined in parallel, other software) are
detected: the positions of all nodes and interface points are stored and compared.

Data that only speed up a run are not stored: factors of matrices, the bodies' part of the tangent,
the path used by the predictor. :func:`vmdg.solve` discards them after every checkpoint, so that a
resumed run repeats the uninterrupted one exactly on the same number of ranks; where surfaces slide,
and on another number of ranks, up to rounding.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from mpi4py import MPI

import dolfinx
import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from .. import __version__
from ..assembly.discretization import Discretization
from ..base.agreement import same_arguments
from ..base.claims import Claim
from ..base.parallel import global_sum, raise_together, warn_together
from ..base.words import checked_path
from ..domain.topology import mark_everywhere
from ..interface.moving import MovingInterface
from ..output.history import History
from ..problem.problem import Problem
from ..problem.states import RunScales, Snapshot, Works
from .files import latest, open_arrays, read_description, remove_files, write_files
from .identity import differences, identity
from .records import (
    NO_RECORDS,
    cell_records,
    facet_keys,
    facet_records,
    find_records,
    near_records,
    restore_fields,
    restore_interface,
    restore_pairs,
    restore_rows,
    surface_records,
)

#: Changed whenever older files can no longer be read as they are.
FORMAT = 8

_CELLS = "cells"

#: Name of the state of bodies at points in the records of cells.
_POINTS = "points"


def write_checkpoint(problem: Problem, folder: str | Path, history: History | None = None) -> None:
    """Write the converged state and the history of the run; collective.

    A checkpoint is replaced atomically: the previous one remains valid until the new one is
    completely on disk.

    Args:
        problem: The problem.
        folder: Created if missing; contains this checkpoint and the previous one. It must be
            visible to all ranks for reading.
        history: The history so far.

    Raises:
        OSError: the folder is not writable, another run writes there, or the disk is full; on all
            ranks, and the previous checkpoint remains valid.
        ValueError: the state is not finite, or the history has values that cannot be stored;
            likewise.
        TypeError: the problem or the folder is of the wrong type.
    """
    _check_problem(problem)
    given = {"folder": folder, "history": len(history) if isinstance(history, History) else history}
    same_arguments(problem.comm, "write_checkpoint", **given)
    if not isinstance(history, History | None):
        raise TypeError(f"checkpoint: history = {history!r} must be a History, or None")
    with claim_checkpoint(problem.comm, folder):
        _write(problem, Path(folder), history)


def claim_checkpoint(comm: MPI.Comm, folder: str | Path) -> Claim:
    """The exclusive right to write checkpoints to a folder, until released; collective."""
    what = f"the checkpoint in {folder}"
    return Claim(
        comm, checked_path("checkpoint: folder", folder) / "checkpoint.lock", what, nested=True
    )


def warn_of_replacement(comm: MPI.Comm, folder: str | Path) -> None:
    """Warn if a run from the start would replace the checkpoint of another; collective."""
    place, message = checked_path("checkpoint: folder", folder), None
    if comm.rank == 0 and place.is_dir():
        try:
            found = latest(place)
        except ValueError:  # damaged: it may still be repaired
            found = place
        if found is not None:
            message = (
                f"solve: {folder} holds the checkpoint of an earlier run, which this run replaces "
                "together with its table. To continue that run, give "
                f'history=vmdg.read_checkpoint(problem, "{folder}"); to start again, remove it by '
                f'vmdg.discard_checkpoint(comm, "{folder}")'
            )
    warn_together(comm, message)


def _check_problem(problem: Problem) -> None:
    if not isinstance(problem, Problem):
        raise TypeError(
            f"checkpoint: problem = {problem!r} must be a vmdg.Problem, and the folder comes after "
            'it: read_checkpoint(problem, "run")'
        )


def _write(problem: Problem, folder: Path, history: History | None) -> None:
    comm, snapshot = problem.comm, problem.step.snapshot()
    finite = np.isfinite(snapshot.u).all() and np.isfinite(snapshot.forces).all()
    message = (
        f"the checkpoint in {folder} cannot be written: displacement or forces of the problem are "
        "not finite; the previous one, if any, is still valid. Return to an earlier state, "
        "problem.step.return_to(snapshot), or read the previous checkpoint"
    )
    raise_together(comm, None if finite else message)
    interfaces = {
        _name(i): facet_records(active) for i, active in problem.discretization.active.items()
    }
    for i, active in problem.discretization.active.items():
        if isinstance(active, MovingInterface):
            interfaces |= {_surfaces(i): surface_records(active), _near(i): near_records(active)}
    about = {
        "format": FORMAT,
        "vmdg": __version__,
        "dolfinx": dolfinx.__version__,
        "ranks": comm.size,
        "problem": identity(problem),
        "state": {
            "t": snapshot.t,
            "dissipated": global_sum(comm, snapshot.works.dissipated),
            "external": global_sum(comm, snapshot.works.external),
            "plastic": global_sum(comm, snapshot.works.plastic),
        },
        "scales": asdict(problem.step.scales),
        "facets": {name: global_sum(comm, len(rows)) for name, rows in interfaces.items()},
        "history": [] if history is None else history.rows,
        "units": {} if history is None else history.units,
    }
    discretization = problem.discretization
    fields = {"u": discretization.u.x.array, "forces": discretization.forces.x.array}
    fields |= {_start(i): start for i, start in enumerate(problem.loading.given.starts)}
    if (motion := problem.step.motion) is not None:
        fields |= motion.fields()
    if discretization.means is not None:
        dofs = discretization.means.dofs
        about["macroscopic"] = {
            name: values[dofs] for name, values in fields.items() if not name.startswith("start ")
        }
    points = discretization.bodies.points
    rows = {_POINTS: points.rows(points.state)} if points else {}
    cells = cell_records(discretization.space, fields, _places(discretization), rows)
    write_files(comm, folder, about, {_CELLS: cells} | interfaces)


def read_checkpoint(problem: Problem, folder: str | Path) -> History | None:
    """Continue from a checkpoint; collective.

    The problem must be set up like the one that wrote it, on any number of ranks.

    Args:
        problem: The problem; its state is replaced.
        folder: Where :func:`write_checkpoint` put it.

    Returns:
        The history of the run up to there; None if there is no checkpoint.

    Raises:
        ValueError: the checkpoint has another format, belongs to another problem or is damaged; the
            problem is unchanged.
        TypeError: the problem or the folder is of the wrong type.
    """
    _check_problem(problem)
    same_arguments(problem.comm, "read_checkpoint", folder=folder)
    found = read_description(problem.comm, checked_path("checkpoint: folder", folder), FORMAT)
    if found is None:
        return None
    slot, about = found
    if about["format"] != FORMAT:
        raise ValueError(
            f"the checkpoint in {folder} has format {about['format']}, written by vmdg "
            f"{about['vmdg']}; vmdg {__version__} reads format {FORMAT}: continue with the version "
            "that wrote it, or remove the folder and start again"
        )
    if lines := differences(about["problem"], identity(problem)):
        raise ValueError(
            f"the checkpoint in {folder} belongs to another problem ({'; '.join(lines)}); set up "
            "the problem like the run that wrote it, or give another folder"
        )
    snapshot, starts, moving = _read_state(problem, slot, about)
    for mine, start in zip(problem.loading.given.starts, starts, strict=True):
        mine[:] = start
    if starts:  # supports must be imposed again
        problem.loading.rebuild(problem.discretization)
    problem.step.return_to(snapshot)
    if problem.step.motion is not None:
        problem.step.motion.take(moving)
    problem.step.scales = RunScales(**about["scales"])
    history = History()
    history.rows, history.units = about["history"], about["units"]
    return history


def discard_checkpoint(comm: MPI.Comm, folder: str | Path) -> None:
    """Remove a checkpoint, if there is one, before a new run; collective.

    Args:
        comm: Communicator; its rank 0 removes the files.
        folder: The folder of the checkpoint.

    Raises:
        OSError: it cannot be removed, another run writes there, or the folder has files that vmdg
            did not write; on all ranks.
        TypeError: the communicator or the folder is of the wrong type.
    """
    if not isinstance(comm, MPI.Comm):
        raise TypeError(
            f"checkpoint: comm = {comm!r} must be a communicator, and the folder comes after it: "
            'discard_checkpoint(problem.comm, "run")'
        )
    same_arguments(comm, "discard_checkpoint", folder=folder)
    place = checked_path("checkpoint: folder", folder).absolute()
    if not comm.bcast(place.is_dir()):
        return
    message = None
    with claim_checkpoint(comm, place):
        if comm.rank == 0:
            try:
                remove_files(place)
            except (OSError, ValueError) as error:
                message = f"the checkpoint in {folder} cannot be removed: {error}"
        raise_together(comm, message, OSError)


def _name(i: int) -> str:
    return f"interface_{i}"


def _surfaces(i: int) -> str:
    return f"surfaces_{i}"


def _near(i: int) -> str:
    return f"near_{i}"


def _start(i: int) -> str:
    return f"start {i}"


def _places(discretization: Discretization) -> fem.FunctionSpace:
    """A space in which every node has a unique position."""
    return discretization.space if discretization.means is None else discretization.means.broken


def _read_state(
    problem: Problem, slot: Path, about: dict[str, Any]
) -> tuple[Snapshot, list[NDArray[np.float64]], dict[str, NDArray[np.float64]]]:
    """The state of a checkpoint, the start values of its supports with ``relative=True``, and all
    fields by name.

    The problem itself is not changed.
    """
    comm, mesh, counts = problem.comm, problem.mesh, about["facets"]
    arrays = open_arrays(comm, slot, [_CELLS, *counts])
    records, marks = {}, list(problem.step.snapshot().open)
    for i, interface in enumerate(problem.interfaces):
        facets, count = problem.step.activation.facets[i], counts.get(_name(i), 0)
        positions = np.zeros(0, dtype=np.intp)
        if facets.slides:
            # Its pairs follow from the displacement.
            continue
        if count:
            stored, keys = arrays[_name(i)], facet_keys(mesh, facets)
            positions, records[i] = find_records(stored, keys)
        if global_sum(comm, len(positions)) != count:
            raise ValueError(_numbered_otherwise(slot))
        if interface.activate == "on-demand":
            marks[i] = mark_everywhere(mesh, mesh.topology.dim - 1, facets.facets[positions])
    discretization = problem.step.discretization_of(marks)
    interfaces, fields, message = [], {}, None
    points, bodies = discretization.bodies.points, None
    try:
        given = discretization.space, arrays[_CELLS], _places(discretization)
        fields = restore_fields(*given, rows=[_POINTS])
        if points is not None:
            bodies = points.from_rows(restore_rows(mesh, arrays[_CELLS], _POINTS))
        for i, active in discretization.active.items():
            if isinstance(active, MovingInterface):
                u = fem.Function(discretization.space)
                u.x.array[:] = fields["u"]
                # Files of older versions do not have what was coupled.
                known = arrays[_name(i)], arrays[_surfaces(i)], arrays.get(_near(i), NO_RECORDS)
                interfaces.append(restore_pairs(active, u, *known))
            else:
                interfaces.append(restore_interface(active, records[i]))
    except ValueError as error:
        message = f"{_numbered_otherwise(slot)}: {error}"
    raise_together(comm, message)
    if discretization.means is not None:
        for name, values in about["macroscopic"].items():
            fields[name][discretization.means.dofs] = values
    # Sums over ranks are restored on one rank.
    share, state = float(comm.rank == 0), about["state"]
    snapshot = Snapshot(
        state["t"],
        discretization,
        fields["u"],
        fields["forces"],
        interfaces,
        marks,
        Works(
            share * np.array(state["dissipated"]),
            share * np.array(state["external"]),
            plastic=share * state["plastic"],
        ),
        bodies,
    )
    starts = [fields[_start(i)] for i in range(len(problem.loading.given.starts))]
    return snapshot, starts, fields


def _numbered_otherwise(slot: Path) -> str:
    return (
        f"the mesh of the checkpoint in {slot.parent} has the same numbers of cells and facets, "
        "but in another order or at other positions: make the mesh from the same input in the same "
        "way as the run that wrote it (a mesh refined in parallel depends on the number of ranks)"
    )
