"""Krylov iterations while a zone grows in which a bond fails: six tangents, multigrid in 3D.

The upper half of a cube has moved along the lower one behind a straight front. There half of the
interface is pressed, slides and rubs, the other half opens and softens steeply, H = E/mm; it holds
ahead of the front. The tangents have a negative eigenvalue or a few. Coarse matrices are made of
every tangent; vmdg by itself keeps them while this costs fewer iterations than it saves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

import vmdg
from parts.benchmark.common import BOTTOM, LOWER, TOP, UPPER, layers
from vmdg.domain.topology import tags_of_cells
from vmdg.linear.ksp import GMRES_GAMG, LU, LinearSolver, set_rigid_modes

BODY = {"E": 1000.0, "nu": 0.3}  # MPa
BOND = vmdg.Debonding(strength=10.0, critical_gap=0.01, friction=0.3)  # MPa, mm
#: Positions of the front [mm], and the strain that presses.
FRONTS, PRESSED = (0.325, 0.425, 0.525, 0.625, 0.725, 0.825), 0.03
TOLERANCE = 1e-8
HEAD = ("interpolation", "unknowns", "Krylov iterations")


@dataclass(frozen=True)
class Growth:
    """Solves with the tangents of a growing zone.

    Attributes:
        bodies: Whether interpolation is made from the bodies alone, once; else from every tangent.
        unknowns: Their number.
        iterations: For every front.
    """

    bodies: bool
    unknowns: int
    iterations: Sequence[int]

    def row(self) -> list[str | int]:
        """Of the table below ``HEAD``."""
        source = "of the bodies, kept" if self.bodies else "of every tangent"
        return [source, self.unknowns, " ".join(map(str, self.iterations))]


def _field(front: float, jump: float) -> Callable[[np.ndarray], np.ndarray]:
    def u(x: np.ndarray) -> np.ndarray:
        behind = np.maximum((front - x[0]) / front, 0.0)
        slip = jump * BOND.critical_gap * np.where(behind > 0, 0.6 * behind + 0.02, 0.0)
        return np.array([0.001 * x[0] + slip, 0 * slip, slip * (x[1] < 0.5) - PRESSED * x[2]])

    return u


def measure(bodies: bool, n: int, fronts: Sequence[float] = FRONTS) -> Growth:
    """Solve with the tangents one after the other.

    Args:
        bodies: Whether interpolation is made from the bodies alone.
        n: Cells along an edge.
        fronts: Positions [mm].
    """
    tagged = layers("hexahedron", (n, n, n), np.ones(3), n // 2)
    material = vmdg.NeoHookean(**BODY)
    interface = vmdg.Interface(between=(LOWER, UPPER), law=BOND)
    problem = vmdg.Problem(
        tagged.mesh, tagged.cell_tags, {LOWER: material, UPPER: material}, [interface]
    )
    ends = np.concatenate([tagged.facet_tags.find(tag) for tag in (BOTTOM, TOP)])
    problem.dirichlet(ends, 0.0)
    parts, held = problem.discretization, problem.loading.owned_prescribed
    matrix = parts.create_matrix(PETSc.Mat.Type.BAIJ)
    matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
    set_rigid_modes(problem.space, parts.geometry, matrix)
    solver = LinearSolver(matrix, GMRES_GAMG | {"pc_gamg_reuse_interpolation": bodies}, LU)
    x, b = matrix.createVecs()
    tags, counts = tags_of_cells(tagged.mesh, tagged.cell_tags), [0]
    for front in fronts:
        for tag, jump in ((LOWER, 0.0), (UPPER, 1.0)):
            cells = np.flatnonzero(tags == tag).astype(np.int32)
            problem.u.interpolate(_field(front, jump), cells)
        b.array[:] = problem.step.assemble_residual()
        if not solver.coarsened:
            parts.assemble_tangent(matrix, failing=False)
            matrix.zeroRowsColumnsLocal(held, 1.0)
            solver.coarsen()
        parts.assemble_tangent(matrix)
        matrix.zeroRowsColumnsLocal(held, 1.0)
        b.array[held] = 0.0
        x.set(0.0)
        solver.renew()
        solver.solve(b, x, TOLERANCE)
        counts.append(solver.iterations)
    solver.free()
    return Growth(bodies, matrix.getSize()[0], np.diff(counts).tolist())
