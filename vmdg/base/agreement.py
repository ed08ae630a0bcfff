"""What fails on one rank ends the run on all: errors of users' functions, and Ctrl-C.

A rank that leaves a run while others wait for it would have them wait for ever. So where vmdg calls
a function of the user the ranks agree on how it went, by messages from rank to rank, which cannot
be taken for those of a collective call inside of that function. A rank that failed waits PATIENCE
for the others; if they do not answer they are in such a call, and the job is ended. The same holds
for any error that nobody catches.
"""

from __future__ import annotations

import pickle
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import NoReturn, TypeVar

from mpi4py import MPI

from .parallel import global_any

#: Seconds that a rank on which something failed waits for the others.
PATIENCE = 10.0

_TAG = 22093
_PAUSE = 0.01

T = TypeVar("T")


def together(comm: MPI.Comm, call: Callable[[], T]) -> T:
    """Call a user's function; an error of one rank is raised on all of them; collective.

    Ranks on which it did not fail raise the same error, or RuntimeError with its words where it
    cannot be sent, that of the lowest rank. What it gives may differ between ranks.

    Args:
        comm: The ranks.
        call: Calls it.
    """
    if comm.size == 1:
        return call()
    result, mine = None, None
    try:
        result = call()
    except BaseException as error:
        mine = error
    told = _first_error(comm, mine)
    if mine is not None:
        raise mine
    if told is not None:
        raise pickle.loads(told)
    return result


def leave_together(comm: MPI.Comm, error: BaseException) -> None:
    """Tell the other ranks of an error on the way of a run; collective.

    Where they have none they learn of it in the next function of a user that they call; where they
    wait for this rank before that, the job is ended.

    Args:
        comm: The ranks.
        error: What this rank leaves by.
    """
    if comm.size > 1:
        _first_error(comm, error)


def _first_error(comm: MPI.Comm, mine: BaseException | None) -> bytes | None:
    """That of the lowest rank on which there is one, pickled."""
    packed = None if mine is None else _packed(mine, comm.rank)
    if comm.rank > 0:
        request = comm.isend(packed, 0, _TAG)
        told = _received(comm, 0, mine)
        request.wait()
        return told
    errors = [packed, *(_received(comm, rank, mine) for rank in range(1, comm.size))]
    told = next((error for error in errors if error is not None), None)
    for rank in range(1, comm.size):
        comm.send(told, rank, _TAG)
    return told


def _received(comm: MPI.Comm, source: int, mine: BaseException | None) -> bytes | None:
    """What a rank says; where this one has failed it does not wait for long."""
    if mine is not None and not _within_patience(lambda: comm.Iprobe(source, _TAG)):
        traceback.print_exception(mine)
        _end_job(f"rank {comm.rank} has failed (above) while others wait for it in a call of all")
    return comm.recv(source=source, tag=_TAG)


def _packed(error: BaseException, rank: int) -> bytes:
    """An error as it can be sent."""
    try:
        packed = pickle.dumps(error)
        pickle.loads(packed)
    except Exception:  # of a user's class, which may do anything
        words = f"on rank {rank}: {type(error).__name__}: {error}"
        packed = pickle.dumps(RuntimeError(words))
    return packed


def _within_patience(done: Callable[[], bool]) -> bool:
    end = time.monotonic() + PATIENCE
    while not done():
        if time.monotonic() > end:
            return False
        time.sleep(_PAUSE)
    return True


def _end_job(message: str) -> NoReturn:
    print(f"vmdg: {message}: the job ends on all ranks", file=sys.stderr)
    sys.stdout.flush()
    sys.stderr.flush()
    MPI.COMM_WORLD.Abort(1)
    raise SystemExit(1)


def _end_all_ranks(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """After an error that nobody has caught: end the other ranks too, if they do not end so."""
    _show(kind, error, trace)
    sys.stdout.flush()
    sys.stderr.flush()
    if MPI.Is_finalized():
        return
    others = MPI.COMM_WORLD.Ibarrier()
    if not _within_patience(others.Test):
        _end_job(f"rank {MPI.COMM_WORLD.rank} has failed (above) and others have not")


_show = sys.excepthook
if MPI.COMM_WORLD.size > 1:
    sys.excepthook = _end_all_ranks


class Interrupt:
    """Ctrl-C that ends a run between two attempts of a step, on all ranks; collective.

    A second one does not wait, and the step that is under way is lost. Handlers of others are left
    as they are.

    Args:
        comm: The ranks.
    """

    def __init__(self, comm: MPI.Comm):
        self._comm = comm
        self._asked = self._handles = False

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._asked:
            signal.default_int_handler(number, frame)
        self._asked = True

    def check(self) -> None:
        """Stop here if anybody wants to; collective.

        Raises:
            KeyboardInterrupt: somebody does.
        """
        if global_any(self._comm, self._asked):
            raise KeyboardInterrupt

    def __enter__(self) -> Interrupt:
        default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
        self._handles = default and threading.current_thread() is threading.main_thread()
        if self._handles:
            signal.signal(signal.SIGINT, self._handle)
        return self

    def __exit__(self, *_: object) -> None:
        if self._handles:
            signal.signal(signal.SIGINT, signal.default_int_handler)
