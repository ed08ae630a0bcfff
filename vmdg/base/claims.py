"""File locks: one process at a time writes; a lock names its process and ends with it."""

from __future__ import annotations

import fcntl
import os
import socket
from contextlib import suppress
from pathlib import Path
from typing import TextIO

from mpi4py import MPI

from .parallel import raise_together

#: Begins what a lock says.
_MARK = "process "

#: Locks that this process holds.
_held: set[Path] = set()


class Claim:
    """Exclusive right of one run to write some files; collective.

    Rank 0 locks a file next to them until its process ends, however it ends; the file names the
    process. On file systems without locks nothing is claimed.
    """

    def __init__(self, comm: MPI.Comm, path: Path, what: str, nested: bool = False):
        self._path, self._file, message = path.absolute(), None, None
        if comm.rank == 0 and not (nested and self._path in _held):
            try:
                self._file = self._locked()
            except BlockingIOError as error:
                message = (
                    f"{what} cannot be written: {error} is writing it (this is process "
                    f"{os.getpid()}). Wait for it to finish, close its files there, or choose "
                    "another place"
                )
            except OSError as error:
                message = (
                    f"{what} cannot be written: {error}; free some space or choose a writable place"
                )
        raise_together(comm, message, OSError)

    def _locked(self) -> TextIO | None:
        """The lock; None where the file system has none."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        while True:
            file = self._opened()
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                with file:
                    file.seek(0)
                    raise BlockingIOError(file.read() or "another process") from None
            except OSError:
                file.close()
                return None
            with suppress(FileNotFoundError):
                # Its previous owner may have removed it in the meantime.
                if os.path.samefile(file.fileno(), self._path):
                    break
            file.close()
        file.seek(0)
        file.truncate()
        file.write(f"{_MARK}{os.getpid()} on {socket.gethostname()}")
        file.flush()
        _held.add(self._path)
        return file

    def _opened(self) -> TextIO:
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
        try:
            file = open(os.open(self._path, flags, 0o666), "r+")
        except OSError as error:
            if not self._path.is_symlink():
                raise
            raise OSError(f"{self._path} is a link; remove it") from error
        if file.read(len(_MARK)) not in ("", _MARK):
            file.close()
            raise OSError(f"{self._path} is not a lock of vmdg; move it away")
        return file

    def release(self) -> None:
        if self._file is not None:
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(self._file.fileno()), os.lstat(self._path)):
                    self._path.unlink()
            self._file.close()
            _held.discard(self._path)
            self._file = None

    def __enter__(self) -> Claim:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()
