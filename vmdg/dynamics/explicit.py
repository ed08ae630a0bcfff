"""Explicit steps in time, with lumped masses."""

from __future__ import annotations

import math
from collections.abc import Iterator

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_any, global_max, raise_together
from ..domain.topology import box_sides
from ..linear.ksp import destroy, set_options
from ..problem.motion import moving
from ..problem.problem import Problem
from ..solver.attempt import Attempt
from .schemes import CentralDifferences
from .supports import SupportMotion

Array = NDArray[np.float64]

#: Iterations of Lanczos's method, and waves of its first vector along the body.
ITERATIONS, FAST = 60, 1e4


class ExplicitSteps:
    """Steps of central differences, see :class:`.CentralDifferences`.

    Args:
        problem: The problem.
        scheme: The parameters.
        supports: Motion of supports.

    Raises:
        ValueError: lumped masses are not positive.
    """

    krylov = 0

    def __init__(self, problem: Problem, scheme: CentralDifferences, supports: SupportMotion):
        self._problem, self._scheme, self._supports = problem, scheme, supports
        self._motion, self._comm = moving(problem.step.motion), problem.comm
        self._owned = problem.discretization.owned
        self._masses = masses = self._motion.lumped.copy()
        masses[problem.loading.owned_prescribed] = 1.0
        least = 1e-12 * global_max(self._comm, float(masses.max(initial=0.0)))
        message = (
            "CentralDifferences: the lumped mass of a node is not positive, as at the corners of "
            "triangles and tetrahedra of degree 2: use degree=1, quadrilaterals or hexahedra, or "
            "GeneralizedAlpha"
        )
        raise_together(self._comm, message if (masses <= least).any() else None)
        self._count, self._critical = 0, math.inf

    def accelerate(self) -> None:
        """Acceleration of a body that is let go in its current state: M.a = -R; collective."""
        self._problem.step.assemble_residual(hold=True)
        self._motion.acceleration = self._acceleration(0.0)

    def advance(self, t: float) -> Iterator[Attempt]:
        """Steps to a time, as one attempt; collective."""
        problem, renewal = self._problem, self._scheme.renewal
        while problem.t < t:
            if self._count % renewal == 0:
                self._critical = self.critical_step()
            steps = math.ceil((t - problem.t) / (self._scheme.safety * self._critical))
            steps, start, whole = max(steps, 1), problem.t, t - problem.t
            some = min(steps, renewal - self._count % renewal)
            for number in range(1, some + 1):
                here = t if number == steps else start + number / steps * whole
                self._step(here)
                if not self._finite():
                    yield Attempt(False, reason="DIVERGED_FNORM_NAN")
                    return
        yield Attempt(True, [0.0])

    def critical_step(self) -> float:
        """2/omega of the bonded interfaces, by Lanczos's method; collective [s].

        Conjugate gradients for K.x = b with the masses as preconditioner find the largest
        eigenvalue of M^-1.K on their way.
        """
        problem, held = self._problem, self._problem.loading.owned_prescribed
        problem.step.assemble_residual(hold=True)
        matrix = problem.discretization.create_matrix()
        problem.discretization.assemble_tangent(matrix, damage=False)
        matrix.zeroRowsColumnsLocal(held, 0.0)
        x, b = matrix.createVecs()
        # The highest modes alternate from node to node, as does a function of their positions that
        # varies much faster, whichever rank numbers them.
        places, d = problem.space.tabulate_dof_coordinates(), problem.mesh.geometry.dim
        size = float(np.linalg.norm(box_sides(problem.mesh)))
        waves = np.sin(FAST * places[:, :d] / size + np.arange(1, 4)[:d])
        x.array[:] = waves.ravel()[: self._owned]
        matrix.mult(x, b)
        ksp = PETSc.KSP().create(self._comm)
        set_options(ksp, {"ksp_type": "cg", "ksp_rtol": 1e-12, "ksp_max_it": ITERATIONS})
        ksp.setOperators(matrix)
        ksp.getPC().setType(PETSc.PC.Type.PYTHON)
        ksp.getPC().setPythonContext(self)
        ksp.setComputeSingularValues(True)
        ksp.solve(b, x)
        largest = ksp.computeExtremeSingularValues()[0]
        destroy(ksp)
        for item in (matrix, x, b):
            item.destroy()
        return 2 / math.sqrt(largest) if largest > 0 else math.inf

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """M^-1.x, called by PETSc."""
        y.array[:] = x.array_r / self._masses

    def _step(self, t: float) -> None:
        problem, motion, owned = self._problem, self._motion, self._owned
        step, u, h = problem.step, problem.u.x, t - problem.t
        v0, a0 = motion.velocity.x.array[:owned].copy(), motion.acceleration
        step.begin(t, h, renews=self._count % self._scheme.renewal == 0)
        moves = self._supports.at(t, h)
        u.array[:owned] += h * v0 + h**2 / 2 * a0
        u.scatter_forward()
        u.array[problem.loading.prescribed] = problem.loading.prescribed_values(t)
        step.assemble_residual(h)
        a1 = self._acceleration(moves[1])
        v1 = v0 + h / 2 * (a0 + a1)
        v1[problem.loading.owned_prescribed] = moves[0]
        step.commit((motion.lumped * a0, motion.lumped * a1))
        motion.move(v1, a1)
        self._count += 1

    def _acceleration(self, of_supports: Array | float) -> Array:
        """-R/m, of supports as given."""
        a = -self._problem.discretization.forces.x.array[: self._owned] / self._masses
        a[self._problem.loading.owned_prescribed] = of_supports
        return a

    def _finite(self) -> bool:
        """Whether the displacement is finite; collective."""
        bad = not np.isfinite(self._problem.u.x.array).all()
        return not global_any(self._comm, bad)

    def free(self) -> None:
        """Nothing to free."""
