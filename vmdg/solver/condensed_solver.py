"""Linear systems of Newton's method on the gaps at interface points."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import sgetrf, sgetrs
from scipy.sparse import csr_array

from .flexibility import Flexibility
from .linear import GMRES, destroy, make_ksp

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Solve = Callable[[Array], Array]

#: Gap components with damage up to which the system is solved directly: 640 take 11 ms, iteratively
#: 13 ms in 2D; in 3D, among 3,600, 720 take 45 against 50 ms and 1,224 take 88 against 57 ms.
MAX_DENSE = 900

#: Relative residual that is aimed at, by the iterative solver within so many iterations, and one
#: that still makes a good Newton correction.
RTOL, MAX_ITERATIONS, ACCEPTED_RTOL = 1e-8, 50, 1e-2

#: What a direct solution in single precision is refined to, as if it were a double one, in so many
#: steps.
REFINED_RTOL, MAX_REFINEMENTS = 1e-15, 3

#: Smallest eigenvalues of Gamma relative to its largest, for its inverse in single precision.
MIN_EIGENVALUE = 1e-4


class CondensedSolver:
    """Solves (I - C.W^-1.S).x = b, with C the compliances of the return maps at the points.

    The laws are linear between their kinks, where an exact correction is the last one. Where few
    points take part, directly in their rows: by factors of single precision, in half the time, for
    b and for what is left of it; next to a singular stage in double precision. Where many points
    take part, iteratively: S is stiff for gaps that the displacement of the nodes can follow, and
    small for all others (3,600 gap components of the push-out in 3D belong to 1,014 jumps of
    nodes). The preconditioner takes it as S ~ W.P.Gamma.P^T.W, with P the
    interpolation from the nodes to the points and Gamma the projection
    (P^T.W.P)^-1.(P^T.S.P).(P^T.W.P)^-1, whence by the formula of Woodbury

        (I - C.P.Gamma.P^T.W)^-1 = I + C.P.(Gamma^-1 - P^T.W.C.P)^-1.P^T.W.

    It takes 6 to 8 iterations in all states of the push-out. Made for an earlier C it would take
    many more: it is made anew for every system, in 20 of 60 ms.

    Args:
        flexibility: Gives S, W and P.
        max_direct: Gap components with damage up to which the system is solved directly.
        max_iterations: Krylov iterations before an iterative solution is given up for a direct one.

    Attributes:
        iterations: Krylov iterations so far.
    """

    def __init__(
        self,
        flexibility: Flexibility,
        max_direct: int = MAX_DENSE,
        max_iterations: int = MAX_ITERATIONS,
    ):
        self._flexibility = flexibility
        self._max_direct = max_direct
        self._max_iterations = max_iterations
        self._krylov: _Krylov | None = None
        self.iterations = 0

    def solve(self, compliance: Array, right: Array) -> tuple[Array, Array]:
        """x from C (number of points, d, d) [mm3/N] and b (n,) [mm], and W^-1.S.x (n,) [MPa].

        Raises:
            np.linalg.LinAlgError: the matrix is singular.
        """
        points = np.flatnonzero(compliance.any(axis=(1, 2)))
        if not len(points):
            return right.copy(), self._flexibility.response(right)
        rows = (points[:, None] * compliance.shape[1] + np.arange(compliance.shape[1])).ravel()
        try:
            if len(rows) > self._max_direct:
                found = self._solve_iteratively(compliance, right)
            else:
                found = self._solve_single(compliance, points, rows, right)
        except np.linalg.LinAlgError:
            found = None
        if found is None:
            value = self._solve_double(compliance[points], rows, right)
            return value, self._flexibility.response(value)
        return found

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self._krylov is not None:
            self._krylov.free()

    def _solve_single(
        self, compliance: Array, points: NDArray[np.intp], rows: NDArray[np.intp], right: Array
    ) -> tuple[Array, Array] | None:
        """By factors of single precision, also of what they leave; None where that is much."""
        solve = self._direct(compliance[points], rows)
        response, size = self._flexibility.response, np.linalg.norm(right)
        value = solve(right)
        caused = response(value)
        for number in range(MAX_REFINEMENTS + 1):
            rest = right - value + _times(compliance, caused)
            left = np.linalg.norm(rest)
            if number == MAX_REFINEMENTS or not (
                REFINED_RTOL * size < left <= ACCEPTED_RTOL * size
            ):
                break
            more = solve(rest)
            value += more
            caused += response(more)
        return (value, caused) if left <= ACCEPTED_RTOL * size else None

    def _direct(self, C: Array, rows: NDArray[np.intp]) -> Solve:
        """Factors of the rows of the points with damage, whose compliances are C."""
        stiffness = self._stiffness
        if len(rows) < len(stiffness):
            stiffness = stiffness[rows][:, rows]
        solve = _factorized(_identity_minus(C.astype(np.float32), stiffness))

        def direct(right: Array) -> Array:
            value, b = self._pushed(C, rows, right)
            value[rows] = solve(b)
            return value

        return direct

    def _pushed(self, C: Array, rows: NDArray[np.intp], right: Array) -> tuple[Array, Array]:
        """What moves without damage, and b in ``rows`` with what that does to them."""
        value = right.copy()
        value[rows] = 0
        return value, right[rows] + _times(C, self._flexibility.response(value)[rows])

    def _solve_double(self, C: Array, rows: NDArray[np.intp], right: Array) -> Array:
        value, b = self._pushed(C, rows, right)
        areas = self._flexibility.areas[rows, None]
        stiffness = self._flexibility.matrix[np.ix_(rows, rows)] / areas
        value[rows] = np.linalg.solve(_identity_minus(C, stiffness), b)
        return value

    @cached_property
    def _stiffness(self) -> Single:
        """W^-1.S."""
        S, W = self._flexibility.matrix, self._flexibility.areas
        return np.divide(S, W[:, None], dtype=np.float32, casting="same_kind")

    @cached_property
    def _weighted(self) -> csr_array:
        """P^T.W."""
        return csr_array(self._flexibility.nodal.T * self._flexibility.areas[None, :])

    @cached_property
    def _coarse(self) -> Single:
        """Gamma^-1, (m, m) [mm/N times the square of the area].

        Where the displacement of a node is prescribed Gamma may have hardly any stiffness, which is
        raised a little.
        """
        P = self._flexibility.nodal
        inverse = np.linalg.inv((self._weighted @ P).toarray())
        gamma = inverse @ (P.T @ (P.T @ self._flexibility.matrix).T) @ inverse
        values, vectors = np.linalg.eigh((gamma + gamma.T) / 2)
        values = np.maximum(values, MIN_EIGENVALUE * values[-1])
        return ((vectors / values) @ vectors.T).astype(np.float32)

    def _solve_iteratively(self, compliance: Array, right: Array) -> tuple[Array, Array] | None:
        """By GMRES with the preconditioner of the nodes; None where it does not converge."""
        if self._krylov is None:
            self._krylov = _Krylov(len(right), self._max_iterations)
        response = self._flexibility.response
        value, iterations = self._krylov.solve(
            lambda x: x - _times(compliance, response(x)),
            self._nodal_preconditioner(_block_diagonal(compliance)),
            right,
        )
        self.iterations += iterations
        caused = response(value)
        rest = np.linalg.norm(right - value + _times(compliance, caused))
        return (value, caused) if rest <= ACCEPTED_RTOL * np.linalg.norm(right) else None

    def _nodal_preconditioner(self, C: csr_array) -> Solve:
        """Raises np.linalg.LinAlgError where its matrix is singular."""
        CP = csr_array(C @ self._flexibility.nodal)
        inner = self._coarse.copy()
        nodal = (self._weighted @ CP).tocoo()
        inner[nodal.row, nodal.col] -= nodal.data
        solve = _factorized(inner)
        return lambda x: x + CP @ solve(self._weighted @ x)


class _Krylov:
    """PETSc's FGMRES, which needs no product besides those of its iterations.

    Args:
        size: Number of unknowns.
        max_iterations: Before it gives up.
    """

    def __init__(self, size: int, max_iterations: int):
        matrix = PETSc.Mat().createPython((size, size), self, comm=PETSc.COMM_SELF)
        matrix.setUp()
        self._ksp = make_ksp(matrix, {**GMRES, "ksp_type": "fgmres", "pc_type": "python"})
        self._ksp.getPC().setPythonContext(self)
        self._ksp.setTolerances(rtol=RTOL, max_it=max_iterations)
        self._x, self._b = matrix.createVecs()
        self._matrix = matrix

    def solve(self, product: Solve, precondition: Solve, right: Array) -> tuple[Array, int]:
        """x and the number of iterations."""
        self._product, self._precondition = product, precondition
        self._b.array[:] = right
        self._ksp.solve(self._b, self._x)
        return self._x.array.copy(), self._ksp.getIterationNumber()

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """y = A x; called by PETSc."""
        y.array[:] = self._product(x.array_r)

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """y from x by the preconditioner; called by PETSc."""
        y.array[:] = self._precondition(x.array_r)

    def free(self) -> None:
        """Free the PETSc objects."""
        destroy(self._ksp)
        for item in (self._x, self._b, self._matrix):
            item.destroy()


def _times(blocks: Array, vector: Array) -> Array:
    """Block diagonal of (number, d, d) blocks times a vector (number d,)."""
    return np.einsum("pij,pj->pi", blocks, vector.reshape(blocks.shape[:2])).ravel()


def _identity_minus(blocks: NDArray, matrix: NDArray) -> NDArray:
    """I less the block diagonal of (number, d, d) blocks times a matrix (number d, number d)."""
    count, d, _ = blocks.shape
    rows = matrix.reshape(count, d, -1)
    result = np.empty_like(rows)
    # Sums of d rows: a product of many small blocks takes twice as long.
    for i in range(d):
        np.multiply(rows[:, 0], -blocks[:, i, 0, None], out=result[:, i])
        for j in range(1, d):
            result[:, i] -= blocks[:, i, j, None] * rows[:, j]
    result = result.reshape(matrix.shape)
    np.einsum("ii->i", result)[...] += 1
    return result


def _factorized(matrix: Single) -> Solve:
    """Solves with a matrix of single precision, which is overwritten.

    Raises:
        np.linalg.LinAlgError: it is singular.
    """
    # LAPACK finds the transpose of rows that lie one after the other.
    factors, pivots, singular = sgetrf(matrix.T, overwrite_a=True)
    if singular:
        raise np.linalg.LinAlgError("singular matrix")

    def solve(right: Array) -> Array:
        x, _ = sgetrs(factors, pivots, right.astype(np.float32), trans=1)
        return x.astype(float)

    return solve


def _block_diagonal(blocks: Array) -> csr_array:
    """Sparse matrix of (number, d, d) blocks."""
    count, d, _ = blocks.shape
    columns = np.arange(count * d).reshape(count, 1, d).repeat(d, axis=1).ravel()
    starts = np.arange(0, len(columns) + 1, d)
    return csr_array((blocks.ravel(), columns, starts), shape=(count * d, count * d))
