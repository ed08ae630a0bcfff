"""Arrays and a description on disk, complete or not visible: only rank 0 writes, all ranks read.

Arrays are numpy's files. Two folders are written in turn; a file of one word names the one that is
complete, and is replaced in one move after all of the other has reached the disk.
"""

from __future__ import annotations

import io
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import raise_together

_SLOTS, _LATEST, _ABOUT = ("a", "b"), "latest", "checkpoint.json"


def latest(folder: Path) -> Path | None:
    """The complete one of the two folders, None where there is none; on one rank."""
    named = folder / _LATEST
    return folder / named.read_text().strip() if named.is_file() else None


def write_files(
    comm: MPI.Comm, folder: Path, about: Mapping[str, Any], arrays: Mapping[str, NDArray]
) -> None:
    """Replace what the folder holds; collective.

    Args:
        comm: The ranks.
        folder: Made if missing.
        about: The description, that of rank 0 counts.
        arrays: By name, this rank's rows; the rows of all ranks follow each other in the file.

    Raises:
        OSError: the folder cannot be written to or the disk is full; on all ranks, and the former
            content is still valid.
    """
    counts = {name: comm.allreduce(len(rows)) for name, rows in arrays.items()}
    message = None
    if comm.rank > 0:
        for rows in arrays.values():
            comm.send(rows, 0)
    else:
        parts = {name: _of_all_ranks(comm, rows) for name, rows in arrays.items()}
        try:
            slot = _empty_slot(folder)
            plain = json.dumps(about, default=lambda value: value.tolist())  # numpy's too
            _write(slot / _ABOUT, [plain.encode()])
            for name, rows in arrays.items():
                _write(_file(slot, name), chain([_header(rows, counts[name])], parts[name]))
            _sync(slot)
            partial = folder / f"{_LATEST}.partial"
            _write(partial, [slot.name.encode()])
            partial.replace(folder / _LATEST)
            _sync(folder)
        except OSError as error:
            message = (
                f"the checkpoint in {folder} could not be written: {error}; the former one, if "
                "any, is still valid. Make room or name a folder that can be written to"
            )
        finally:  # A rank that sends waits until it is heard.
            for _ in chain.from_iterable(parts.values()):
                pass
    raise_together(comm, message, OSError)


def read_description(comm: MPI.Comm, folder: Path) -> tuple[Path, dict[str, Any]] | None:
    """The complete folder and its description, None where there is none; collective.

    Raises:
        ValueError: the description is damaged.
    """
    found, message = None, None
    if comm.rank == 0:
        try:
            if slot := latest(folder):
                found = slot, json.loads((slot / _ABOUT).read_text())
        except (OSError, ValueError) as error:
            message = f"the checkpoint in {folder} is damaged ({error}); remove the folder"
    raise_together(comm, message)
    return comm.bcast(found)


def open_arrays(comm: MPI.Comm, slot: Path, names: Iterable[str]) -> dict[str, NDArray]:
    """Arrays by name, whole on every rank, of which only what is used is read; collective.

    Raises:
        ValueError: a file is missing or damaged.
    """
    arrays, message = {}, None
    try:
        arrays = {name: np.load(_file(slot, name), mmap_mode="r") for name in names}
    except (OSError, ValueError) as error:
        message = (
            f"rank {comm.rank} cannot read the checkpoint in {slot.parent} ({error}); put it on a "
            "disk that all ranks see, or, if it is damaged, remove the folder"
        )
    raise_together(comm, message)
    return arrays


def remove_files(folder: Path) -> None:
    """Remove both folders and what names them; on one rank.

    Raises:
        OSError: they cannot be removed.
    """
    # First what names them: half of a checkpoint is never visible.
    (folder / _LATEST).unlink(missing_ok=True)
    for name in _SLOTS:
        shutil.rmtree(folder / name, ignore_errors=True)


def _file(slot: Path, name: str) -> Path:
    return slot / f"{name}.npy"


def _empty_slot(folder: Path) -> Path:
    """An empty folder beside the valid one."""
    folder.mkdir(parents=True, exist_ok=True)
    valid = latest(folder)
    slot = folder / _SLOTS[valid is not None and valid.name == _SLOTS[0]]
    if slot.exists():
        shutil.rmtree(slot)
    slot.mkdir()
    return slot


def _of_all_ranks(comm: MPI.Comm, rows: NDArray) -> Iterator[NDArray]:
    """The rows of one rank after the other, on rank 0."""
    yield rows
    for rank in range(1, comm.size):
        yield comm.recv(source=rank)


def _header(rows: NDArray, count: int) -> bytes:
    """What numpy's file of ``count`` such rows starts with."""
    header = io.BytesIO()
    described = np.lib.format.header_data_from_array_1_0(rows)
    np.lib.format.write_array_header_2_0(header, described | {"shape": (count, *rows.shape[1:])})
    return header.getvalue()


def _write(path: Path, parts: Iterable[bytes | NDArray]) -> None:
    """A file of these parts, on the disk when this returns."""
    with path.open("wb") as file:
        for part in parts:
            file.write(part)
        file.flush()
        os.fsync(file.fileno())


def _sync(folder: Path) -> None:
    """The names of the files of a folder on the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
