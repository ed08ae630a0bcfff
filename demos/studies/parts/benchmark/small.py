"""What a row of a small problem costs outside of PETSc, DOLFINx's C++ and compiled kernels.

Two bonded blocks are pulled apart and sheared until their bond is broken. Processor time of calls
that end in compiled code is taken from the interpreter, and that of the whole run from a run of its
own; the rest is Python and numpy.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from time import process_time

from mpi4py import MPI

import numpy as np

import vmdg
from vmdg.meshes import blocks

#: Cells along and across both blocks.
SIZES = ((6, 5), (24, 22), (30, 40))
STEPS, REACH = 40, (0.08, 0.016)  # mm

#: Modules of callables that end in compiled code, and one that calls Python again.
COMPILED, CALLS_BACK = ("petsc4py", "mpi4py", "nanobind", "vmdg_"), "SNES.solve"

HEAD = ("two blocks", "unknowns", "rows", "all [ms a row]", "compiled", "Python and numpy")


@dataclass(frozen=True)
class Cost:
    """Processor times of a run [s].

    Attributes:
        kinematics: "small" or "finite".
        size: Number of unknowns.
        rows: Of the history.
        seconds: Of the run.
        compiled: Of it in compiled code.
    """

    kinematics: str
    size: int
    rows: int
    seconds: float
    compiled: float

    def row(self) -> list[str | int | float]:
        """Of the table below ``HEAD``."""
        parts = self.seconds, self.compiled, self.seconds - self.compiled
        return [self.kinematics, self.size, self.rows, *(1e3 * x / self.rows for x in parts)]


def measure(kinematics: str, divisions: tuple[int, int], repeats: int) -> Cost:
    """One row of the table: the least of some runs.

    Args:
        kinematics: "small" or "finite".
        divisions: Cells along and across both blocks.
        repeats: Runs of each kind.
    """
    seconds, compiled, rows, size = np.inf, np.inf, 0, 0
    for _ in range(repeats + 1):  # the first ones compile
        problem, size = _problem(kinematics, divisions)
        start = process_time()
        rows = _solve(problem)
        seconds = min(seconds, process_time() - start)
        problem, _ = _problem(kinematics, divisions)
        compiled = min(compiled, in_compiled_code(lambda now=problem: _solve(now)))
    return Cost(kinematics, size, rows, seconds, compiled)


def _problem(kinematics: str, divisions: tuple[int, int]) -> tuple[vmdg.Problem, int]:
    """The blocks, whose kernels are loaded, and their number of unknowns."""
    mesh, cells, facets = blocks(MPI.COMM_WORLD, "quadrilateral", divisions)
    law = vmdg.Debonding(strength=100.0, critical_gap=0.05, friction=0.3)
    materials = dict.fromkeys((1, 2), vmdg.NeoHookean(E=5000.0, nu=0.25))
    bond = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(mesh, cells, materials, [bond], kinematics=kinematics)
    problem.dirichlet(facets.find(1), 0.0)
    problem.dirichlet(facets.find(2), lambda t: tuple(t * reach for reach in REACH))
    problem.discretization.compile()
    return problem, len(problem.u.x.array)


def _solve(problem: vmdg.Problem) -> int:
    """The number of rows."""
    return len(vmdg.solve(problem, np.linspace(0, 1, STEPS + 1)[1:]).history)


def in_compiled_code(run: Callable[[], object]) -> float:
    """Processor time of a run in calls of ``COMPILED`` [s]."""
    monitoring, total, begun = sys.monitoring, 0.0, -1.0

    def call(code: object, offset: int, function: object, first: object) -> object:
        nonlocal begun
        if not _is_compiled(function):
            return monitoring.DISABLE
        begun = process_time()
        return None

    def end(code: object, offset: int, function: object, first: object) -> None:
        nonlocal total, begun
        if begun >= 0:
            total, begun = total + process_time() - begun, -1.0

    tool, events = monitoring.PROFILER_ID, monitoring.events
    monitoring.use_tool_id(tool, "vmdg")
    monitoring.restart_events()
    for event, function in ((events.CALL, call), (events.C_RETURN, end), (events.C_RAISE, end)):
        monitoring.register_callback(tool, event, function)
    monitoring.set_events(tool, events.CALL)
    try:
        run()
    finally:
        monitoring.set_events(tool, 0)
        monitoring.free_tool_id(tool)
    return total


def _is_compiled(function: object) -> bool:
    """Whether a callable ends in compiled code, without a call of Python."""
    if getattr(function, "__qualname__", "").endswith(CALLS_BACK):
        return False
    owner = getattr(function, "__objclass__", type(getattr(function, "__self__", None)))
    homes = getattr(function, "__module__", ""), type(function).__module__, owner.__module__
    return any(str(home).startswith(COMPILED) for home in homes)
