"""Collective errors: a failing user function, or Ctrl-C, on one rank ends the run on all ranks.

If one rank left a run, the others would wait for it indefinitely. After every call of a user
function the ranks therefore agree on its outcome by point-to-point messages, which cannot be
mistaken for those of a collective call inside the function. A rank that failed waits a short time
for the others; if they do not answer, they are inside such a call, and the job is aborted.
"""

from __future__ import annotations

import inspect
import pickle
import signal
import threading
import traceback
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import wraps
from itertools import zip_longest
from types import FrameType
from typing import Any, TypeVar, cast

from mpi4py import MPI

from .door import door
from .parallel import LOG, PATIENCE, end_job, global_any, within
from .texts import as_text

#: Seconds that a rank waits for another one before it prints a reminder.
REMINDER = 30.0

#: Seconds after which a rank that waits in a call ends the job: longer than others may work alone.
LIMIT = 3600.0

_TAG = 22093

T = TypeVar("T")


def together(comm: MPI.Comm, call: Callable[[], T]) -> T:
    """Call a user's function; an error of one rank is raised on all of them; collective.

    All ranks raise the error of the lowest failing rank, or a RuntimeError with its message where
    the error cannot be pickled. Return values may differ between ranks.
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
    """Report an error in the middle of a run to the other ranks; collective.

    Ranks without an error receive it at their next call of a user function; if they wait for this
    rank before that, the job is aborted.
    """
    if comm.size > 1:
        _first_error(comm, error)


def same_call(
    comm: MPI.Comm,
    call: str,
    given: Iterable[str] = (),
    reminder: float = REMINDER,
) -> None:
    """Refuse a collective call that only some ranks make, or with different arguments; collective.

    It detects ranks that make a different checked call at the same place. After ``reminder``
    seconds a rank that waits for the others says so.
    """
    if comm.size == 1:
        return
    others = comm.Ibarrier()
    if not within(reminder, others.Test):
        _remind(comm, f"{reminder:.3g} s in {call} for the other ranks")
        if not within(LIMIT, others.Test):
            traceback.print_stack()
            end_job(
                f"rank {comm.rank} has waited {LIMIT:.4g} s in {call} (above), where others have "
                "not come; where they are is said by each of them"
            )
    mine = call, tuple(given)
    first = comm.bcast(mine)
    if not global_any(comm, mine != first):
        return
    calls = comm.allgather(mine)
    first, said = calls[0]
    for rank, (other, arguments) in enumerate(calls):
        if other != first:
            raise ValueError(
                f"rank 0 calls {first} where rank {rank} calls {other}: all ranks must make these "
                "calls together, in the same order. Remove conditions such as `if rank == 0` and "
                "`if len(facets)`: a rank may give no facets"
            )
        if arguments != said:
            pairs = zip_longest(said, arguments, fillvalue="nothing")
            one, another = next(pair for pair in pairs if pair[0] != pair[1])
            raise ValueError(
                f"{call}: rank 0 gives {_near(one, another)}, rank {rank} {_near(another, one)}; "
                "give the same on all ranks, functions and random numbers (by one seed) too"
            )


def _near(text: str, other: str) -> str:
    """The part of a text where it differs from another one, after its name."""
    place = next((i for i, (a, b) in enumerate(zip(text, other, strict=False)) if a != b), 0)
    name, begin = text.partition(" = ")[0], max(place - 40, 0)
    return text[:100] if place < 60 else f"{name} = ...{text[begin : begin + 100]}"


def same_arguments(comm: MPI.Comm, call: str, **given: Any) -> None:
    """Refuse a call that only some ranks make, or with different arguments; collective."""
    if comm.size > 1:
        same_call(comm, call, [f"{name} = {as_text(value)}" for name, value in given.items()])


#: Arguments that say which entities of this rank are meant.
_LOCAL = ("self", "facets", "where", "interface")


def of_all_ranks(method: Callable[..., T]) -> Callable[..., T]:
    """Decorate a collective method of an object with a communicator ``comm``, whose arguments are
    equal on all ranks."""
    parameters, call = inspect.signature(method), door(method)

    @wraps(method)
    def checked(self: Any, *arguments: Any, **keywords: Any) -> T:
        if self.comm.size > 1:
            given: Mapping[str, Any] = {"arguments": [*arguments, keywords]}
            with suppress(TypeError):  # raised by the call itself
                given = parameters.bind(self, *arguments, **keywords).arguments
            common = {name: value for name, value in given.items() if name not in _LOCAL}
            same_arguments(self.comm, f"problem.{method.__name__}", **common)
        return call(self, *arguments, **keywords)

    return checked


def _first_error(comm: MPI.Comm, mine: BaseException | None) -> bytes | None:
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
    """The answer of a rank; a rank that has failed itself waits a short time only."""
    if not within(PATIENCE if mine else REMINDER, lambda: comm.Iprobe(source, _TAG)):
        if mine is not None:
            traceback.print_exception(mine)
            end_job(
                f"rank {comm.rank} has failed (above) while others wait for it in a collective call"
            )
        what = f"for rank {source} to finish a function of yours (monitor, until, a load)"
        _remind(comm, f"{REMINDER:.3g} s {what}")
    return comm.recv(source=source, tag=_TAG)


def _remind(comm: MPI.Comm, waited: str) -> None:
    """Say how long this rank has waited, and a possible reason."""
    LOG.warning(
        "vmdg: rank %d has waited %s. If this never ends, look for a collective call, such as "
        "problem.reaction, that only some ranks make, for example under `if rank == 0`",
        comm.rank,
        waited,
    )


def _packed(error: BaseException, rank: int) -> bytes:
    try:
        packed = pickle.dumps(error)
        pickle.loads(packed)
    except Exception:  # a user's class may raise anything
        words = f"on rank {rank}: {type(error).__name__}: {error}"
        packed = pickle.dumps(RuntimeError(words))
    return packed


class Interrupt:
    """Ctrl-C ends a run between two attempts of a step, on all ranks; collective.

    A second one interrupts at once, and the current step is lost. Other signal handlers are
    unchanged.
    """

    def __init__(self, comm: MPI.Comm):
        self._comm = comm
        self._asked = self._handles = False

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._asked:
            signal.default_int_handler(number, frame)
        self._asked = True
        if self._comm.rank == 0:
            words = "the run ends after this attempt of a step; press Ctrl-C again to stop at once"
            LOG.warning("\nvmdg: %s", words)

    def check(self) -> None:
        """Stop here if any rank was interrupted; collective."""
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
