"""Files that one process at a time writes: a lock that ends with it, and tells others who it is."""

from __future__ import annotations

import fcntl
import os
import socket
from contextlib import suppress
from pathlib import Path
from typing import TextIO

from mpi4py import MPI

from .parallel import raise_together

#: Locks that this process holds.
_held: set[Path] = set()


class Claim:
    """Right to write some files, of one run at a time; collective.

    A file beside them is locked by rank 0 until the end of its process, however it ends, and says
    which process it is. Where a file system has no locks nothing is claimed.

    Args:
        comm: The ranks.
        path: The lock, a file; folders are made.
        what: What is written, for messages.
        nested: Whether this process may have claimed it already.

    Raises:
        OSError: another run writes there, or nobody can; on all ranks.
    """

    def __init__(self, comm: MPI.Comm, path: Path, what: str, nested: bool = False):
        self._path, self._file, message = path.absolute(), None, None
        if comm.rank == 0 and not (nested and self._path in _held):
            try:
                self._file = self._locked()
            except BlockingIOError as error:
                message = (
                    f"{what} cannot be written: {error} does so (this is process {os.getpid()}). "
                    "Let it end, close what it has open there, or name another place"
                )
            except OSError as error:
                message = (
                    f"{what} cannot be written: {error}; make room or name a place that can be "
                    "written to"
                )
        raise_together(comm, message, OSError)

    def _locked(self) -> TextIO | None:
        """The lock; None where the file system has none.

        Raises:
            BlockingIOError: another one has it, in words.
            OSError: it cannot be written.
        """
        self._path.parent.mkdir(parents=True, exist_ok=True)
        while True:
            file = self._path.open("a+")
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
                # Whoever held it before may have removed it in between.
                if os.path.samefile(file.fileno(), self._path):
                    break
            file.close()
        file.truncate(0)
        file.write(f"process {os.getpid()} on {socket.gethostname()}")
        file.flush()
        _held.add(self._path)
        return file

    def release(self) -> None:
        """Let others write; a second time it does nothing."""
        if self._file is not None:
            self._path.unlink(missing_ok=True)
            self._file.close()
            _held.discard(self._path)
            self._file = None

    def __enter__(self) -> Claim:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()
