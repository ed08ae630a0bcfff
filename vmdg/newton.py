"""One load step: a predictor that carries the load, then PETSc SNES."""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
from dolfinx.common import Timer
from numpy.typing import NDArray

from .criterion import ROUGH, Criterion
from .kept_bulk import KeptBulk
from .linear_solver import (
    LinearSolver,
    Options,
    automatic_options,
    interface_zone,
    set_options,
    set_rigid_modes,
)
from .parallel import global_max, global_norm
from .path import Path
from .predictor import ELASTIC, FIRST, PATH, Predictor
from .problem import Problem


@dataclass(frozen=True)
class StepReport:
    """How the iteration of a step went.

    Attributes:
        converged: Whether the residual met the tolerance.
        norms: Residual norms on the free dofs, before every correction and at the end [N].
        reason: PETSc's word for how it ended.
    """

    converged: bool
    norms: list[float]
    reason: str

    @property
    def iterations(self) -> int:
        """Newton corrections after the predictor."""
        return max(len(self.norms) - 1, 0)


#: Relative tolerances of iterative linear solves in the iteration: loosest and tightest.
LOOSEST, TIGHTEST = 1e-2, 1e-4

#: A backtracking line search on the residual norm, which carries the iteration over the kinks
#: where points change branch.
LINE_SEARCH = {
    "snes_linesearch_type": "bt",
    "snes_linesearch_order": 1,
    "snes_linesearch_max_it": 8,
}
#: The second attempt in a jump looks for the least energy along a correction, where its work falls
#: to zero. A bond whose overstress exceeds its softening makes the energy of a step convex: this
#: leads to its minimum, while the residual norm has a minimum of its own at many a kink.
LEAST_ENERGY = {
    "snes_linesearch_type": "cp",
    "snes_linesearch_order": 1,
    "snes_linesearch_max_it": 8,
    "snes_linesearch_rtol": 0.1,
    "snes_linesearch_atol": 0.0,  # or it calls a small F.Y convergence
}
#: The line search is stuck at a kink if two corrections leave more than this share of the residual.
STALL = 0.98

#: Else the second attempt takes full steps, with a residual up to so many times the force scale.
#: Either must end where at most this share of the energy it exchanged is unaccounted for: larger
#: releases are jumps, whose dissipation is to be counted.
FULL_STEPS = {"snes_linesearch_type": "basic"}
EXCURSION, DISTANT = 5.0, 0.1

#: Displacements in sizes of the body beyond which a trial state is given up as it is. The secant of
#: a line search may lead anywhere, also to where products of numbers are no numbers any more.
ABSURD = 1e6

_REASONS = {
    value: name
    for name, value in vars(PETSc.SNES.ConvergedReason).items()
    if isinstance(value, int) and name.isupper()
}


def linear_tolerance(norms: list[float], goal: float) -> float:
    """Relative tolerance of the next linear solve, as exact as its correction can be.

    Choice 2 of Eisenstat and Walker (1996), .9 (|R_k| / |R_k-1|)^2 within bounds, and no more than
    the step still needs to end well below its goal (Kelley 1995).

    Args:
        norms: Residual norms of the step so far.
        goal: Residual norm at which the step has converged.
    """
    eta = FIRST if len(norms) < 2 else 0.9 * (norms[-1] / norms[-2]) ** 2
    needed = 0.3 * goal / norms[-1]
    return max(min(max(eta, TIGHTEST), LOOSEST), min(needed, 0.1))


def extent(problem: Problem) -> float:
    """Diagonal of the box around the mesh [mm]; collective."""
    x = problem.mesh.geometry.x
    bounds = np.stack([x, -x]).max(axis=1, initial=-np.inf)  # a rank may have no cells
    sides = [global_max(problem.comm, bound) for bound in bounds.ravel()]
    return float(np.linalg.norm(np.add(sides[:3], sides[3:])))


def rounding(problem: Problem, tangent: PETSc.Mat) -> float:
    """Rounding of the internal forces, eps |K| times the size of the body [N]; collective."""
    norm = tangent.norm(PETSc.NormType.NORM_INFINITY)
    return float(np.finfo(float).eps * extent(problem) * norm)


class Newton:
    """Newton's method on a problem, with one matrix and one solver for all steps.

    Args:
        problem: The problem.
        relative_tolerance: Of the residual, see :class:`vmdg.criterion.Criterion`.
        max_iterations: Corrections before the step is given up.
        petsc: Options of the solver, without prefix.
        scale: Largest force seen before [N].

    Attributes:
        discretization: What the matrix was made for.
    """

    def __init__(
        self,
        problem: Problem,
        relative_tolerance: float,
        max_iterations: int,
        petsc: Options | None,
        scale: float = 0.0,
    ):
        self._problem = problem
        self.discretization = problem.discretization
        self._criterion = Criterion(relative_tolerance, scale)
        self._matrix = problem.create_matrix()
        self._matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self._x, self._f = self._matrix.createVecs()
        self._owned = self._x.getLocalSize()
        self._farthest = ABSURD * extent(problem)
        prescribed = problem.prescribed
        self._prescribed = prescribed[prescribed < self._owned]
        self._norms: list[float] = []
        self._dt = 1.0
        self._path = Path(problem.comm)

        options, fallback = automatic_options(problem)
        given = {} if petsc is None else petsc
        linear = {name: value for name, value in given.items() if not name.startswith("snes_")}
        keeps = not linear and options.get("ksp_type") != "preonly" and problem.can_fail
        zone = interface_zone(problem) if keeps else None
        self.linear = LinearSolver(self._matrix, linear or options, fallback, zone)
        if self.linear.multigrid:
            set_rigid_modes(problem, self._matrix)
        search = {name: value for name, value in given.items() if name.startswith("snes_")}
        kept = self.linear.keeps and problem.can_fail and not problem.discretization.condensation
        self._bulk = KeptBulk(problem, self._matrix) if kept else None
        self._snes = self._make_snes({**LINE_SEARCH, **search}, max_iterations)
        self._full_snes = self._make_snes({**search, **FULL_STEPS}, max_iterations)
        self._energy_snes = self._make_snes({**search, **LEAST_ENERGY}, max_iterations)
        self._predictor = Predictor(problem, self._matrix, self._assemble, self._snes.getKSP())

    def _make_snes(self, options: Options, max_iterations: int) -> PETSc.SNES:
        snes = PETSc.SNES().create(self._problem.comm)
        snes.setFunction(self._function, self._f)
        snes.setJacobian(self._jacobian, self._matrix)
        ksp = snes.getKSP()
        ksp.setType(PETSc.KSP.Type.PYTHON)
        ksp.setPythonContext(self.linear)
        ksp.getPC().setType(PETSc.PC.Type.NONE)
        snes.setTolerances(max_it=max_iterations)
        snes.setConvergenceTest(self._test)
        set_options(snes, options)
        return snes

    @property
    def keeps_bulk(self) -> bool:
        """Whether the bodies' part of the tangent may be older than the interfaces'."""
        return self._bulk is not None

    @property
    def scale(self) -> float:
        """Largest force seen so far [N]."""
        return self._criterion.scale

    def step(
        self,
        dt: float,
        predictor: str = PATH,
        along: tuple[float, float] | None = None,
        once: bool = False,
        rough: bool = False,
    ) -> StepReport:
        """Solve for the loads that ``Problem.begin_step`` has set.

        Args:
            dt: Time step of the return maps [s].
            predictor: One of :data:`vmdg.predictor.PREDICTORS`.
            along: Path parameter at the start and the end of a step in a jump; None for the load
                factor.
            once: Without the second attempt, which a step in a jump always has.
            rough: The state is only on the way to an equilibrium, and need not be exact.
        """
        problem = self._problem
        self._dt = dt
        start, end = along or (problem.start_of_step[0], problem.t)
        self._path.start(start, problem.start_of_step[1])
        criterion = self._criterion
        criterion.slack = ROUGH if rough else 1.0
        scales = criterion.scale, criterion.borne
        ahead = self._path.ahead(end)
        second = None
        if along is not None:
            second = self._energy_snes
        elif problem.can_fail and not once:
            second = self._full_snes
        report = self._search(ahead, predictor, second)
        if not report.converged:
            # The forces of a state that is given up say nothing about the run.
            criterion.scale, criterion.borne = scales
        return report

    def forget_path(self) -> None:
        """The next step does not continue the path of the last ones."""
        self._path = Path(self._problem.comm)

    def _search(
        self, ahead: list[NDArray], predictor: str, second: PETSc.SNES | None
    ) -> StepReport:
        """The line search; at a kink between branches of a law it can jam where another passes."""
        problem = self._problem
        start, scale = problem.u.x.array.copy(), self._criterion.scale
        report = self._attempt(self._snes, ahead, predictor)
        if report.converged or second is None:
            return report
        problem.u.x.array[:] = start
        self._criterion.scale = scale
        problem.assemble_residual(self._dt, hold=True)
        problem.watch_energy()
        report = self._attempt(second, [], ELASTIC)
        if report.converged and problem.unaccounted_energy() > DISTANT:
            return StepReport(False, report.norms, "DISTANT_EQUILIBRIUM")
        return report

    def _attempt(self, snes: PETSc.SNES, ahead: list[NDArray], predictor: str) -> StepReport:
        self._norms = []
        with Timer("vmdg: predictor"):
            imbalance, loads = self._predictor(predictor, ahead, self._dt)
        self._criterion.see(imbalance, loads)
        self._x.array[:] = self._problem.u.x.array[: self._owned]
        snes.solve(None, self._x)
        reason = snes.getConvergedReason()
        reaction = self._reaction()
        if reason > 0 and np.isfinite(reaction):
            self._criterion.see(borne=reaction)
        return StepReport(reason > 0, self._norms, _REASONS.get(reason, str(reason)))

    def _reaction(self) -> float:
        """Norm of the reactions of the last assembly [N]."""
        forces = self._problem.forces.x.array[: self._owned][self._prescribed]
        return global_norm(self._problem.comm, forces)

    def _function(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        if x.norm(PETSc.NormType.NORM_INFINITY) > self._farthest:
            f.set(np.nan)
            return
        u = self._problem.u.x
        u.array[: self._owned] = x.array_r
        u.scatter_forward()
        f.array[:] = self._problem.assemble_residual(self._dt)
        f.array[self._prescribed] = 0

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self._assemble()
        if self._criterion.floor == 0.0:
            self._criterion.floor = rounding(self._problem, P)
        P.zeroRowsColumnsLocal(self._prescribed, 1.0)

    def _assemble(self, damage: bool = True) -> None:
        """Put the tangent at the state of the last residual into the matrix."""
        if self._bulk is None:
            self._problem.assemble_tangent(self._matrix, damage)
        else:
            self._bulk.assemble(damage)

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        residual = norms[2]
        self._norms.append(residual)
        if not np.isfinite(residual):
            return PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN
        goal = self._criterion.goal(self._reaction())
        if residual <= goal:
            return PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE
        if snes == self._full_snes:
            if residual > EXCURSION * self._criterion.scale:
                return PETSc.SNES.ConvergedReason.DIVERGED_DTOL
            if np.isclose(residual, self._norms[-5:-1], rtol=1e-3, atol=0).any():
                return PETSc.SNES.ConvergedReason.DIVERGED_LOCAL_MIN
        elif snes == self._snes and iteration >= 4 and residual > STALL * self._norms[-3]:
            return PETSc.SNES.ConvergedReason.DIVERGED_LOCAL_MIN
        snes.getKSP().setTolerances(rtol=linear_tolerance(self._norms, goal))
        return PETSc.SNES.ConvergedReason.ITERATING

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.linear.free()
        self._predictor.destroy()
        if self._bulk is not None:
            self._bulk.destroy()
        for snes in (self._snes, self._full_snes, self._energy_snes):
            snes.destroy()
        for item in (self._matrix, self._x, self._f):
            item.destroy()
