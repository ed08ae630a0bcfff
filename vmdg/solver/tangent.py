"""The matrix of Newton's method, assembled where the state asks for another one."""

from __future__ import annotations

from petsc4py import PETSc

from ..base.parallel import global_any
from ..problem.problem import Problem
from .kept_bulk import KeptBulk


class Tangent:
    """The tangent of a problem, and what of it may be older than the state.

    At small strain with a constant tau_s the tangent with zeta held is always the same. Steps that
    damage nothing share it, and a linear solver that finds it unchanged its factors. What a motion
    of the prescribed dofs causes is then K_p.u_p with the columns K_p of these dofs, which the
    matrix to be solved with has lost.

    Args:
        problem: The problem.
        keeps_bulk: Whether the bodies' part may be older, see :mod:`vmdg.solver.kept_bulk`.

    Attributes:
        matrix: K.
        norm: Infinity norm of the first one, prescribed rows included [N/mm].
        assemblies: How often it was assembled.
    """

    def __init__(self, problem: Problem, keeps_bulk: bool):
        self.matrix = problem.create_matrix()
        self.matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self.norm = 0.0
        self.assemblies = 0
        self.bulk = KeptBulk(problem, self.matrix) if keeps_bulk else None
        self._problem = problem
        self._prescribed = problem.owned_prescribed
        self._constant = problem.discretization.constant_stabilization
        self._held = self._constrained = False
        self._columns: PETSc.Mat | None = None

    def assemble(self, damage: bool = True) -> None:
        """Tangent at the state of the last residual; collective.

        Args:
            damage: False holds zeta: the damage part of (84) is left out.
        """
        constant = self._constant and not (damage and self._damages())
        if constant and self._held:
            return
        self.assemblies += 1
        if self.bulk is None:
            self._problem.assemble_tangent(self.matrix, damage)
        else:
            self.bulk.assemble(damage)
        if self.norm == 0.0:
            self.norm = self.matrix.norm(PETSc.NormType.NORM_INFINITY)
        if constant and self._columns is None:
            self._columns = self._prescribed_columns()
        self._held, self._constrained = constant, False

    def _damages(self) -> bool:
        """Whether a point has a compliance of damage or friction, on any rank."""
        interfaces = self._problem.discretization.active.values()
        grown = any(c.compliance.any() for c in interfaces if c.law.inelastic)
        return global_any(self._problem.comm, grown)

    def _prescribed_columns(self) -> PETSc.Mat:
        first, last = self.matrix.getOwnershipRange()
        rows = PETSc.IS().createStride(last - first, first, 1, comm=self.matrix.comm)
        columns = PETSc.IS().createGeneral(first + self._prescribed, comm=self.matrix.comm)
        result = self.matrix.createSubMatrix(rows, columns)
        rows.destroy()
        columns.destroy()
        return result

    def lift(self, u: PETSc.Vec, forces: PETSc.Vec) -> None:
        """Forces K.u of a displacement that moves prescribed dofs only; before :meth:`constrain`.

        Args:
            u: Displacement [mm].
            forces: To be filled [N].
        """
        if not self._held:
            self.matrix.mult(u, forces)
            return
        moved = self._columns.createVecRight()
        moved.array[:] = u.array_r[self._prescribed]
        self._columns.mult(moved, forces)
        moved.destroy()

    def constrain(self) -> None:
        """Rows and columns of prescribed dofs become those of the identity; collective."""
        if not self._constrained:
            self.matrix.zeroRowsColumnsLocal(self._prescribed, 1.0)
            self._constrained = True

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for item in (self.bulk, self._columns, self.matrix):
            if item is not None:
                item.destroy()
