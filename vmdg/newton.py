"""One load step: a predictor that carries the load, then PETSc SNES."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
from dolfinx.common import Timer

from .parallel import global_max, global_sum
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


#: A predictor that leaves more than this share of the imbalance is compared with one that holds
#: zeta.
POOR = 1e-2

_REASONS = {
    value: name
    for name, value in vars(PETSc.SNES.ConvergedReason).items()
    if isinstance(value, int) and name.isupper()
}


class Newton:
    """Newton's method on a problem, with one matrix and one solver for all steps.

    The residual is small when its norm on the free dofs is below ``relative_tolerance`` times the
    largest force the run has seen (reactions, loads, or the imbalance a step starts with). Such a
    scale stays when the body has come apart and no force is left.

    Args:
        problem: The problem.
        relative_tolerance: Relative to the force scale.
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
        petsc: Mapping[str, str | int | float | None],
        scale: float = 0.0,
    ):
        self._problem = problem
        self.discretization = problem.discretization
        self._tolerance = relative_tolerance
        self._scale = scale
        self._matrix = problem.create_matrix()
        self._matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self._x, self._f = self._matrix.createVecs()
        self._owned = self._x.getLocalSize()
        prescribed = problem.prescribed
        self._prescribed = prescribed[prescribed < self._owned]
        self._floor = 0.0
        self._norms: list[float] = []
        self._dt = 1.0
        self._fresh = False

        prefix = "vmdg_"
        options = PETSc.Options()
        for name, value in petsc.items():
            options[prefix + name] = value
        self.snes = PETSc.SNES().create(problem.comm)
        self.snes.setOptionsPrefix(prefix)
        self.snes.setFunction(self._function, self._f)
        self.snes.setJacobian(self._jacobian, self._matrix)
        self.snes.setTolerances(max_it=max_iterations)
        self.snes.setConvergenceTest(self._test)
        self.snes.setFromOptions()
        for name in petsc:
            options.delValue(prefix + name)

    @property
    def scale(self) -> float:
        """Largest force seen so far [N]."""
        return self._scale

    def step(self, dt: float, damage_predictor: bool = True) -> StepReport:
        """Solve for the loads that ``Problem.begin_step`` has set.

        Args:
            dt: Time step of the return maps [s].
            damage_predictor: Predict with the damage tangent of the last converged step.
        """
        self._dt = dt
        self._norms = []
        with Timer("vmdg: predictor"):
            self._predict_best(damage_predictor and self._problem.can_fail)
        self._x.array[:] = self._problem.u.x.array[: self._owned]
        self.snes.solve(None, self._x)
        reason = self.snes.getConvergedReason()
        return StepReport(reason > 0, self._norms, _REASONS.get(reason, str(reason)))

    def _predict_best(self, damage: bool) -> None:
        """Predict; where the damage tangent of before leads astray, compare with zeta held."""
        u = self._problem.u.x.array
        start = u.copy()
        imbalance = self._predict(damage)
        if not damage:
            return
        left = self._imbalance()
        # A comparison that also catches NaN.
        if not left <= POOR * imbalance:
            best = u.copy()
            u[:] = start
            self._predict(damage=False)
            if left < self._imbalance():
                u[:] = best

    def _imbalance(self) -> float:
        """Norm of the residual on the free dofs at the current displacement [N]."""
        residual = self._problem.assemble_residual(self._dt).copy()
        residual[self._prescribed] = 0
        return float(np.sqrt(global_sum(self._problem.comm, residual @ residual)))

    def _predict(self, damage: bool) -> float:
        """u += du with K du = -R, du prescribed where the displacement is.

        Returns:
            Norm of the right-hand side on the free dofs [N].
        """
        problem, matrix = self._problem, self._matrix
        residual = problem.assemble_residual(self._dt, hold=True)
        problem.assemble_tangent(matrix, damage)
        if self._floor == 0.0:
            # Rounding of the internal forces: eps |A| times the size of the body.
            x = problem.mesh.geometry.x
            bounds = np.stack([x, -x]).max(axis=1, initial=-np.inf)  # a rank may have no cells
            extent = [global_max(problem.comm, bound) for bound in bounds.ravel()]
            size = np.linalg.norm(np.add(extent[:3], extent[3:]))
            eps = np.finfo(float).eps
            self._floor = eps * size * matrix.norm(PETSc.NormType.NORM_INFINITY)
        increment = np.zeros(self._owned)
        target = problem.prescribed_values(problem.t)[problem.prescribed < self._owned]
        increment[self._prescribed] = target - problem.u.x.array[: self._owned][self._prescribed]
        self._x.array[:] = increment
        matrix.mult(self._x, self._f)
        self._f.array[:] = -residual - self._f.array_r
        self._f.array[self._prescribed] = 0
        imbalance = self._f.norm()
        self._see_forces(imbalance)
        self._f.array[self._prescribed] = increment[self._prescribed]
        matrix.zeroRowsColumnsLocal(self._prescribed, 1.0)
        ksp = self.snes.getKSP()
        ksp.setOperators(matrix)
        ksp.solve(self._f, self._x)
        problem.u.x.array[: self._owned] += self._x.array_r
        problem.u.x.array[: self._owned][self._prescribed] = target
        problem.u.x.scatter_forward()
        return imbalance

    def _see_forces(self, imbalance: float = 0.0) -> None:
        forces = self._problem.forces.x.array[: self._owned][self._prescribed]
        reaction = float(np.sqrt(global_sum(self._problem.comm, forces @ forces)))
        if np.isfinite(reaction):
            self._scale = max(self._scale, reaction, imbalance)

    def _function(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        u = self._problem.u.x
        u.array[: self._owned] = x.array_r
        u.scatter_forward()
        f.array[:] = self._problem.assemble_residual(self._dt)
        f.array[self._prescribed] = 0

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self._problem.assemble_tangent(P)
        P.zeroRowsColumnsLocal(self._prescribed, 1.0)

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        residual = norms[2]
        self._norms.append(residual)
        if not np.isfinite(residual):
            return PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN
        self._see_forces()
        if residual <= max(self._tolerance * self._scale, self._floor):
            return PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE
        return PETSc.SNES.ConvergedReason.ITERATING

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for item in (self.snes, self._matrix, self._x, self._f):
            item.destroy()
