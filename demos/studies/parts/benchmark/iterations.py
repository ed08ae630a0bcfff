"""A Newton iteration of vmdg against one of plain finite elements on the same mesh, part by part.

One iteration is residual, tangent with its boundary conditions, and a linear solve with the same
solver, multigrid with new coarse matrices on an interpolation that is kept; once with a tie, once
with every point of the interface at work: the left half opens and is damaged, the right half is
pressed, slides and rubs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

import numpy as np
from parts.benchmark.common import BOTTOM, LOWER, TOP, UPPER, layers, least_times
from parts.benchmark.continuous import Plain
from parts.topology import tags_of_cells

import vmdg
from vmdg.linear.ksp import (
    CG_GAMG,
    LDLT,
    LU,
    LinearSolver,
    Petsc,
    automatic_options,
    make_ksp,
    set_rigid_modes,
)
from vmdg.meshes import TaggedMesh

STEPS = ("residual", "tangent", "boundary", "solve")
HEAD = ("Newton iteration", "unknowns", *(f"{step} [ms]" for step in STEPS))
HEAD += ("iterations or Gflop", "all [ms]", "ratio")
#: Of iterative linear solves.
TOLERANCE = 1e-6
BODY = vmdg.NeoHookean(E=1000.0, nu=0.3)  # MPa

#: Cells, the layer below the interface; softening that the body can follow,
#: or the tangent would be indefinite; largest opening, and slip [mm]; strain that presses.
MESHES = {"2D": ("quadrilateral", (96, 96), 48), "3D": ("hexahedron", (22, 22, 25), 12)}
BOND = vmdg.Debonding(strength=10.0, critical_gap=1.0, friction=0.3)
OPENING, PRESSED = 0.05, 0.03
AT_WORK = (vmdg.Mode.TENSION, vmdg.Mode.SHEAR, vmdg.Mode.FRICTION)


@dataclass(frozen=True)
class Cost:
    """Processor times of the parts of an iteration [s], of the slowest rank."""

    name: str
    times: Mapping[str, Mapping[str, float]]  # by variant and part; the second over the first
    sizes: tuple[int, int]  # unknowns
    efforts: tuple[float, float]  # Krylov iterations of the solves, or operations [1e9]
    more: dict[str, Any]  # further columns

    def total(self, variant: str) -> float:
        """Of an iteration [s]."""
        return sum(self.times[variant].values())

    def row(self) -> list[str]:
        """Of the table below ``HEAD``, and further columns."""

        def both(one: float, other: float) -> str:
            return f"{one:.4g} / {other:.4g}"

        names = list(self.times)[:2]
        one, other = (self.times[name] for name in names)
        totals = [self.total(name) for name in names]
        return [
            self.name,
            both(*self.sizes),
            *(both(1e3 * one[step], 1e3 * other[step]) for step in STEPS),
            both(*self.efforts),
            both(*(1e3 * total for total in totals)),
            f"{totals[1] / totals[0]:.3f}",
            *("" if np.isnan(value) else f"{value:.4g}" for value in self.more.values()),
        ]


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
    """The same by the solver of vmdg, its interpolation from the first values of the matrix."""

    def __init__(self, matrix: PETSc.Mat, options: Petsc, b: np.ndarray):
        self._solver = LinearSolver(matrix, options, LU)
        self._solver.coarsen()
        self._x, self._b = matrix.createVecs()
        self._b.array[:] = b
        self.effort = 0  # iterations of the last solve

    def __call__(self) -> None:
        before = self._solver.iterations
        self._x.set(0.0)
        self._solver.renew()
        self._solver.solve(self._b, self._x, TOLERANCE)
        self.effort = self._solver.iterations - before


def iteration(problem: vmdg.Problem, direct: bool) -> dict[str, Callable]:
    parts, held = problem.discretization, problem.loading.prescribed
    matrix = parts.create_matrix(PETSc.Mat.Type.AIJ if direct else PETSc.Mat.Type.BAIJ)
    matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
    right = problem.step.assemble_residual().copy()
    right[problem.loading.owned_prescribed] = 0
    # Friction makes the tangent of the bodies, of which multigrid is made, no less symmetric.
    parts.assemble_tangent(matrix, failing=direct)
    matrix.zeroRowsColumnsLocal(held, 1.0)
    if direct:
        solver = Direct(matrix, LDLT if parts.symmetric else LU, right)
    else:
        set_rigid_modes(problem.space, parts.geometry, matrix)
        solver = Multigrid(matrix, automatic_options(problem, 0, 0)[0], right)
    actions = (
        problem.step.assemble_residual,
        lambda: parts.assemble_tangent(matrix),
        lambda: matrix.zeroRowsColumnsLocal(held, 1.0),
        solver,
    )
    return dict(zip(STEPS, actions, strict=True))


def unknowns(problem: vmdg.Problem) -> int:
    return problem.space.dofmap.index_map.size_global * problem.space.dofmap.index_map_bs


def block(dimension: str, damage: bool, refine: float = 1.0) -> vmdg.Problem:
    """Both bodies, their ends held, tied or displaced so that all points are at work."""
    return _at_work(_mesh(dimension, refine), damage)


def _mesh(dimension: str, refine: float) -> TaggedMesh:
    cell, (*along, last), below = MESHES[dimension]
    below, last = max(round(refine * below), 1), max(round(refine * last), 2)
    divisions = [*(max(round(refine * n), 2) for n in along), last]
    return layers(cell, divisions, np.ones(len(divisions)), below)


def _ends(tagged: TaggedMesh) -> np.ndarray:
    return np.concatenate([tagged.facet_tags.find(tag) for tag in (BOTTOM, TOP)])


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


def _at_work(tagged: TaggedMesh, damage: bool) -> vmdg.Problem:
    interface = vmdg.Interface(between=(LOWER, UPPER), law=BOND if damage else vmdg.Bonded())
    bodies = {LOWER: BODY, UPPER: BODY}
    problem = vmdg.Problem(tagged.mesh, tagged.cell_tags, bodies, [interface])
    tags, d = tags_of_cells(tagged.mesh, tagged.cell_tags), tagged.mesh.geometry.dim
    for tag, jump in ((LOWER, 0.0), (UPPER, float(damage))):
        problem.u.interpolate(_field(d, jump), np.flatnonzero(tags == tag).astype(np.int32))
    problem.dirichlet(_ends(tagged), 0.0)
    return problem


def with_plain(
    dimension: str, damage: bool, direct: bool, repeats: int, refine: float = 1.0
) -> Cost:
    """vmdg over plain finite elements.

    With multigrid "rebuilt" is plain finite elements whose interpolation is made in every
    iteration, as PETSc does by itself.
    """
    tagged = _mesh(dimension, refine)
    plain, problem = Plain(tagged, {LOWER: BODY, UPPER: BODY}), _at_work(tagged, damage)
    plain.u.interpolate(_field(tagged.mesh.geometry.dim, 0.0))
    plain.prescribe(_ends(tagged))
    plain.assemble_tangent()
    forces = plain.assemble_residual()
    if not direct:
        set_rigid_modes(plain.space, problem.discretization.geometry, plain.matrix)
        plain.hold()
    make = Direct if direct else Multigrid
    solver = make(plain.matrix, LDLT if direct else CG_GAMG, forces)
    actions = plain.assemble_residual, plain.assemble_tangent, plain.hold, solver
    steps = {"plain": dict(zip(STEPS, actions, strict=True)), "vmdg": iteration(problem, direct)}
    if not direct:
        rebuilt = CG_GAMG | {"pc_gamg_reuse_interpolation": False}
        steps["rebuilt"] = steps["plain"] | {"solve": Multigrid(plain.matrix, rebuilt, forces)}
    times = least_times(steps, repeats)

    def stabilize() -> None:
        problem.u.x.array[:] *= 1 + 1e-15  # a displacement that no other tau_s was found at
        problem.discretization.update_stabilization()

    step = least_times({"vmdg": {"step": stabilize}}, repeats)["vmdg"]["step"]
    active = 0.0
    if damage:
        problem.discretization.active[0].commit()
        modes, comm = problem.discretization.active[0].history.mode, tagged.mesh.comm
        active = comm.allreduce(np.isin(modes, AT_WORK).sum()) / comm.allreduce(modes.size)
    totals = {name: sum(parts.values()) for name, parts in times.items()}
    more = {"to rebuilt": totals["vmdg"] / totals.get("rebuilt", np.nan), "active": active}
    state = "damage and friction" if damage else "tied"
    return Cost(
        f"{dimension}, {state}, {'direct' if direct else 'multigrid'}",
        times,
        (plain.size, unknowns(problem)),
        tuple(steps[name]["solve"].effort for name in ("plain", "vmdg")),
        more | {"a step more [ms]": 1e3 * step},
    )
