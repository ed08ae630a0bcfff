"""What fails on one rank ends the run on all: errors of users' functions, and Ctrl-C.

A rank that leaves a run while others wait for it would have them wait for ever. So where vmdg calls
a function of the user the ranks agree on how it went, by messages from rank to rank, which cannot
be taken for those of a collective call inside of that function. A rank that failed waits for the
others, but not for long; if they do not answer they are in such a call, and the job is ended.
"""

from __future__ import annotations

import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterable
from functools import wraps
from itertools import zip_longest
from types import FrameType
from typing import Any, TypeVar, cast

from mpi4py import MPI

from .parallel import PATIENCE, end_job, global_any, within

#: Seconds that a rank waits for another one before it says so.
REMINDER = 30.0

_TAG = 22093

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
    result, mine = cast(T, None), None
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


def same_call(
    comm: MPI.Comm, call: str, given: Iterable[str] = (), reminder: float = REMINDER
) -> None:
    """Refuse a call of all ranks that only some make, or make with other arguments; collective.

    It finds those at whose place other ranks make another call that asks the same.

    Args:
        comm: The ranks.
        call: What this rank calls.
        given: Its arguments in words, as far as they are to be the same.
        reminder: Seconds that a rank waits for the others before it says so.

    Raises:
        ValueError: ranks differ; on all ranks.
    """
    if comm.size == 1:
        return
    others = comm.Ibarrier()
    if not within(reminder, others.Test):
        _remind(comm, f"{reminder:.3g} s in {call} for the other ranks")
        others.Wait()
    calls = comm.allgather((call, tuple(given)))
    first, said = calls[0]
    for rank, (other, arguments) in enumerate(calls):
        if other != first:
            raise ValueError(
                f"rank 0 calls {first} where rank {rank} calls {other}: all ranks make these calls "
                "together, in one order. Leave out conditions such as `if rank == 0` and "
                "`if len(facets)`: a rank may give no facets"
            )
        if arguments != said:
            pairs = zip_longest(said, arguments, fillvalue="nothing")
            one, another = next(pair for pair in pairs if pair[0] != pair[1])
            raise ValueError(
                f"{call}: rank 0 gives {one:.200}, rank {rank} {another:.200}; give the same on "
                "all ranks, functions and random numbers (by one seed) too"
            )


def of_all_ranks(method: Callable[..., T]) -> Callable[..., T]:
    """A method of an object with a communicator ``comm`` that all ranks call together."""

    @wraps(method)
    def checked(self: Any, *arguments: Any, **keywords: Any) -> T:
        same_call(self.comm, f"problem.{method.__name__}")
        return method(self, *arguments, **keywords)

    return checked


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
    if not within(PATIENCE if mine else REMINDER, lambda: comm.Iprobe(source, _TAG)):
        if mine is not None:
            traceback.print_exception(mine)
            end_job(
                f"rank {comm.rank} has failed (above) while others wait for it in a call of all"
            )
        what = f"for rank {source} to end a function of yours (monitor, until, a load)"
        _remind(comm, f"{REMINDER:.3g} s {what}")
    return comm.recv(source=source, tag=_TAG)


def _remind(comm: MPI.Comm, waited: str) -> None:
    """Say how long this rank has waited, and what may be the reason."""
    print(
        f"vmdg: rank {comm.rank} has waited {waited}. If this never ends, look for a call of all "
        "ranks, such as problem.reaction, that only some ranks make, under `if rank == 0` for "
        "example",
        file=sys.stderr,
        flush=True,
    )


def _packed(error: BaseException, rank: int) -> bytes:
    """An error as it can be sent."""
    try:
        packed = pickle.dumps(error)
        pickle.loads(packed)
    except Exception:  # of a user's class, which may do anything
        words = f"on rank {rank}: {type(error).__name__}: {error}"
        packed = pickle.dumps(RuntimeError(words))
    return packed


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
        if self._comm.rank == 0:
            words = "the run ends after the present attempt of a step; Ctrl-C again ends it at once"
            print(f"\nvmdg: {words}", file=sys.stderr, flush=True)

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
