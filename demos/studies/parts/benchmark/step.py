"""What a load step of vmdg takes in addition to assembly and linear solves, per facet and per cell.

Every action of a step is run on two boxes with the same interface, all points at work, one with
twice the cells: what grows is the cells' share, the rest that of the facets. Memory is the largest
that numpy holds in the action, without matrices. A step has three corrections, by multigrid.
"""

from __future__ import annotations

import tempfile
import tracemalloc
import warnings
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from petsc4py import PETSc

import vmdg
from parts.benchmark.common import least_times
from parts.benchmark.ratio import TOLERANCE, block, stabilize
from vmdg.linear.ksp import GMRES_GAMG, LU, LinearSolver, set_rigid_modes

#: Corrections of a step; it asks for one residual more.
CORRECTIONS = 3
HEAD = (
    "in a step",
    "times",
    "us a facet",
    "us a cell",
    "bytes a facet",
    "bytes a cell",
    "ms a step",
    "share",
)


@dataclass(frozen=True)
class Action:
    """What a step does.

    Attributes:
        name: What it is.
        times: How often it is done in a step.
        seconds: Processor time on the two boxes, the smaller one first [s].
        memory: The same [bytes].
        facets, cells: Of the two boxes.
    """

    name: str
    times: int
    seconds: tuple[float, float]
    memory: tuple[float, float]
    facets: int
    cells: tuple[int, int]

    def shares(self, measured: tuple[float, float]) -> tuple[float, float]:
        """What is measured, for a facet and for a cell."""
        of_cell = (measured[1] - measured[0]) / (self.cells[1] - self.cells[0])
        return (measured[0] - of_cell * self.cells[0]) / self.facets, of_cell

    @property
    def of_step(self) -> float:
        """Processor time in a step on the larger box [s]."""
        return self.times * self.seconds[1]


class _Box:
    """A box whose interface is at work, and what a step does with it."""

    def __init__(self, refine: float, height: float):
        self._problem = problem = block("3D", True, refine, height)
        parts = problem.discretization
        self._matrix = matrix = parts.create_matrix(PETSc.Mat.Type.BAIJ)
        matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        set_rigid_modes(problem.space, parts.geometry, matrix)
        self._residual = problem.step.assemble_residual().copy()
        self._residual[problem.loading.prescribed] = 0
        parts.assemble_tangent(matrix, failing=False)
        self._hold()
        self._solver = LinearSolver(matrix, GMRES_GAMG, LU)
        self._solver.coarsen()
        self._x, self._b = matrix.createVecs()
        parts.assemble_tangent(matrix)
        self._hold()
        problem.step.begin(1.0, 1.0)
        problem.step.assemble_residual()
        self.facets = len(parts.active[0].facets.facets)
        self.cells = problem.mesh.topology.index_map(3).size_local

    def _hold(self) -> None:
        self._matrix.zeroRowsColumnsLocal(self._problem.loading.prescribed, 1.0)

    def _solve(self) -> None:
        self._b.array[:] = self._residual
        self._x.set(0.0)
        self._solver.renew()
        self._solver.solve(self._b, self._x, TOLERANCE)

    def actions(self, files: ExitStack) -> dict[str, tuple[int, Callable[[], object]]]:
        """How often a step does what; files go to a folder that is left with all it keeps."""
        problem = self._problem
        parts, step = problem.discretization, problem.step
        folder = Path(files.enter_context(tempfile.TemporaryDirectory()))
        writer = files.enter_context(vmdg.FieldWriter(problem, folder / "fields"))

        def hold() -> None:
            parts.assemble_tangent(self._matrix)
            self._hold()

        active = parts.active[0]
        history = active.history

        def commit() -> None:
            active.history = history  # points move in every one
            step.commit()

        return {
            "linear solve": (CORRECTIONS, self._solve),
            "tangent": (CORRECTIONS, hold),
            "residual": (CORRECTIONS + 1, step.assemble_residual),
            "of it return map": (CORRECTIONS + 1, lambda: parts.update_points(1.0)),
            "tau_s and its coercivity": (1, lambda: stabilize(problem)),
            "tau_s of the next step": (1, parts.update_stabilization),
            "load vector": (1, lambda: problem.loading.move(1.0)),
            "state to come back to": (1, step.snapshot),
            "inverted cells": (1, step.invalid),
            "facets to open": (1, step.activation.utilization),
            "commit, works": (1, commit),
            "row: energies": (1, problem.energy),
            "row: sliding": (1, step.watch_sliding),
            "fields, a file": (1, lambda: writer.write(1.0)),
            "checkpoint, files": (1, lambda: vmdg.write_checkpoint(problem, folder / "checkpoint")),
        }


def measure(repeats: int, refine: float = 1.0) -> list[Action]:
    """All actions of a step.

    Args:
        repeats: The least of so many runs.
        refine: Multiplies the numbers of cells along the edges.
    """
    boxes = [_Box(refine, height) for height in (0.5, 1.0)]
    found = []
    with ExitStack() as files, warnings.catch_warnings():
        # The interface slides far, so that all of its points are at work.
        warnings.simplefilter("ignore", vmdg.ModelWarning)
        actions = [box.actions(files) for box in boxes]
        for name, (times, _) in actions[0].items():
            both = {str(i): {name: each[name][1]} for i, each in enumerate(actions)}
            seconds = least_times(both, repeats)
            memory = tuple(_memory(each[name][1]) for each in actions)
            found.append(
                Action(
                    name,
                    times,
                    tuple(seconds[box][name] for box in both),
                    memory,
                    boxes[0].facets,
                    tuple(box.cells for box in boxes),
                )
            )
    return found


def _memory(action: Callable[[], object]) -> float:
    """Largest memory of numpy in an action [bytes]."""
    tracemalloc.start()
    action()
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return most


def rows(actions: list[Action]) -> list[list]:
    """Of the table below ``HEAD``; parts of others are not counted twice."""
    whole = sum(action.of_step for action in actions if not action.name.startswith("of it"))
    return [
        [
            action.name,
            action.times,
            *(1e6 * share for share in action.shares(action.seconds)),
            *(round(share) for share in action.shares(action.memory)),
            1e3 * action.of_step,
            f"{100 * action.of_step / whole:.1f} %",
        ]
        for action in actions
    ]
