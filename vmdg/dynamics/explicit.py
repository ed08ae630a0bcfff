"""Explicit steps in time, with lumped masses."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_any, global_max, global_sum, raise_together
from ..domain.topology import box_sides
from ..interface.active import take_in
from ..interface.stabilization import SoftensTooFast
from ..linear.ksp import destroy, set_options
from ..problem.ledger import WorkInMotion
from ..problem.motion import Plan, moving
from ..problem.problem import Problem
from ..problem.step import cause
from ..solver.attempt import Attempt
from ..solver.limits import ROUNDING
from ..solver.options import SolveOptions
from .balance import Balance
from .contact_nodes import ContactNodes
from .schemes import CentralDifferences
from .supports import SupportMotion
from .viscous_nodes import ViscousNodes

Array = NDArray[np.float64]

#: Iterations of Lanczos's method, and waves of its first vector along the body.
ITERATIONS, FAST = 25, 1e4

#: Reason of a run that ends.
_VANISHES = "STEP_VANISHES"


class ExplicitSteps:
    """Steps of central differences, see :class:`.CentralDifferences`.

    Attributes:
        balance: Of the energies; None before the first step.
        taken: Number of steps so far.

    Raises:
        ValueError: lumped masses are not positive, or a mean is not prescribed.
    """

    krylov = 0
    cure = "take shorter steps, by a smaller safety="

    def __init__(
        self,
        problem: Problem,
        scheme: CentralDifferences,
        options: SolveOptions,
        supports: SupportMotion,
        continues: bool,
    ):
        self._problem, self._scheme, self._supports = problem, scheme, supports
        self._motion, self._comm = moving(problem.step.motion), problem.comm
        self._owned = problem.discretization.owned
        self._size = float(np.linalg.norm(box_sides(problem.mesh)))
        sums, held = self._motion.row_sums, problem.loading.owned_prescribed
        means = problem.discretization.means
        free = means is not None and len(np.setdiff1d(means.owned_rows, held)) > 0
        if global_any(self._comm, free):
            raise ValueError(
                "CentralDifferences: a mean that follows from a given stress has no mass: "
                "prescribe all components of strain=, gradient= or F_33, or use GeneralizedAlpha"
            )
        largest = global_max(self._comm, float(sums.max(initial=0.0)))
        # Those of the critical step, which is longer where nodes are massless.
        self._masses, self._largest = (masses := sums.copy()), largest
        masses[held] = largest
        message = (
            "CentralDifferences: the lumped mass of a node is not positive, as at the corners of "
            "triangles and tetrahedra of degree 2: use degree=1, quadrilaterals or hexahedra, or "
            "GeneralizedAlpha"
        )
        raise_together(self._comm, message if (masses <= 1e-12 * largest).any() else None)
        self._contact = ContactNodes(problem, sums)
        self._massless = np.setdiff1d(self._contact.dofs, held)
        self._motion.lumped = masses = self._contact.masses
        self._inverse = np.divide(1.0, masses, out=np.zeros_like(masses), where=masses > 0)
        self._viscous = ViscousNodes(problem, masses)
        self._drag: Array | None = None  # at the start of a step
        start = (continues and self._motion.plan) or Plan(0, math.inf, 0.0, 0)
        self._count, self._critical, self._longest, self._cuts = start
        self._most_cuts, self._h, self.taken = options.max_cuts, 0.0, 0
        # Energies, and a.M.a, of the last state that was looked at.
        self.balance: Balance | None = None
        self._accelerations = 0.0
        parts = problem.discretization
        # The tangent of bonded interfaces at small strain.
        self._constant = parts.bodies.small and parts.stabilizers.constant

    def accelerate(self) -> None:
        """Acceleration of a body that is let go in its current state: M.a = -R; collective."""
        self._problem.step.assemble_residual(hold=True)
        v = self._motion.velocity.x.array[: self._owned].copy()
        rate = np.zeros_like(v)
        self._motion.acceleration = self._acceleration(v, 0.0, rate, 0.0)

    def advance(self, t: float) -> Iterator[Attempt]:
        """Steps to a time; an attempt that fails returns to the last state that was looked at, and
        the next one has steps half as long, with a new critical step; collective."""
        problem = self._problem
        good, taken = problem.step.snapshot(), self.taken
        if self.balance is None:
            self.balance, self._accelerations = Balance(problem), self._squares()
        while problem.t < t:
            if reason := self._some_steps(t) or self._wrong():
                problem.step.return_to(good)
                self.taken = taken
                self._drag, self._cuts, self._critical = None, self._cuts + 1, math.inf
                yield Attempt(False, reason=reason)
                if reason == _VANISHES:
                    return
                continue
            if self._cuts:
                self._cuts, self._critical = self._cuts - 1, math.inf
            if problem.t < t:
                good, taken = problem.step.snapshot(), self.taken
        yield Attempt(True, [0.0])

    def _some_steps(self, t: float) -> str:
        """Steps towards a time until the next renewal, and why one has failed; collective."""
        problem, scheme = self._problem, self._scheme
        done = self._count % scheme.renewal
        if self._critical == math.inf or (done == 0 and not self._constant):
            try:
                problem.step.renew()
            except SoftensTooFast as error:
                return str(error)
            self._critical = self._viscous.stable(self.critical_step())
            self._count = done = 0
            self._longest = max(self._longest, self._critical)
        # So that the number of steps is bounded.
        longest = self._critical / 2**self._cuts
        if not 0 < self._longest / 2**self._most_cuts <= longest:
            return _VANISHES
        start, span = problem.t, t - problem.t
        steps = max(math.ceil((1 - ROUNDING) * span / (scheme.safety * longest)), 1)
        some = min(steps, scheme.renewal - done)
        times = start + np.arange(some + 2) / steps * span
        if some == steps:
            times[some] = t
        for before, here, after in zip(times, times[1:], times[2:], strict=False):
            if not self._step(float(before), float(here), float(after)):
                return "DIVERGED_MAX_IT"
        return ""

    def _wrong(self) -> str:
        """Why the current state cannot be, empty if it can; collective.

        In steps of central differences E = kinetic + stored of linear bodies is not constant, but
        E - h^2 a.M.a/8 is.
        """
        problem = self._problem
        if global_any(self._comm, not np.isfinite(problem.u.x.array).all()):
            return cause(problem.discretization, "DIVERGED_FNORM_NAN")
        if reason := problem.step.invalid():
            return reason
        before, self._accelerations = self._accelerations, self._squares()
        stiffness = 4 * self._largest / (self._longest * self._longest)
        self.balance.rounding = float(np.finfo(float).eps) * self._size * self._size * stiffness
        reason = self.balance.fault(self._h * self._h / 8 * (self._accelerations - before))
        if reason:
            self._accelerations = before
        return reason

    def _squares(self) -> float:
        """a.M.a of what moves freely; collective [N mm/s2]."""
        a = self._motion.acceleration.copy()
        a[self._problem.loading.owned_prescribed] = 0.0
        return float(global_sum(self._comm, a @ (self._contact.masses * a)))

    def critical_step(self) -> float:
        """2/omega of the bonded interfaces, by Lanczos's method; collective [s].

        Conjugate gradients for K.x = b with the masses as preconditioner find the largest
        eigenvalue of M^-1.K on their way. Where pairs move K is not symmetric; the largest
        eigenvalue of its symmetric part is no less than the real part of any of its own.
        """
        problem, held = self._problem, self._problem.loading.owned_prescribed
        interfaces = problem.discretization.active.values()
        known = [active.stabilization for active in interfaces]
        for active in interfaces:
            take_in(active)
        problem.step.assemble_residual(hold=True)
        matrix = problem.discretization.create_matrix()
        problem.discretization.assemble_tangent(matrix, damage=False)
        for active, stabilization in zip(interfaces, known, strict=True):
            active.stabilization = stabilization
        if problem.discretization.slides:
            transposed = matrix.transpose(PETSc.Mat())
            matrix.axpy(1.0, transposed, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            matrix.scale(0.5)
            transposed.destroy()
        matrix.zeroRowsColumnsLocal(held, 0.0)
        x, b = matrix.createVecs()
        # The highest modes alternate from node to node, as does a function of their positions that
        # varies much faster, whichever rank numbers them.
        places, d = problem.space.tabulate_dof_coordinates(), problem.mesh.geometry.dim
        waves = np.sin(FAST * places[:, :d] / self._size + np.arange(1, 4)[:d])
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
        if not np.isfinite(largest):
            return 0.0
        return 2 / math.sqrt(largest) if largest > 0 else sys.float_info.max

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """M^-1.x, called by PETSc."""
        y.array[:] = x.array_r / self._masses

    def _step(self, before: float, t: float, after: float) -> bool:
        """The step to ``t``, and whether contact is in equilibrium at its end; collective."""
        problem, motion, loading, h = self._problem, self._motion, self._problem.loading, t - before
        step, u, held = problem.step, problem.u.x, loading.owned_prescribed
        step.march(t, h)
        moves = self._supports.at(before, t, after)
        a0 = motion.acceleration
        damped = self._motion.damping.exists
        if self._drag is None:
            self._drag = self._viscous.drag(motion.velocity.x.array[: self._owned])
        speed = motion.velocity.x.array[held]
        v = motion.velocity.x.array[: self._owned] + h / 2 * a0
        u.array[: self._owned] += h * v
        u.scatter_forward()
        u.array[loading.prescribed] = loading.prescribed_values(t)
        if not self._contact.balance(h):
            step.cancel()
            return False
        rate = self._motion.damping.resist(step.start.u, h) if damped else 0.0
        a1 = self._acceleration(v, h, rate, moves[1])
        v += h / 2 * a1
        v[self._massless] = (u.array[self._massless] - step.start.u[self._massless]) / h
        v[held] = moves[0]
        mass = self._contact.masses[held]
        first, spent = self._drag, 0.0
        if damped:
            self._drag = self._viscous.drag(v) + rate
            spent = (first + self._drag) / 2 @ (u.array - step.start.u)[: self._owned]
        viscous = first[held], self._drag[held]
        # Of lumped masses supports change the kinetic energy.
        done = mass @ (v[held] ** 2 - speed**2) / 2
        step.commit(WorkInMotion(viscous, float(done), float(spent)))
        carried = np.zeros(self._owned)
        if self._motion.damping.dashpots:
            carried -= self._viscous.of_dashpots(v)
        carried[held] += mass * a1[held] + viscous[1]
        self._count, self._h, self.taken = self._count + 1, h, self.taken + 1
        plan = Plan(self._count, self._critical, self._longest, self._cuts)
        motion.move(v, a1, carried, plan)
        return True

    def _acceleration(
        self, v: Array, h: float, rate: Array | float, of_supports: Array | float
    ) -> Array:
        forces = -self._problem.discretization.forces.x.array[: self._owned]
        forces -= rate
        a = self._viscous.solve(forces, self._inverse, v, h)
        a[self._problem.loading.owned_prescribed] = of_supports
        return a

    def free(self) -> None:
        self._contact.free()
