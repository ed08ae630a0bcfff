"""Arrays and a description on disk, replaced atomically: only rank 0 writes, all ranks read.

Arrays are .npy files. Two folders are written alternately; a one-line file names the complete one,
and is replaced atomically after all of the other has reached the disk. The description contains the
checksums of the arrays, and that line the checksum of the description: modified or truncated files
are refused.
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
from typing import Any, BinaryIO

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ..base.disk import plain_file, replacing
from ..base.parallel import raise_together

_SLOTS, _LATEST, _ABOUT = ("a", "b"), "latest", "checkpoint.json"

#: Entry for "none" in the file that names the complete folder.
_NONE = "none"

#: Bytes per read for a checksum.
_CHUNK = 1 << 20


def latest(folder: Path) -> Path | None:
    """The complete one of the two folders, None if there is none; on one rank."""
    named = folder / _LATEST
    if folder.is_file():
        raise ValueError("it is a file, not a folder")
    if not named.is_file():
        if any((folder / slot).exists() for slot in _SLOTS):
            raise ValueError(f"its file '{_LATEST}' is missing")
        return None
    slot = next(iter(named.read_text().split()), "")
    if slot not in (*_SLOTS, _NONE):
        raise ValueError(f"its file '{_LATEST}' names no folder")
    return None if slot == _NONE else folder / slot


def write_files(
    comm: MPI.Comm, folder: Path, about: Mapping[str, Any], arrays: Mapping[str, NDArray]
) -> None:
    """Replace the content of the folder, by this rank's rows by name; a file contains the rows of
    all ranks in order; collective."""
    message = None
    try:
        json.dumps(about, default=_plain)
    except (TypeError, ValueError) as error:
        message = (
            f"the checkpoint in {folder} cannot store the history of the run ({error}): give it "
            "numbers, words and arrays"
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
                f"the checkpoint in {folder} could not be written: {error}; the previous one, if "
                "any, is still valid. Free some space or choose a writable folder"
            )
        finally:  # A sending rank waits until it is received.
            for _ in chain.from_iterable(parts.values()):
                pass
    raise_together(comm, message, OSError)


def read_description(
    comm: MPI.Comm, folder: Path, version: int
) -> tuple[Path, dict[str, Any]] | None:
    """The complete folder and its description, None if there is none; unchecked where its "format"
    is another one than ``version``, which has checksums; collective."""
    found, message = None, None
    if comm.rank == 0:
        try:
            if slot := latest(folder):
                found = slot, _checked_description(folder, slot, version)
        except (OSError, ValueError) as error:
            message = (
                f"the checkpoint in {folder} is damaged ({error}): restore a copy of the folder, "
                "or remove it and start again"
            )
    raise_together(comm, message)
    return comm.bcast(found)


def _checked_description(folder: Path, slot: Path, version: int) -> dict[str, Any]:
    about = json.loads((slot / _ABOUT).read_bytes())
    if not isinstance(about, dict) or "format" not in about:
        raise ValueError(f"{_ABOUT} is not the description of a checkpoint")
    if about["format"] != version:
        return about
    named = (folder / _LATEST).read_text().split()
    sums = {_ABOUT: named[-1]} | {_file(slot, name).name: s for name, s in about["sums"].items()}
    for name, checksum in sums.items():
        if _checksum(slot / name) != checksum:
            raise ValueError(f"{name} was modified or truncated after it was written")
    return about


def _checksum(path: Path) -> str:
    found = hashlib.sha256()
    with path.open("rb") as file:
        while part := file.read(_CHUNK):
            found.update(part)
    return found.hexdigest()


def _plain(value: Any) -> Any:
    """Convert numpy arrays and numbers to JSON types."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{value!r} is a {type(value).__name__}")


def open_arrays(comm: MPI.Comm, slot: Path, names: Iterable[str]) -> dict[str, NDArray]:
    """Memory-mapped arrays by name on every rank; collective."""
    arrays, message = {}, None
    try:
        arrays = {name: np.load(_file(slot, name), mmap_mode="r") for name in names}
    except (OSError, ValueError) as error:
        message = (
            f"rank {comm.rank} cannot read the checkpoint in {slot.parent} ({error}); put it on a "
            "disk visible to all ranks, or, if it is damaged, remove the folder"
        )
    raise_together(comm, message)
    return arrays


def remove_files(folder: Path) -> None:
    """Remove both folders and the file that names them, if there is a checkpoint; on one rank."""
    slots = [folder / name for name in _SLOTS if os.path.lexists(folder / name)]
    named = folder / _LATEST
    for slot in slots:
        _check_slot(slot)
    if os.path.lexists(named) and not plain_file(named):
        raise ValueError(f"'{_LATEST}' is not a file of vmdg")
    if not slots and not named.exists():
        return
    if named.exists():
        latest(folder)
    # First the file that names them: a partial checkpoint is never visible.
    _name_latest(folder, _NONE)
    for slot in slots:
        shutil.rmtree(slot)
    named.unlink()


def _check_slot(slot: Path) -> None:
    """Check that a folder has nothing but what :func:`write_files` writes."""
    others = [slot] if slot.is_symlink() or not slot.is_dir() else []
    others += [
        file
        for file in (slot.iterdir() if not others else ())
        if not plain_file(file) or not (file.name == _ABOUT or file.suffix == ".npy")
    ]
    written = (slot.parent / _LATEST).is_file() or (slot / _ABOUT).is_file()
    if others or not written:
        what = others[0].relative_to(slot.parent) if others else slot.name
        raise ValueError(f"vmdg did not write '{what}' in it; give a folder of its own")


def _file(slot: Path, name: str) -> Path:
    return slot / f"{name}.npy"


def _empty_slot(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    valid = latest(folder)
    if valid is None:
        _name_latest(folder, _NONE)
    slot = folder / _SLOTS[valid is not None and valid.name == _SLOTS[0]]
    if os.path.lexists(slot):
        _check_slot(slot)
        shutil.rmtree(slot)
    slot.mkdir()
    return slot


def _of_all_ranks(comm: MPI.Comm, rows: NDArray) -> Iterator[NDArray]:
    yield rows
    for rank in range(1, comm.size):
        yield comm.recv(source=rank)


def _header(rows: NDArray, count: int) -> bytes:
    header = io.BytesIO()
    described = np.lib.format.header_data_from_array_1_0(rows)
    np.lib.format.write_array_header_2_0(header, described | {"shape": (count, *rows.shape[1:])})
    return header.getvalue()


def _name_latest(folder: Path, line: str) -> None:
    with replacing(folder / _LATEST) as file:
        _write_to(file, [line.encode()])
    _sync(folder)


def _write(path: Path, parts: Iterable[bytes | NDArray]) -> str:
    with path.open("xb") as file:
        return _write_to(file, parts)


def _write_to(file: BinaryIO, parts: Iterable[bytes | NDArray]) -> str:
    checksum = hashlib.sha256()
    for part in parts:
        file.write(part)
        checksum.update(part)
    file.flush()
    os.fsync(file.fileno())
    return checksum.hexdigest()


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
