"""Runs whose mesh is fine where cracks grow, and follows them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

import basix
import basix.ufl
import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from ..base.parallel import gathered
from ..checks.model import checked_loads
from ..checks.zone import facet_corners, load_of
from ..output.history import History
from ..problem.problem import Problem
from ..problem.states import RunScales, Snapshot
from ..solver.monitors import Monitor
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
    """

    def __init__(self, fine: float, radius: float, fronts: Array = NONE, along: Array = NONE):
        self.fronts, self.fine, self.radius = fronts, fine, radius
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
    """The state of a row to which a run may return.

    Attributes:
        rows: Number of rows up to there.
        loads: Number of load factors that have been reached.
        warned: Number of warnings up to there.
    """

    state: Snapshot
    scales: RunScales
    rows: int
    loads: int
    warned: int


@dataclass
class Adapted:
    """A run on several meshes.

    Attributes:
        problem: The problem on the last mesh.
        history: The rows of all meshes, with the column "unknowns".
        results: The result of each mesh.
        transfers: What each change of the mesh has changed.
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
) -> Adapted:
    """Solve for a sequence of load factors, with a mesh that is fine around growing cracks.

    The front of a crack is the points of bonds that soften, or carry half of their strength. When
    a front has moved by 0.7 of the window, the mesh is made again around it, coarse in the wake of
    the crack, and the state is carried there by :func:`transfer`. A row in which a front has left
    the window is not kept: it is computed again on the new mesh. So the first rows may be on a
    coarse mesh; it must resolve the stress that starts a crack to within a factor of two.

    Args:
        make_problem: Makes the problem, with supports and loads, on a mesh whose cells have the
            size that a function (3, n) -> (n,) [mm] asks for, infinite where any will do: by
            :func:`vmdg.meshes.refined` of a coarse root, or by gmsh.
        loads: As for :func:`.solve`.
        fine: Size of cells at fronts [mm], see :attr:`Window.fine`. The warning of :func:`.solve`
            about process zones says what is needed.
        window: Distance from a front up to which cells along interfaces have it [mm], at least
            the length of the process zone.
        options: As for :func:`.solve`, without checkpoints and a table on disk.
        monitor: As for :func:`.solve`; called with the problem of the present mesh.
        most_unknowns: Largest number of unknowns of a mesh.

    Raises:
        ValueError: sizes that are not positive, a window smaller than four cells, options that
            write files, a mesh with more unknowns, or what :func:`transfer` refuses.
        StepFailure: as of :func:`.solve`.
        RuntimeError: fronts leave every window within a row, or as of :func:`transfer`.

    An exception has the rows so far as ``result``, and the problem as ``problem``.
    """
    options = _checked(fine, window, options)
    around = Window(fine, window)
    run = Adapted(_made(make_problem, around, most_unknowns), History())
    loads = checked_loads(loads, run.problem, None)
    try:
        _follow(run, make_problem, loads, around, options, monitor, most_unknowns)
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
) -> None:
    """The rows of all meshes; collective."""
    radius, reached, again = around.radius, 0, 0
    while True:
        problem, step, first = run.problem, run.problem.step, len(run.history)
        # The last row within the window.
        kept, said = [Kept(step.snapshot(), step.scales, first, reached, 0)], []

        def watch(problem: Problem) -> dict[str, float]:
            return dict(monitor(problem) if monitor else {}) | {"unknowns [-]": _unknowns(problem)}

        def leaves(problem: Problem, kept=kept, said=said, around=around) -> bool:
            farthest = _farthest(problem, around)
            if farthest <= radius:
                done = kept[0].loads
                done += problem.t == loads[done]
                here = problem.step.snapshot(), problem.step.scales
                kept[0] = Kept(*here, len(run.history), done, len(said))
            return farthest > MOVES * radius

        with _held_back(said, kept):
            result = solve(problem, loads[reached:], options, watch, run.history, until=leaves)
        run.results.append(result)
        run.history = result.history
        if kept[0].loads == len(loads):
            return
        around = _window(problem, around)
        state, step.scales, count, reached, _ = kept[0]
        del run.history.rows[count:]
        step.return_to(state)
        again = again + 1 if count == first else 0
        if again > MOST:
            raise RuntimeError(
                f"solve_adaptively: fronts leave the window of {radius:.3g} mm within every step "
                f"from load factor {state.t:.6g} on; use a larger window or smaller load steps"
            )
        finer = _made(make_problem, around, most_unknowns)
        run.transfers.append(transfer(problem, finer))
        run.problem = finer


def _checked(fine: float, window: float, options: SolveOptions | None) -> SolveOptions:
    if not (0 < fine < np.inf and 4 * fine <= window < np.inf):
        raise ValueError(
            f"solve_adaptively: fine = {fine!r} and window = {window!r} must be positive lengths, "
            "the window at least four cells"
        )
    options = SolveOptions() if options is None else options
    if options.checkpoint is not None or options.csv is not None:
        raise ValueError(
            "solve_adaptively: checkpoint= and csv= are of runs on one mesh; write the history at "
            "the end, or vmdg.write_checkpoint of the last problem"
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
