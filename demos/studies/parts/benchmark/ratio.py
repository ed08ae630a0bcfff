"""A Newton iteration of vmdg against one of plain finite elements on the same mesh.

One iteration is residual, tangent with its boundary conditions, and a linear solve with the same
solver, multigrid with new coarse matrices on an interpolation that is kept. Once the interface is
tied, once every point of it is at work: the left half opens and is damaged, the right half is
pressed, slides and rubs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

import vmdg
from parts.benchmark.common import BOTTOM, LOWER, TOP, UPPER, layers, least_times
from parts.benchmark.continuous import Plain
from vmdg.domain.topology import tags_of_cells
from vmdg.linear.ksp import (
    CG_GAMG,
    GMRES_GAMG,
    LDLT,
    LU,
    LinearSolver,
    Petsc,
    make_ksp,
    set_rigid_modes,
)
from vmdg.meshes import TaggedMesh

#: Cells, and the layer below the interface.
MESHES = {"2D": ("quadrilateral", (96, 96), 48), "3D": ("hexahedron", (22, 22, 25), 12)}
#: Softening that the body can follow, or the tangent would be indefinite.
STRENGTH, CRITICAL_GAP, FRICTION = 10.0, 1.0, 0.3  # MPa, mm, -
#: Largest opening, and slip, of the interface at work [mm]; strain that presses the bodies.
OPENING, PRESSED = 0.05, 0.03
BODY = vmdg.NeoHookean(E=1000.0, nu=0.3)  # MPa
MATERIALS = {LOWER: BODY, UPPER: BODY}
AT_WORK = (vmdg.Mode.TENSION, vmdg.Mode.SHEAR, vmdg.Mode.FRICTION)
#: Of iterative linear solves.
TOLERANCE = 1e-6
STEPS = ("residual", "tangent", "boundary", "solve")


@dataclass(frozen=True)
class Ratio:
    """Processor times of the parts of an iteration [s] and the counts that explain them."""

    name: str  # Dimension, state of the interface and solver
    # Of "plain" and "vmdg", by part, on the slowest rank; with multigrid also of "rebuilt", plain
    # finite elements whose interpolation is rebuilt in every iteration, as PETSc does by itself
    times: dict[str, dict[str, float]]
    sizes: tuple[int, int]  # Numbers of unknowns
    entries: tuple[int, int]  # Nonzero entries of the matrices
    # Krylov iterations of the linear solves, or operations of direct ones [1e9]
    efforts: tuple[float, float]
    active: float  # Share of the interface's points that are damaged or slide
    step: float  # Processor time for the stabilization of one load step of vmdg [s]

    @property
    def totals(self) -> tuple[float, float]:
        """Of an iteration [s]."""
        return tuple(sum(self.times[name].values()) for name in ("plain", "vmdg"))

    @property
    def ratio(self) -> float:
        """vmdg to plain."""
        plain, ours = self.totals
        return ours / plain

    @property
    def to_rebuilt(self) -> float:
        """vmdg to plain with an interpolation of every iteration; nan where there is none."""
        rebuilt = self.times.get("rebuilt")
        return self.totals[1] / sum(rebuilt.values()) if rebuilt else np.nan


def _field(d: int, jump: float) -> Callable[[np.ndarray], np.ndarray]:
    """Displacement at points [mm]; a ``jump`` of 1 slides the interface and opens half of it.

    The strain of the bodies is that of the continuous body, but for the way to the opening, so that
    both have much the same to solve.
    """

    def u(x: np.ndarray) -> np.ndarray:
        values = np.zeros((d, x.shape[1]))
        values[0] = 0.01 * x[0] + jump * OPENING
        values[-1] = (0.003 * x[0] - PRESSED) * x[-1]
        values[-1] += jump * OPENING * np.maximum(1 - 2 * x[0], 0.0)
        return values

    return u


def measure(dimension: str, damage: bool, direct: bool, repeats: int, refine: float = 1.0) -> Ratio:
    """One row of the table.

    Args:
        damage: Whether all points of the interface are at work; else it is tied.
        direct: MUMPS instead of a Krylov solver with GAMG.
        repeats: The least of so many iterations.
    """
    tagged = _mesh(dimension, refine)
    comm = tagged.mesh.comm
    plain = Plain(tagged, MATERIALS)
    plain.u.interpolate(_field(tagged.mesh.geometry.dim, 0.0))
    plain.prescribe(_ends(tagged))
    problem = _problem(tagged, damage)
    kind = PETSc.Mat.Type.AIJ if direct else PETSc.Mat.Type.BAIJ
    matrix = problem.discretization.create_matrix(kind)
    matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
    plain.assemble_residual()
    plain.assemble_tangent()
    residual = problem.step.assemble_residual().copy()
    problem.discretization.assemble_tangent(matrix)
    residual[problem.loading.owned_prescribed] = 0
    solvers: list[Direct | Multigrid]
    if direct:
        options = LDLT if problem.discretization.symmetric else LU
        solvers = [
            Direct(A, options, b)
            for A, b in ((plain.matrix, plain.assemble_residual()), (matrix, residual))
        ]
    else:
        geometry = problem.discretization.geometry
        set_rigid_modes(plain.space, geometry, plain.matrix)
        set_rigid_modes(problem.space, geometry, matrix)
        # Friction makes the tangent of the bodies no less symmetric.
        plain.hold()
        problem.discretization.assemble_tangent(matrix, failing=False)
        matrix.zeroRowsColumnsLocal(problem.loading.prescribed, 1.0)
        options = CG_GAMG if problem.discretization.symmetric else GMRES_GAMG
        forces = plain.assemble_residual()
        solvers = [
            Multigrid(plain.matrix, CG_GAMG, forces),
            Multigrid(matrix, options, residual),
            Multigrid(plain.matrix, CG_GAMG | {"pc_gamg_reuse_interpolation": False}, forces),
        ]
    steps = {
        "plain": (
            plain.assemble_residual,
            plain.assemble_tangent,
            plain.hold,
            solvers[0],
        ),
        "vmdg": (
            problem.step.assemble_residual,
            lambda: problem.discretization.assemble_tangent(matrix),
            lambda: matrix.zeroRowsColumnsLocal(problem.loading.prescribed, 1.0),
            solvers[1],
        ),
    }
    if not direct:
        steps["rebuilt"] = (*steps["plain"][:-1], solvers[2])
    named = {name: dict(zip(STEPS, actions, strict=True)) for name, actions in steps.items()}
    times = least_times(named, repeats)
    once = {"vmdg": {"step": lambda: stabilize(problem)}}
    active = 0.0
    if damage:
        problem.discretization.active[0].commit()
        working = np.isin(problem.discretization.active[0].history.mode, AT_WORK)
        active = comm.allreduce(working.sum()) / comm.allreduce(working.size)
    return Ratio(
        f"{dimension}, {'damage and friction' if damage else 'tied'}, "
        f"{'direct' if direct else 'multigrid'}",
        times,
        (plain.size, matrix.getSize()[0]),
        tuple(int(A.getInfo()["nz_used"]) for A in (plain.matrix, matrix)),
        tuple(solver.effort for solver in solvers[:2]),
        active,
        least_times(once, repeats)["vmdg"]["step"],
    )


def block(dimension: str, damage: bool, refine: float = 1.0, across: float = 1.0) -> vmdg.Problem:
    """Both bodies, their ends held, with the displacement of which :func:`measure` tells.

    Args:
        across: Multiplies the number of cells across the interface.
    """
    return _problem(_mesh(dimension, refine, across), damage)


def stabilize(problem: vmdg.Problem) -> None:
    """Find tau_s at a displacement that no other was found at: as much away as rounding."""
    problem.u.x.array[:] *= 1 + 1e-15
    problem.discretization.update_stabilization()


def _mesh(dimension: str, refine: float, across: float = 1.0) -> TaggedMesh:
    cell, (*along, last), below = MESHES[dimension]
    below, last = (max(round(refine * across * n), least) for n, least in ((below, 1), (last, 2)))
    divisions = [*(max(round(refine * n), 2) for n in along), last]
    return layers(cell, divisions, np.ones(len(divisions)), below)


def _ends(tagged: TaggedMesh) -> NDArray[np.int32]:
    return np.concatenate([tagged.facet_tags.find(tag) for tag in (BOTTOM, TOP)])


def _problem(tagged: TaggedMesh, damage: bool) -> vmdg.Problem:
    """Tied, or displaced so that all points of the interface are at work."""
    law = vmdg.Debonding(STRENGTH, CRITICAL_GAP, friction=FRICTION) if damage else vmdg.Bonded()
    interface = vmdg.Interface(between=(LOWER, UPPER), law=law)
    problem = vmdg.Problem(tagged.mesh, tagged.cell_tags, MATERIALS, [interface])
    tags, d = tags_of_cells(tagged.mesh, tagged.cell_tags), tagged.mesh.geometry.dim
    for tag, jump in ((LOWER, 0.0), (UPPER, float(damage))):
        problem.u.interpolate(_field(d, jump), np.flatnonzero(tags == tag).astype(np.int32))
    problem.dirichlet(_ends(tagged), 0.0)
    return problem


class Direct:
    """Solves with the present values of a matrix, from scratch."""

    def __init__(self, matrix: PETSc.Mat, options: Petsc, b: np.ndarray):
        self._ksp, self._matrix = make_ksp(matrix, options), matrix
        self._x, self._b = matrix.createVecs()
        self._b.array[:] = b

    def __call__(self) -> None:
        self._ksp.setOperators(self._matrix)
        self._ksp.solve(self._b, self._x)

    @property
    def effort(self) -> float:
        """Operations of the last elimination [1e9]."""
        return 1e-9 * self._ksp.getPC().getFactorMatrix().getMumpsRinfog(3)


class Multigrid:
    """The same by the solver of vmdg, its interpolation from the first values of the matrix.

    Attributes:
        effort: Iterations of the last solve.
    """

    def __init__(self, matrix: PETSc.Mat, options: Petsc, b: np.ndarray):
        self._solver = LinearSolver(matrix, options, LU)
        self._solver.coarsen()
        self._x, self._b = matrix.createVecs()
        self._b.array[:] = b
        self.effort = 0

    def __call__(self) -> None:
        before = self._solver.iterations
        self._x.set(0.0)
        self._solver.renew()
        self._solver.solve(self._b, self._x, TOLERANCE)
        self.effort = self._solver.iterations - before


HEAD = (
    "Newton iteration",
    "unknowns",
    "entries",
    *(f"{step} [ms]" for step in STEPS),
    "iterations or Gflop",
    "all [ms]",
    "ratio",
    "to rebuilt",
    "active",
    "a step more [ms]",
)


def row(ratio: Ratio) -> list[str | float]:
    """Of the table below ``HEAD``; numbers of plain finite elements first."""

    def both(plain: float, ours: float) -> str:
        return f"{plain:.4g} / {ours:.4g}"

    plain, ours = ratio.times["plain"], ratio.times["vmdg"]
    return [
        ratio.name,
        both(*ratio.sizes),
        both(*ratio.entries),
        *(both(1e3 * plain[step], 1e3 * ours[step]) for step in STEPS),
        both(*ratio.efforts),
        both(*(1e3 * total for total in ratio.totals)),
        f"{ratio.ratio:.3f}",
        f"{ratio.to_rebuilt:.3f}",
        f"{100 * ratio.active:.0f} %",
        1e3 * ratio.step,
    ]
