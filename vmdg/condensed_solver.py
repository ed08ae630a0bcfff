"""Linear systems of Newton's method on the gaps at interface points."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, gmres

from .compliance import Compliance

Array = NDArray[np.float64]

#: Gap components with damage up to which the system is solved directly.
DIRECT = 900

#: Relative residual that the iterative solver aims at within so many iterations, and one that still
#: makes a good Newton correction: single precision may come no closer.
CLOSE, PATIENCE, ENOUGH = 1e-4, 50, 1e-2


class CondensedSolver:
    """Solves (I - C.W^-1.S).x = b, with C the compliances of the return maps at the points.

    Where few points take part, directly in their rows. Else by GMRES. S is stiff for gaps that the
    displacement of the nodes can follow, and small for all others (3,600 gap components of the
    push-out in 3D belong to 1,014 jumps of nodes): the preconditioner takes it as
    S ~ W.P.Gamma.P^T.W, with P the interpolation from the nodes to the points and Gamma the
    projection (P^T.W.P)^-1.(P^T.S.P).(P^T.W.P)^-1, whence by the formula of Woodbury

        (I - C.P.Gamma.P^T.W)^-1 = I + C.P.(I - Gamma.P^T.W.C.P)^-1.Gamma.P^T.W.

    It takes 3 to 5 iterations in all states of the push-out; 20 to 70 without. Made for an earlier
    C it would take 20 to 40: it is made anew for every system, in 40 of 70 ms.

    Args:
        compliance: Gives S, W and P.

    Attributes:
        iterations: Krylov iterations so far.
    """

    def __init__(self, compliance: Compliance):
        self._compliance = compliance
        self.iterations = 0

    def solve(self, compliance: Array, right: Array) -> Array:
        """x from C (number of points, d, d) [mm3/N] and b (n,) [mm].

        Raises:
            np.linalg.LinAlgError: the matrix is singular.
        """
        points = np.flatnonzero(compliance.any(axis=(1, 2)))
        d = compliance.shape[1]
        if d * len(points) > DIRECT:
            value = self._iterate(compliance, right)
            if value is not None:
                return value
        return self._solve_directly(compliance[points], points, right)

    def _solve_directly(self, C: Array, points: NDArray[np.intp], right: Array) -> Array:
        d = C.shape[1]
        rows = (points[:, None] * d + np.arange(d)).ravel()
        value = right.copy()
        value[rows] = 0
        # What moves without damage acts on the points with damage.
        pushed = self._compliance.response(value)[rows].reshape(-1, d)
        stiffness = self._compliance.matrix[np.ix_(rows, rows)] / self._compliance.areas[rows, None]
        product = C @ stiffness.reshape(len(points), d, len(rows))
        matrix = np.eye(len(rows)) - product.reshape(len(rows), len(rows))
        value[rows] = np.linalg.solve(matrix, right[rows] + (C @ pushed[..., None]).ravel())
        return value

    @cached_property
    def _stiffness(self) -> NDArray[np.float32]:
        """W^-1.S in single precision, enough for corrections and half the memory to go through."""
        S, W = self._compliance.matrix, self._compliance.areas
        return np.divide(S, W[:, None], dtype=np.float32, casting="same_kind")

    @cached_property
    def _coarse(self) -> NDArray[np.float32]:
        """Gamma, (m, m) [N/mm per square of the area]."""
        P, W = self._compliance.nodal, self._compliance.areas
        weighted = (P.T.tocsr() * W[None, :]).tocsr()
        inverse = np.linalg.inv((weighted @ P).toarray())
        projected = P.T @ (P.T @ self._compliance.matrix).T
        return (inverse @ projected @ inverse).astype(np.float32)

    def _iterate(self, compliance: Array, right: Array) -> Array | None:
        """By GMRES; None where it does not converge."""
        C, size = _block_diagonal(compliance), (len(right), len(right))

        def apply(x: Array) -> Array:
            return x - C @ (self._stiffness @ x.astype(np.float32)).astype(float)

        value, _ = gmres(
            LinearOperator(size, apply, dtype=float),
            right,
            rtol=CLOSE,
            restart=PATIENCE,
            maxiter=1,
            M=LinearOperator(size, self._preconditioner(C), dtype=float),
            callback=self._count,
            callback_type="pr_norm",
        )
        rest = np.linalg.norm(right - apply(value))
        return value if rest <= ENOUGH * np.linalg.norm(right) else None

    def _count(self, norm: float) -> None:
        self.iterations += 1

    def _preconditioner(self, C: csr_array) -> Callable[[Array], Array]:
        P, W = self._compliance.nodal, self._compliance.areas
        CP, weighted = csr_array(C @ P), csr_array(P.T * W[None, :])
        inner = self._coarse @ (weighted @ CP).astype(np.float32).toarray()
        factors = lu_factor(np.eye(len(inner), dtype=np.float32) - inner)

        def precondition(x: Array) -> Array:
            jump = self._coarse @ (weighted @ x).astype(np.float32)
            return x + CP @ lu_solve(factors, jump).astype(float)

        return precondition


def _block_diagonal(blocks: Array) -> csr_array:
    """Sparse matrix of (number, d, d) blocks."""
    count, d, _ = blocks.shape
    columns = np.arange(count * d).reshape(count, 1, d).repeat(d, axis=1).ravel()
    starts = np.arange(0, len(columns) + 1, d)
    return csr_array((blocks.ravel(), columns, starts), shape=(count * d, count * d))
