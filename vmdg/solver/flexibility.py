"""A linear body seen from its interface points: bonded stiffness, factorized once."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsymv
from scipy.sparse import csr_array, vstack

from ..assembly.point_matrices import jump_matrix, traction_matrix
from ..base.timers import timer
from ..problem.problem import Problem
from .linear import LDLT, destroy, make_ksp

#: Columns that are solved for together, and of these the ones that MUMPS takes at a time: a column
#: then costs a fifteenth of a single solve, 4 instead of 61 ms at 42,000 dofs in 3D.
BLOCK, MUMPS_BLOCK = 128, 64

#: Loads in the basis of a superposition, and the share of a load that is new enough to join it.
MAX_LOADS, NEW_SHARE = 6, 1e-3


class Flexibility:
    """Displacements and tractions that gaps and forces cause in bodies of constant stiffness.

    At small strain the residual (27) is linear in displacement u and inelastic gap zeta,

        R = K.u - B^T.zeta - f(t),    B_pi = int q_p.Tt(eta_i) dA,

    with K the bonded tangent, zeta held, and Tt of (84). A gap increment dzeta at the points of the
    interfaces, everything else in equilibrium, displaces by du = K^-1.B^T.dzeta, and the trial
    traction changes by

        dT = W^-1.S.dzeta,    S = B.K^-1.B^T,

    with W the areas of the points. S is symmetric and dense. It is made when it is first asked for:
    steps without damage do without.

    Args:
        problem: Of small strain, on one rank; its prescribed dofs are those of now.

    Attributes:
        size: Number n of gap components: points times dimension.
        prescribed: Prescribed dofs, held in all of this.
        stiffness: K, prescribed rows and columns included.
        areas: W, the area of the point of every component (n,) [mm2; mm in plane strain].
        nodal: Interpolation of jumps from the nodes of side 2 to the points (n, m).
    """

    def __init__(self, problem: Problem):
        with timer("factorize bonded bodies"):
            self.prescribed = problem.loading.prescribed
            self.stiffness = problem.discretization.create_matrix()
            problem.discretization.assemble_tangent(self.stiffness, damage=False)
            self._constrained = self.stiffness.copy()
            self._constrained.zeroRowsColumnsLocal(self.prescribed, 1.0)
            self._constrained.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self._solver = make_ksp(self._constrained, LDLT)
            self._solver.setUp()
        self._x, self._b = self.stiffness.createVecs()
        self._rows = self._prescribed_rows()
        self._columns = csr_array(self._rows.T)
        weak_form = problem.discretization.weak_form
        active = problem.discretization.active.values()
        interfaces = [c for c in active if c.law.inelastic]
        tractions = _stack([traction_matrix(weak_form, c) for c in interfaces])
        jumps = _stack([jump_matrix(weak_form, c) for c in interfaces])
        areas = np.concatenate([c.quadrature.weights for c in interfaces])
        self.areas = np.repeat(areas, problem.mesh.geometry.dim) * float(
            problem.discretization.geometry.thickness
        )
        self.size = len(self.areas)
        # Tractions are those of any displacement, forces act on the dofs that may move.
        self._tractions = csr_array(tractions.multiply(1 / self.areas[:, None]))
        free = np.ones(tractions.shape[1])
        free[self.prescribed] = 0
        self._gap_forces = csr_array(tractions.multiply(free[None, :]))
        self._forces = csr_array(self._gap_forces.T)
        self._zone = csr_array(self._gap_forces[:, _columns_of(self._gap_forces)].T)
        self.nodal = csr_array(jumps[:, _columns_of(jumps)].multiply(1 / self.areas[:, None]))

    def _prescribed_rows(self) -> csr_array:
        columns = self.stiffness.getSize()[1]
        chosen = PETSc.IS().createGeneral(self.prescribed, comm=PETSc.COMM_SELF)
        everything = PETSc.IS().createStride(columns, 0, 1, comm=PETSc.COMM_SELF)
        rows = self.stiffness.createSubMatrix(chosen, everything)
        for item in (chosen, everything):
            item.destroy()
        return _stack([rows])

    def relax(self, forces: NDArray[np.float64]) -> NDArray[np.float64]:
        """K^-1.forces, the prescribed dofs held at zero whatever acts there (N,) [mm]."""
        self._b.array[:] = forces
        self._b.array[self.prescribed] = 0
        with timer("linear solve"):
            self._solver.solve(self._b, self._x)
        return self._x.array.copy()

    def lift(self, moved: NDArray[np.float64]) -> NDArray[np.float64]:
        """Forces K.u of a displacement that moves the prescribed dofs only (N,) [N].

        Args:
            moved: Displacement of :attr:`prescribed` [mm].
        """
        return self._columns @ moved

    def reactions(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """K.u at the prescribed dofs [N]: the rows there are the columns, K is symmetric."""
        return self._rows @ u

    def gap_forces(self, gap: NDArray[np.float64]) -> NDArray[np.float64]:
        """B^T.zeta on all dofs, zero on prescribed ones (N,) [N]."""
        return self._forces @ gap

    def unbalanced(self, gap: NDArray[np.float64]) -> NDArray[np.float64]:
        """B^T.zeta on the free dofs of the cells at the interfaces [N]."""
        return self._zone @ gap

    def tractions(self, du: NDArray[np.float64]) -> NDArray[np.float64]:
        """Change W^-1.B.du of the trial traction by a displacement (n,) [MPa]."""
        return self._tractions @ du

    def response(self, gap: NDArray[np.float64]) -> NDArray[np.float64]:
        """Change W^-1.S.dzeta of the trial traction by a gap increment (n,) [MPa]."""
        if not gap.any():
            return np.zeros(self.size)
        # S is symmetric: half of it is read, which is what takes the time.
        return dsymv(1.0, self.matrix.T, gap) / self.areas

    @cached_property
    def matrix(self) -> NDArray[np.float64]:
        """S, (n, n) [N/mm]."""
        S = np.empty((self.size, self.size))
        factors = self._solver.getPC().getFactorMatrix()
        factors.setMumpsIcntl(27, MUMPS_BLOCK)
        with timer("flexibility at points"):
            for start in range(0, self.size, BLOCK):
                rows = csr_array(self._gap_forces[start : start + BLOCK])
                starts, indices = (x.astype(PETSc.IntType) for x in (rows.indptr, rows.indices))
                right = PETSc.Mat().createAIJ(
                    rows.shape, csr=(starts, indices, rows.data), comm=PETSc.COMM_SELF
                )
                columns = PETSc.Mat().createTranspose(right)
                solution = PETSc.Mat().createDense(rows.shape[::-1], comm=PETSc.COMM_SELF)
                solution.setUp()
                factors.matSolve(columns, solution)
                # S is symmetric: its rows are its columns.
                S[start : start + BLOCK] = (self._gap_forces @ solution.getDenseArray()).T
                for item in (right, columns, solution):
                    item.destroy()
        return S

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        destroy(self._solver)
        for item in (self._x, self._b, self._constrained, self.stiffness):
            item.destroy()


class Superposition:
    """Solves K.u = f, where f is a combination of earlier ones without a solve.

    The loads of a run are few fields times functions of the load factor. Loads that were solved for
    are an orthonormal basis q_i, with the displacements u_i under them:

        u = sum_i (q_i.f) u_i + K^-1.(f - sum_i (q_i.f) q_i),

    and the last term is left out where its load is negligible.

    Args:
        solve: u from f.
    """

    def __init__(self, solve: Callable[[NDArray[np.float64]], NDArray[np.float64]]):
        self._solve = solve
        self._loads: list[NDArray[np.float64]] = []
        self._displacements: list[NDArray[np.float64]] = []

    def __call__(self, forces: NDArray[np.float64], negligible: float) -> NDArray[np.float64]:
        """u, but for what a load of the norm ``negligible`` does [mm].

        Args:
            forces: f (N,), zero where displacements are held [N].
            negligible: [N].
        """
        rest, u = forces.copy(), np.zeros(len(forces))
        for load, displacement in zip(self._loads, self._displacements, strict=True):
            share = load @ rest
            rest -= share * load
            u += share * displacement
        size = float(np.linalg.norm(rest))
        if size <= negligible:
            return u
        more = self._solve(rest)
        if size > NEW_SHARE * np.linalg.norm(forces):
            if len(self._loads) == MAX_LOADS:
                self._loads, self._displacements = [], []
            self._loads.append(rest / size)
            self._displacements.append(more / size)
        return u + more


def _stack(matrices: list[PETSc.Mat]) -> csr_array:
    """The same matrices of one rank above each other; the originals are destroyed."""
    parts = []
    for matrix in matrices:
        starts, columns, values = matrix.getValuesCSR()
        parts.append(csr_array((values, columns, starts), shape=matrix.getSize()))
        matrix.destroy()
    return csr_array(vstack(parts))


def _columns_of(matrix: csr_array) -> NDArray[np.intp]:
    """Columns that hold more than zeros and their rounding."""
    largest = np.zeros(matrix.shape[1])
    np.maximum.at(largest, matrix.indices, np.abs(matrix.data))
    return np.flatnonzero(largest > 1e-12 * largest.max(initial=0.0))
