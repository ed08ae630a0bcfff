"""Communication between ranks: global scalars, maxima over shared groups, aborting a job.

After an uncaught error on one rank the others would wait indefinitely: an excepthook aborts the
job.
"""

from __future__ import annotations

import faulthandler
import logging
import signal
import sys
import time
import warnings
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any, NoReturn

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx.common import IndexMap
from numpy.typing import ArrayLike, NDArray

from .. import compat

_PACKAGE = __name__.partition(".")[0]

#: Messages of a rank about the others, on the screen where no program listens.
LOG = logging.getLogger(_PACKAGE)

#: Seconds that a failed rank waits for the others.
PATIENCE = 10.0

#: Longest interval between two polls [s], and the interval as a share of the wait so far.
_PAUSE, _SHARE = 0.01, 0.1


def global_sum(comm: MPI.Comm, value: ArrayLike) -> NDArray:
    return _reduced(comm, value, MPI.SUM)


def global_norm(comm: MPI.Comm, values: NDArray[np.float64]) -> float:
    return float(np.sqrt(global_sum(comm, values @ values)))


def global_max(comm: MPI.Comm, value: ArrayLike) -> Any:
    return _reduced(comm, value, MPI.MAX)


def global_box(comm: MPI.Comm, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lowest and highest coordinates (2, d) of the points (n, d) of all ranks; n may be 0."""
    ends = np.stack([-points, points]).max(axis=1, initial=-np.inf)
    return _reduced(comm, ends, MPI.MAX) * [[-1], [1]]


def global_any(comm: MPI.Comm, value: bool) -> bool:
    return bool(_reduced(comm, bool(value), MPI.MAX))


def gathered(comm: MPI.Comm, rows: NDArray) -> NDArray:
    return rows if comm.size == 1 else np.concatenate(comm.allgather(rows))


def _reduced(comm: MPI.Comm, value: ArrayLike, op: MPI.Op) -> NDArray:
    """Reduce numbers, not objects, which MPI for Python would pickle.

    In floats, since a rank without data may give the integer 0; integers stay integers where the
    result is one (below 2^53).
    """
    mine = np.asarray(value)
    counts = mine.dtype.kind in "iu"
    if comm.size == 1:
        return mine.astype(mine.dtype if counts else np.float64)[()]
    result = np.array(mine, dtype=np.float64, order="C")
    comm.Allreduce(MPI.IN_PLACE, result, op)
    whole = counts and np.isfinite(result).all() and (result % 1 == 0).all()
    return (result.astype(mine.dtype) if whole else result)[()]


def raise_together(
    comm: MPI.Comm, message: str | None, error: type[Exception] = ValueError
) -> None:
    """Raise ``error`` on every rank if any rank has a message; the lowest rank's is shown."""
    messages = [text for text in comm.allgather(message) if text is not None]
    if messages:
        raise error(messages[0])


class ModelWarning(UserWarning):
    """A problem that can be solved but is probably not what was intended; the message names the
    remedy."""


def warn_together(comm: MPI.Comm, message: str | None) -> None:
    """Warn on rank 0 if any rank has a message; the lowest rank's is shown.

    It points to the line of the user's script that called vmdg.
    """
    messages = [text for text in comm.allgather(message) if text is not None]
    if messages and comm.rank == 0:
        frame: FrameType | None = sys._getframe()
        level = 1
        while frame and frame.f_globals.get("__name__", "").partition(".")[0] == _PACKAGE:
            frame, level = frame.f_back, level + 1
        warnings.warn(messages[0], ModelWarning, stacklevel=level)


def group_maxima(
    comm: MPI.Comm,
    index_map: IndexMap,
    values: NDArray[np.int64],
    members: NDArray[np.bool_],
    group: NDArray[np.integer],
) -> NDArray[np.int64]:
    """Set the values of all members of a group, on all ranks, to their maximum; collective.

    Groups on two ranks are joined where a shared row, owned by one and a ghost on the other, is a
    member of both: values are exchanged between owners and ghosts until nothing changes.

    Args:
        values: One row per index, owned ones first, then ghosts; below 2^53, exact in doubles.
    """
    result = values.astype(PETSc.ScalarType)
    _raise_members(result, members, group)
    if comm.size == 1:
        return result.astype(np.int64)
    rows, columns = index_map.size_local, values.shape[1]
    vector = PETSc.Vec().createGhostWithArray(
        index_map.ghosts.astype(PETSc.IntType),
        result.reshape(-1),
        size=(rows * columns, None),
        bsize=columns,
        comm=comm,
    )
    changed = True
    while changed:
        before = result.copy()
        vector.ghostUpdate(PETSc.InsertMode.MAX, PETSc.ScatterMode.REVERSE)
        vector.ghostUpdate(PETSc.InsertMode.INSERT, PETSc.ScatterMode.FORWARD)
        _raise_members(result, members, group)
        changed = global_any(comm, not np.array_equal(result, before))
    vector.destroy()
    return result.astype(np.int64)


def _raise_members(
    values: NDArray[np.float64], members: NDArray[np.bool_], group: NDArray[np.integer]
) -> None:
    largest = np.full(group.max(initial=-1) + 1, -np.inf)
    np.maximum.at(largest, group, values[members])
    values[members] = largest[group]


def index_map_of(
    comm: MPI.Comm, size_local: int, numbers: NDArray[np.int64]
) -> tuple[IndexMap, NDArray[np.int32]]:
    """An index map of which every rank owns the next ``size_local`` numbers and has ghosts of the
    others among some global ``numbers``, and these as local ones; collective."""
    ends = np.cumsum(comm.allgather(size_local))
    first = int(ends[comm.rank]) - size_local
    foreign = (numbers < first) | (numbers >= first + size_local)
    ghosts = np.unique(numbers[foreign])
    owners = np.searchsorted(ends, ghosts, side="right").astype(np.int32)
    local = np.where(foreign, size_local + np.searchsorted(ghosts, numbers), numbers - first)
    return compat.index_map(comm, size_local, ghosts, owners), local.astype(np.int32)


def within(seconds: float, done: Callable[[], bool]) -> bool:
    """Wait until something is done, at most this long; return whether it is."""
    start = time.monotonic()
    while not done():
        waited = time.monotonic() - start
        if waited > seconds:
            return False
        time.sleep(min(_SHARE * waited, _PAUSE))
    return True


def end_job(message: str) -> NoReturn:
    """Abort all ranks, where they cannot raise an error each."""
    LOG.critical("vmdg: %s: the job is aborted on all ranks", message)
    sys.stdout.flush()
    sys.stderr.flush()
    MPI.COMM_WORLD.Abort(1)
    raise SystemExit(1)


def _end_all_ranks(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """After an uncaught error: abort the other ranks too, unless they end by themselves."""
    _show(kind, error, trace)
    sys.stdout.flush()
    sys.stderr.flush()
    if MPI.Is_finalized():
        return
    others = MPI.COMM_WORLD.Ibarrier()
    try:
        ended = within(PATIENCE, others.Test)
    except MPI.Exception:  # others are in MPI_Finalize or in another call
        ended = False
    if not ended:
        end_job(f"rank {MPI.COMM_WORLD.rank} has failed (above), others have not")


_show = sys.excepthook
if MPI.COMM_WORLD.size > 1:
    sys.excepthook = _end_all_ranks
    # Where a rank is when another one ends the job; the launcher sends this signal.
    faulthandler.register(signal.SIGTERM, file=sys.__stderr__, all_threads=False, chain=True)
