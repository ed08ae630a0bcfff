"""Runs whose mesh is fine where cracks grow, and follows them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from ..base.agreement import together
from ..base.disk import replacing
from ..base.parallel import gathered
from ..checkpoint.checkpoint import (
    discard_checkpoint,
    read_checkpoint,
    warn_of_replacement,
    write_checkpoint,
)
from ..checks.model import checked_loads
from ..checks.zone import load_of
from ..domain.topology import facet_corners
from ..linear.ksp import linear_options
from ..output.history import History
from ..problem.problem import Problem
from ..problem.states import RunScales, Snapshot
from ..solver.monitors import Monitor, Until, ends
from ..solver.options import SolveOptions
from ..solver.result import Result
from ..solver.stepping import solve
from .transfer import Transfer, transfer

Array = NDArray[np.float64]

#: Traction relative to the strength from which a point belongs to a front, and softening relative
#: to the strength up to which it does.
NEAR, GONE = 0.5, 0.999

#: How far a front may move, relative to the window, until the mesh is made again.
MOVES = 0.7

#: Growth of the size of cells with the distance from the window.
GRADED = 0.4

#: Most meshes for one row.
MOST = 5

NONE: Array = np.zeros((0, 3))


class Window:
    """The size of cells: fine along interfaces around the fronts of cracks, and growing with the
    distance.

    Attributes:
        fronts: Points of the fronts (n, 3) [mm].
        fine: Size of cells there [mm].
        radius: Distance from them up to which cells along interfaces are so [mm].
        along: Points of the interfaces up to there (m, 3) [mm].
    """

    def __init__(self, fine: float, radius: float, fronts: Array = NONE, along: Array = NONE):
        self.fronts, self.along, self.fine, self.radius = fronts, along, fine, radius
        self._trees = [scipy.spatial.cKDTree(x) if len(x) else None for x in (fronts, along)]

    def away(self, points: Array) -> Array:
        """Distance of points (n, 3) from the nearest front (n,) [mm]; infinite where there is
        none."""
        return self._distance(0, points)

    def _distance(self, which: int, points: Array) -> Array:
        tree = self._trees[which]
        return np.full(len(points), np.inf) if tree is None else tree.query(points)[0]

    def __call__(self, x: Array) -> Array:
        """Size of cells at points (3, n): (n,) [mm]; infinite without a front."""
        away = self._distance(1, np.transpose(x))
        return self.fine + GRADED * np.maximum(away - self.fine, 0.0)


class Kept(NamedTuple):
    """The state of a row to which a run may return."""

    state: Snapshot
    scales: RunScales
    rows: int  # Number of rows up to there
    loads: int  # Number of load factors that have been reached
    warned: int  # Number of warnings up to there
    ended: bool  # Whether the run is at its end


@dataclass
class Adapted:
    """A run on several meshes.

    Attributes:
        problem: The problem on the last mesh.
        history: The rows of all meshes, with the column "unknowns".
        results: The result of each mesh.
        transfers: What each change of the mesh behind the first row has changed.
    """

    problem: Problem
    history: History
    results: list[Result] = field(default_factory=list)
    transfers: list[Transfer] = field(default_factory=list)


def solve_adaptively(
    make_problem: Callable[[Window], Problem],
    loads: ArrayLike,
    fine: float,
    window: float,
    options: SolveOptions | None = None,
    monitor: Monitor | None = None,
    most_unknowns: float = np.inf,
    until: Until | None = None,
    resume: bool = False,
) -> Adapted:
    """Solve for a sequence of load factors, with a mesh that is fine around growing cracks.

    The front of a crack is the points of bonds that soften, or carry half of their strength. When
    a front has moved by 0.7 of the window, the mesh is made again around it, coarse in the wake of
    the crack, and the state is carried there by :func:`transfer`. A row in which a front has left
    the window is not kept: it is computed again on the new mesh. The first mesh, without a window,
    only tells where cracks start: when it does, the run begins again, since on small cells bonds
    soften sooner. Where a further crack starts far from the others, cells must resolve the stress
    to within a factor of two.

    Args:
        make_problem: Makes the problem, with supports and loads, on a mesh whose cells have the
            size that a function (3, n) -> (n,) [mm] asks for, infinite where any will do: by
            :func:`vmdg.meshes.refined` of a coarse root, or by gmsh.
        loads: As for :func:`.solve`.
        fine: Size of cells at fronts [mm], see :attr:`Window.fine`. The warning of :func:`.solve`
            about process zones says what is needed.
        window: Distance from a front up to which cells along interfaces have it [mm], at least
            the length of the process zone.
        options: As for :func:`.solve`, without a table on disk; in 3D the linear solver is that of
            the first mesh with a window, on all meshes. Of ``checkpoint`` a folder is made
            for every mesh, when the state has come there and at the end; the last two are kept.
        monitor: As for :func:`.solve`; called with the problem of the present mesh.
        most_unknowns: Largest number of unknowns of a mesh.
        until: As for :func:`.solve`; called with the problem of the present mesh.
        resume: Continue from the last checkpoint in the folder, if there is one, on any number of
            ranks; loads are those of the whole run.

    Raises:
        ValueError: sizes that are not positive, a window smaller than two cells, options that
            write a table, ``resume`` without a folder, a mesh with more unknowns, or what
            :func:`transfer` refuses.
        StepFailure: as of :func:`.solve`.
        RuntimeError: fronts leave every window within a row, or as of :func:`transfer`.

    An exception has the rows so far as ``result``, and the problem as ``problem``.
    """
    options = _checked(fine, window, options, resume)
    around, folder = Window(fine, window), options.checkpoint
    run = Adapted(_made(make_problem, around, most_unknowns), History())
    loads = checked_loads(loads, run.problem, None)
    kept = None if folder is None else _last_window(run.problem.comm, folder)
    if kept is not None and resume:
        around = Window(fine, window, *kept[1:])
        run.problem = _made(make_problem, around, most_unknowns)
        run.history = read_checkpoint(run.problem, kept[0]) or run.history
    elif kept is not None:
        warn_of_replacement(run.problem.comm, kept[0])
    options = replace(options, checkpoint=None)
    try:
        _follow(run, make_problem, loads, around, options, monitor, most_unknowns, until, folder)
    except BaseException as error:
        error.problem = run.problem  # type: ignore[attr-defined]
        if run.results and not hasattr(error, "result"):
            error.result = run.results[-1]  # type: ignore[attr-defined]
        raise
    return run


def _follow(
    run: Adapted,
    make_problem: Callable[[Window], Problem],
    loads: Array,
    around: Window,
    options: SolveOptions,
    monitor: Monitor | None,
    most_unknowns: float,
    until: Until | None,
    folder: Path | None,
) -> None:
    """The rows of all meshes; collective."""
    radius, reached, again = around.radius, 0, 0
    for row in run.history.rows:
        reached += reached < len(loads) and row["load"] == loads[reached]
    if reached == len(loads):
        return
    while True:
        problem, step, first = run.problem, run.problem.step, len(run.history)
        # The last row within the window.
        kept, said = [Kept(step.snapshot(), step.scales, first, reached, 0, False)], []
        started = len(around.fronts) > 0

        def watch(problem: Problem) -> dict[str, float]:
            return dict(monitor(problem) if monitor else {}) | {"unknowns [-]": _unknowns(problem)}

        def leaves(problem: Problem, kept=kept, said=said, around=around, shown=started) -> bool:
            farthest = _farthest(problem, around)
            if farthest <= radius:
                done = kept[0].loads
                done += problem.t == loads[done]
                here = problem.step.snapshot(), problem.step.scales
                ended = done == len(loads) or ends(problem, until)
                warned = len(said) if shown or ended else 0
                kept[0] = Kept(*here, len(run.history), done, warned, ended)
            return kept[0].ended or farthest > MOVES * radius

        with _held_back(said, kept):
            result = solve(problem, loads[reached:], options, watch, run.history, until=leaves)
        run.results.append(result)
        run.history = result.history
        if kept[0].ended:
            _save(run, around, folder)
            return
        state, step.scales, count, reached = kept[0][:4]
        if not started:
            count, reached = 0, 0
        around = _window(problem, around)
        del run.history.rows[count:]
        step.return_to(state)
        again = again + 1 if count == first else 0
        if again > MOST:
            raise RuntimeError(
                f"solve_adaptively: fronts leave the window of {radius:.3g} mm within every step "
                f"from load factor {state.t:.6g} on; use a larger window or smaller load steps"
            )
        run.problem = _made(make_problem, around, most_unknowns)
        if not started and problem.mesh.topology.dim == 3:
            # The choice would change with the size of the mesh.
            solver = linear_options(run.problem, options.petsc).solver
            options = replace(options, petsc={**(options.petsc or {}), **solver})
        if started and run.history.rows:
            run.transfers.append(transfer(problem, run.problem, options.petsc))
            _save(run, around, folder)


def _place(folder: Path, number: int) -> tuple[Path, Path]:
    """Folder of the checkpoint on a mesh, and the file of its window."""
    return folder / f"mesh_{number}", folder / f"mesh_{number}.npz"


def _numbers(folder: Path) -> list[int]:
    """Of the meshes of which there is a checkpoint, ascending; on one rank."""
    names = [path.parent.name for path in folder.glob("mesh_*/latest")]
    return sorted(int(name[5:]) for name in names if name[5:].isdecimal())


def _save(run: Adapted, around: Window, folder: Path | None) -> None:
    """Write the state on the present mesh, and remove those before the last two; collective."""
    if folder is None:
        return
    comm = run.problem.comm
    known = comm.bcast(_numbers(folder) if comm.rank == 0 else None)
    place, window = _place(folder, known[-1] + 1 if known else 0)

    def write() -> None:
        if comm.rank == 0:
            folder.mkdir(parents=True, exist_ok=True)
            with replacing(window) as file:
                np.savez(file, fronts=around.fronts, along=around.along)

    together(comm, write)
    write_checkpoint(run.problem, place, run.history)
    for number in known[:-1]:
        place, window = _place(folder, number)
        discard_checkpoint(comm, place)
        if comm.rank == 0:
            window.unlink(missing_ok=True)


def _last_window(comm: MPI.Comm, folder: Path) -> tuple[Path, Array, Array] | None:
    """Folder of the last checkpoint, fronts and places of its window; collective."""

    def read() -> tuple[Path, Array, Array] | None:
        if comm.rank or not (known := _numbers(folder)):
            return None
        place, window = _place(folder, known[-1])
        with np.load(window) as file:
            return place, file["fronts"], file["along"]

    return comm.bcast(together(comm, read))


def _checked(
    fine: float, window: float, options: SolveOptions | None, resume: bool
) -> SolveOptions:
    if not (0 < fine < np.inf and 2 * fine <= window < np.inf):
        raise ValueError(
            f"solve_adaptively: fine = {fine!r} and window = {window!r} must be positive lengths, "
            "the window at least two cells"
        )
    options = SolveOptions() if options is None else options
    if options.csv is not None:
        raise ValueError(
            "solve_adaptively: csv= is of runs on one mesh, whose rows stay; write the history at "
            "the end, run.history.to_csv(...)"
        )
    if resume and options.checkpoint is None:
        raise ValueError(
            "solve_adaptively: resume=True needs the folder of the checkpoints, "
            "SolveOptions(checkpoint=...)"
        )
    return options


def _made(make: Callable[[Window], Problem], around: Window, most: float) -> Problem:
    problem = make(around)
    if not isinstance(problem, Problem):
        raise TypeError(f"solve_adaptively: make_problem returned {problem!r}, not a vmdg.Problem")
    if (count := _unknowns(problem)) > most:
        raise ValueError(
            f"solve_adaptively: the mesh around the present fronts has {count} unknowns, more than "
            f"most_unknowns = {most:.6g}; use larger cells or a smaller window"
        )
    return problem


def _unknowns(problem: Problem) -> int:
    dofmap = problem.space.dofmap
    return dofmap.index_map.size_global * dofmap.index_map_bs


def _front(problem: Problem) -> Array:
    """This rank's points of the fronts (n, 3) [mm]."""
    found = [np.zeros((0, 3))]
    for active in problem.discretization.active.values():
        if active.law.has_bond:
            gone = active.history.softening >= GONE * active.law.strength
            found.append(active.quadrature.points[(load_of(active) >= NEAR) & ~gone])
    return np.concatenate(found)


def _window(problem: Problem, last: Window) -> Window:
    """The window around the present fronts: of the interfaces near them, places no farther from
    each other than a cell; collective."""
    fine, radius = last.fine, last.radius
    fronts, found = gathered(problem.comm, _front(problem)), [NONE]
    tree = scipy.spatial.cKDTree(fronts)
    for active in problem.discretization.active.values():
        corners = facet_corners(problem.mesh, active.facets.facets)
        middle = corners.mean(axis=1, keepdims=True)
        size = 2 * np.linalg.norm(corners - middle, axis=2).max(axis=1, initial=0.0)
        near = tree.query(middle[:, 0])[0] <= radius + size / 2
        kind = basix.cell.subentity_types(problem.mesh.basix_cell())[problem.mesh.topology.dim - 1]
        parts = np.ceil(size[near] / fine).astype(int)
        for count in np.unique(parts):
            lattice = basix.create_lattice(kind[0], count, basix.LatticeType.equispaced, True)
            shares = basix.ufl.element("Lagrange", kind[0], 1).tabulate(0, lattice)[0]
            found.append((shares @ corners[near][parts == count]).reshape(-1, 3))
    places = gathered(problem.comm, np.concatenate(found))
    places = places[tree.query(places)[0] <= radius]
    return Window(fine, radius, fronts, np.unique(places.round(12), axis=0))


@contextmanager
def _held_back(said: list[warnings.WarningMessage], kept: list[Kept]) -> Iterator[None]:
    """Issue the warnings of a run at its end, without those of rows that are not kept: there cells
    may be too large for a process zone."""
    ended = False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.showwarning = lambda *given: said.append(warnings.WarningMessage(*given))
            yield
        ended = True
    finally:
        for one in said[: kept[0].warned] if ended else said:
            warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)


def _farthest(problem: Problem, around: Window) -> float:
    """Largest distance of the front from the middle of the window; 0 without a front;
    collective."""
    away = around.away(_front(problem)).max(initial=0.0)
    return max(problem.comm.allgather(float(away)))
