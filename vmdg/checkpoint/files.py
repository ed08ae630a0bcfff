"""Arrays and a description on disk, complete or not visible: only rank 0 writes, all ranks read.

Arrays are numpy's files. Two folders are written in turn; a file of one line names the one that is
complete, and is replaced in one move after all of the other has reached the disk. The description
has the checksums of the arrays, and that line has the description's: what was changed or cut since
is refused.
"""

from __future__ import annotations

import hashlib
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

#: Word for "none of them" in the file that names the complete one.
_NONE = "none"

#: Bytes that are read at once for a checksum.
_CHUNK = 1 << 20


def latest(folder: Path) -> Path | None:
    """The complete one of the two folders, None where there is none; on one rank.

    Raises:
        ValueError: it is not said which one it is.
    """
    named = folder / _LATEST
    if folder.is_file():
        raise ValueError("it is a file, not a folder")
    if not named.is_file():
        if any((folder / slot).exists() for slot in _SLOTS):
            raise ValueError(f"its file '{_LATEST}' is missing")
        return None
    slot = next(iter(named.read_text().split()), "")
    if slot not in (*_SLOTS, _NONE):
        raise ValueError(f"its file '{_LATEST}' names nothing")
    return None if slot == _NONE else folder / slot


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
        ValueError: the description has what JSON cannot hold; on all ranks, and the former content
            is still valid.
        OSError: the folder cannot be written to or the disk is full; likewise.
    """
    message = None
    try:
        json.dumps(about, default=_plain)
    except (TypeError, ValueError) as error:
        message = (
            f"the checkpoint in {folder} cannot hold what the table of the run has ({error}): give "
            "it numbers, words and arrays"
        )
    raise_together(comm, message)
    counts = {name: comm.allreduce(len(rows)) for name, rows in arrays.items()}
    if comm.rank > 0:
        for rows in arrays.values():
            comm.send(rows, 0)
    else:
        parts = {name: _of_all_ranks(comm, rows) for name, rows in arrays.items()}
        try:
            slot = _empty_slot(folder)
            sums = {
                name: _write(_file(slot, name), chain([_header(rows, counts[name])], parts[name]))
                for name, rows in arrays.items()
            }
            plain = json.dumps({**about, "sums": sums}, default=_plain)
            checksum = _write(slot / _ABOUT, [plain.encode()])
            _sync(slot)
            _name_latest(folder, f"{slot.name} {checksum}")
        except (OSError, ValueError) as error:
            message = (
                f"the checkpoint in {folder} could not be written: {error}; the former one, if "
                "any, is still valid. Make room or name a folder that can be written to"
            )
        finally:  # A rank that sends waits until it is heard.
            for _ in chain.from_iterable(parts.values()):
                pass
    raise_together(comm, message, OSError)


def read_description(
    comm: MPI.Comm, folder: Path, version: int
) -> tuple[Path, dict[str, Any]] | None:
    """The complete folder and its description, None where there is none; collective.

    Args:
        comm: The ranks.
        folder: Of :func:`write_files`.
        version: "format" of a description with checksums; others are returned as they are.

    Raises:
        ValueError: a file is missing, or was changed or cut after it was written.
    """
    found, message = None, None
    if comm.rank == 0:
        try:
            if slot := latest(folder):
                found = slot, _checked_description(folder, slot, version)
        except (OSError, ValueError) as error:
            message = (
                f"the checkpoint in {folder} is damaged ({error}): put back a copy of the folder, "
                "or remove it and start anew"
            )
    raise_together(comm, message)
    return comm.bcast(found)


def _checked_description(folder: Path, slot: Path, version: int) -> dict[str, Any]:
    """The description of a folder in which no file has changed; on one rank.

    Raises:
        OSError: a file is missing.
        ValueError: one has changed.
    """
    about = json.loads((slot / _ABOUT).read_bytes())
    if not isinstance(about, dict) or "format" not in about:
        raise ValueError(f"{_ABOUT} describes no checkpoint")
    if about["format"] != version:
        return about
    named = (folder / _LATEST).read_text().split()
    sums = {_ABOUT: named[-1]} | {_file(slot, name).name: s for name, s in about["sums"].items()}
    for name, checksum in sums.items():
        if _checksum(slot / name) != checksum:
            raise ValueError(f"{name} was changed or cut after it was written")
    return about


def _checksum(path: Path) -> str:
    found = hashlib.sha256()
    with path.open("rb") as file:
        while part := file.read(_CHUNK):
            found.update(part)
    return found.hexdigest()


def _plain(value: Any) -> Any:
    """Arrays and numbers of numpy in types of JSON.

    Raises:
        TypeError: it is something else.
    """
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{value!r} is a {type(value).__name__}")


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
    _name_latest(folder, _NONE)
    for name in _SLOTS:
        shutil.rmtree(folder / name, ignore_errors=True)
    (folder / _LATEST).unlink()


def _file(slot: Path, name: str) -> Path:
    return slot / f"{name}.npy"


def _empty_slot(folder: Path) -> Path:
    """An empty folder beside the valid one.

    Raises:
        ValueError: it is not said which one is valid.
    """
    folder.mkdir(parents=True, exist_ok=True)
    valid = latest(folder)
    if valid is None:
        _name_latest(folder, _NONE)
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


def _name_latest(folder: Path, line: str) -> None:
    """Say in one move which folder is complete."""
    partial = folder / f"{_LATEST}.partial"
    _write(partial, [line.encode()])
    partial.replace(folder / _LATEST)
    _sync(folder)


def _write(path: Path, parts: Iterable[bytes | NDArray]) -> str:
    """A file of these parts, on the disk when this returns; its checksum."""
    checksum = hashlib.sha256()
    with path.open("wb") as file:
        for part in parts:
            file.write(part)
            checksum.update(part)
        file.flush()
        os.fsync(file.fileno())
    return checksum.hexdigest()


def _sync(folder: Path) -> None:
    """The names of the files of a folder on the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
