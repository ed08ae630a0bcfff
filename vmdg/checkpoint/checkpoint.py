"""The state of a run on disk, to go on from after a crash, on any number of ranks.

A checkpoint is a folder with three parts: ``checkpoint.json`` says what it is, which problem it
belongs to, and holds the table of the run; ``fields.bp`` holds displacement and forces, and
``interfaces.bp`` a row a facet with all that the interfaces remember
(:mod:`vmdg.checkpoint.state_file`, :mod:`vmdg.checkpoint.facet_records`).

Two such folders are written in turn; a file of one word names the one that is complete, and is
replaced in one move after all of the other has reached the disk. Whenever a run is killed, the
checkpoint that is named is whole.

Where things are found again: DOLFINx numbers cells as they are handed over, whatever the number of
ranks, so that the same input gives the same ``original_cell_index``. What would break this (a mesh
refined in parallel, other software) is detected: the place of every node and of every interface
point is stored too, and compared.

Not stored is what a run has found out to be faster: factors of matrices, the bodies' part of the
tangent, the path that predicts the next state. :func:`vmdg.solve` forgets it after every
checkpoint it writes, so that on the same number of ranks a resumed run repeats the uninterrupted
one exactly, and on another number but for rounding.
"""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mpi4py import MPI

import dolfinx
import numpy as np
from dolfinx import fem

from .. import __version__
from ..base.parallel import global_any, global_sum, raise_together
from ..domain.topology import mark_everywhere
from ..output.history import History
from ..problem.problem import Problem
from ..problem.states import RunScales, Snapshot
from .facet_records import FacetRecords, facet_keys
from .identity import differences, identity
from .lookup import look_up
from .state_file import adios, read_field, read_tables, write_fields, write_tables

#: Changed whenever older files can no longer be read as they are.
FORMAT = 2

#: Distance of a node from where the checkpoint has it, relative to the size of the mesh.
SAME_PLACE = 1e-9

#: Two places that are written in turn, and the file that names the one that is complete.
_SLOTS, _LATEST = ("a", "b"), "latest"
_ABOUT, _FIELDS, _INTERFACES = "checkpoint.json", "fields.bp", "interfaces.bp"

#: What a checkpoint needs on the disk relative to its numbers: dofs, offsets and descriptions.
_OVERHEAD, _AT_LEAST = 2.0, 1 << 20


def write_checkpoint(problem: Problem, folder: str | Path, history: History | None = None) -> None:
    """Write the converged state and the table of the run; collective.

    A checkpoint is complete or not visible: the former one stays the valid one until all of the
    new one is on the disk.

    Args:
        problem: The problem.
        folder: Made if missing; holds this checkpoint and the former one.
        history: The table so far.

    Raises:
        ImportError: adios4dolfinx is missing.
        OSError: the folder cannot be written to or the disk is full; on all ranks, and the former
            checkpoint is still valid.
    """
    adios()
    comm, folder = problem.comm, Path(folder)
    fields, tables = _fields(problem), _tables(problem)
    about = {
        "format": FORMAT,
        "vmdg": __version__,
        "dolfinx": dolfinx.__version__,
        "ranks": comm.size,
        "problem": identity(problem),
        "state": _scalars(problem),
        "scales": asdict(problem.step.scales),
        "facets": {name: int(global_sum(comm, len(keys))) for name, (keys, _) in tables.items()},
        "history": [] if history is None else history.rows,
        "units": {} if history is None else history.units,
    }
    here = sum(f.x.array.nbytes for f in fields.values())
    here += sum(rows.nbytes for _, rows in tables.values())
    size = _OVERHEAD * float(global_sum(comm, here)) + _AT_LEAST
    slot, message = None, None
    if comm.rank == 0:
        try:
            slot = _make_slot(folder, size)
            (slot / _ABOUT).write_text(json.dumps(about, default=_plain))
        except OSError as error:
            message = _unwritable(folder, error)
    raise_together(comm, message, OSError)
    slot = comm.bcast(slot)
    try:
        write_fields(slot / _FIELDS, fields)
        if tables:
            write_tables(comm, slot / _INTERFACES, tables)
    except Exception as error:  # ADIOS2 raises whatever its engines do
        message = _unwritable(folder, error)
    raise_together(comm, message, OSError)
    for finish in (_flush, _make_visible):
        try:
            finish(comm, folder, slot)
        except OSError as error:
            message = _unwritable(folder, error)
        raise_together(comm, message, OSError)


def read_checkpoint(problem: Problem, folder: str | Path) -> History | None:
    """Continue from a checkpoint; collective.

    The problem must be set up as the one that wrote it, on any number of ranks.

    Args:
        problem: The problem; its state is replaced.
        folder: Where :func:`write_checkpoint` put it.

    Returns:
        The table of the run up to there; None where there is no checkpoint.

    Raises:
        ImportError: adios4dolfinx is missing.
        ValueError: the checkpoint is of another format, belongs to another problem or is damaged;
            the problem keeps its state.
    """
    comm, folder = problem.comm, Path(folder)
    slot, about, message = None, None, None
    if comm.rank == 0:
        try:
            slot = latest(folder)
            about = None if slot is None else json.loads((slot / _ABOUT).read_text())
        except (OSError, ValueError) as error:
            message = f"the checkpoint in {folder} is damaged ({error}); remove the folder"
    raise_together(comm, message)
    slot, about = comm.bcast((slot, about))
    if slot is None:
        return None
    adios()
    if about["format"] != FORMAT:
        raise ValueError(
            f"the checkpoint in {folder} has format {about['format']}, written by vmdg "
            f"{about['vmdg']}; vmdg {__version__} reads format {FORMAT}: go on with the "
            "version that wrote it, or remove the folder and start anew"
        )
    if lines := differences(about["problem"], identity(problem)):
        raise ValueError(
            f"the checkpoint in {folder} belongs to another problem ({'; '.join(lines)}); set up "
            "the problem as the run that wrote it, or give another folder"
        )
    problem.return_to(_read_state(problem, slot, about))
    problem.step.scales = RunScales(**about["scales"])
    history = History()
    history.rows = about["history"]
    history.units = about.get("units", {})  # which older files do not say
    return history


def discard_checkpoint(comm: MPI.Comm, folder: str | Path) -> None:
    """Remove a checkpoint, if there is one, before a run that starts anew; collective.

    Args:
        comm: Communicator; its rank 0 removes the files.
        folder: That of the checkpoint.

    Raises:
        OSError: it cannot be removed; on all ranks.
    """
    message = None
    if comm.rank == 0:
        try:
            # First what names it: half of a checkpoint is never visible.
            (Path(folder) / _LATEST).unlink(missing_ok=True)
            for name in _SLOTS:
                shutil.rmtree(Path(folder) / name, ignore_errors=True)
        except OSError as error:
            message = f"the checkpoint in {folder} cannot be removed: {error}"
    raise_together(comm, message, OSError)


def latest(folder: str | Path) -> Path | None:
    """The folder of the complete checkpoint, None where there is none; on one rank."""
    named = Path(folder) / _LATEST
    return Path(folder) / named.read_text().strip() if named.is_file() else None


# What is stored


def _scalars(problem: Problem) -> dict[str, Any]:
    snapshot = problem.snapshot()
    return {
        "t": snapshot.t,
        "dissipated": global_sum(problem.comm, snapshot.dissipated).tolist(),
        "external": float(global_sum(problem.comm, snapshot.external)),
    }


def _fields(problem: Problem) -> dict[str, fem.Function]:
    return {"u": problem.u, "forces": problem.forces, "place": _places(problem.space)}


def _places(space: fem.FunctionSpace) -> fem.Function:
    """Reference position of every node [mm]."""
    function = fem.Function(space)
    d = space.dofmap.index_map_bs
    function.x.array[:] = space.tabulate_dof_coordinates()[:, :d].ravel()
    return function


def _tables(problem: Problem) -> dict[str, Any]:
    tables = {}
    for i, active in problem.discretization.active.items():
        keys = facet_keys(problem.mesh, active.facets)
        tables[_name(i)] = keys, FacetRecords(active).rows()
    return tables


def _name(i: int) -> str:
    return f"interface_{i}"


def _read_state(problem: Problem, slot: Path, about: dict[str, Any]) -> Snapshot:
    """The state of a checkpoint; the problem itself is not changed."""
    comm, counts = problem.comm, about["facets"]
    tables = read_tables(comm, slot / _INTERFACES, list(counts)) if counts else {}
    rows, marks = {}, list(problem.snapshot().open)
    for i, interface in enumerate(problem.interfaces):
        facets = problem.interface_facets(i)
        found = np.zeros(len(facets.facets), dtype=bool)
        if _name(i) in tables:
            keys = facet_keys(problem.mesh, facets)
            found, rows[i] = look_up(comm, *tables[_name(i)], keys)
        if int(global_sum(comm, found.sum())) != counts.get(_name(i), 0):
            raise ValueError(_numbered_otherwise(slot))
        if interface.activate == "on-demand":
            fdim = problem.mesh.topology.dim - 1
            marks[i] = mark_everywhere(problem.mesh, fdim, facets.facets[found])
    discretization = problem.discretization_of(marks)
    _check_places(discretization.space, slot)
    fields = {}
    for name in ("u", "forces"):
        fields[name] = fem.Function(discretization.space)
        read_field(slot / _FIELDS, name, fields[name])
    histories, frozen, message = [], [], None
    for i, active in discretization.active.items():
        try:
            history, stabilization = FacetRecords(active).unpack(rows[i])
            histories.append(history)
            frozen.append(stabilization)
        except ValueError as error:
            message = f"{_numbered_otherwise(slot)}: {error}"
    raise_together(comm, message)
    # Sums over ranks: one rank goes on with all of it.
    share, state = float(comm.rank == 0), about["state"]
    return Snapshot(
        state["t"],
        discretization,
        fields["u"].x.array.copy(),
        fields["forces"].x.array.copy(),
        histories,
        marks,
        share * np.array(state["dissipated"]),
        share * state["external"],
        frozen,
    )


def _check_places(space: fem.FunctionSpace, slot: Path) -> None:
    """Whether every node lies where the checkpoint has it; collective."""
    mine, stored = _places(space), fem.Function(space)
    read_field(slot / _FIELDS, "place", stored)
    x = space.mesh.geometry.x
    size = np.ptp(x, axis=0).max() if len(x) else 0.0
    away = np.abs(mine.x.array - stored.x.array).max(initial=0.0)
    if global_any(space.mesh.comm, away > SAME_PLACE * size):
        raise ValueError(_numbered_otherwise(slot))


def _numbered_otherwise(slot: Path) -> str:
    return (
        f"the mesh of the checkpoint in {slot.parent} has the same numbers of cells and facets, "
        "but in another order or at other places: make the mesh from the same input in the same "
        "way as the run that wrote it (a mesh refined in parallel depends on the number of ranks)"
    )


# Complete or not visible


def _make_slot(folder: Path, size: float) -> Path:
    """An empty folder beside the valid checkpoint, on a disk with room for ``size`` bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    valid = latest(folder)
    slot = folder / _SLOTS[valid is not None and valid.name == _SLOTS[0]]
    if slot.exists():
        shutil.rmtree(slot)
    slot.mkdir()
    # Ranks that wait for each other inside ADIOS2 do not learn of one that fails: look before.
    free = shutil.disk_usage(slot).free
    if free < size:
        raise OSError(f"it needs about {size / 1e6:.3g} MB, {free / 1e6:.3g} MB are free")
    return slot


def _flush(comm: MPI.Comm, folder: Path, slot: Path) -> None:
    """All files on the disk, for every node by one of its ranks; collective."""
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    try:
        if node.rank == 0:
            for path in sorted(slot.rglob("*")):
                _sync(path)
            _sync(slot)
    finally:
        node.Free()


def _make_visible(comm: MPI.Comm, folder: Path, slot: Path) -> None:
    """Name the new folder, in one move."""
    if comm.rank > 0:
        return
    partial = folder / f"{_LATEST}.partial"
    partial.write_text(slot.name)
    _sync(partial)
    partial.replace(folder / _LATEST)
    _sync(folder)


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _unwritable(folder: Path, error: Exception) -> str:
    return (
        f"the checkpoint in {folder} could not be written: {error}; the former one, if any, is "
        "still valid. Make room or name a folder that can be written to"
    )


def _plain(value: Any) -> Any:
    """numpy's numbers and arrays as Python's."""
    return value.tolist()
