"""Newton systems at small strain: bodies factorized once, damage by a capacitance matrix."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsymv
from scipy.sparse import bsr_array, csr_array, vstack
from scipy.sparse.linalg import LinearOperator, gmres

from ..assembly.point_matrices import jump_matrix, traction_matrix
from ..base.parallel import global_any, global_norm, global_sum
from ..base.timers import timer
from ..base.units import power_of_two
from ..interface.active import ActiveInterface, lets_go
from ..interface.return_map import Trial, apply, map_back
from ..problem.problem import Problem
from .ksp import LDLT, destroy, make_ksp, refuse_memory

Array = NDArray[np.float64]
Product = Callable[[Array], Array]
Integrate = Callable[[ActiveInterface], csr_array]

#: Number of columns of S per solve: a column then costs a twentieth of a single solve.
BLOCK = 128

#: Gap components with damage up to which their system is solved directly.
MAX_DIRECT_GAPS = 1200

#: Relative tolerance of the iterative solution, and its maximum number of iterations.
RTOL, MAX_ITERATIONS = 1e-9, 50

#: Maximum number of corrections of the gaps under return maps, relative residual of the nodal
#: forces, and maximum number of halvings: point states settle long before.
MAX_CORRECTIONS, GAP_TOLERANCE, MAX_HALVINGS = 40, 1e-4, 8

#: Smallest eigenvalues of Gamma relative to its largest, for its inverse.
MIN_EIGENVALUE = 1e-4


class Capacitance:
    """Systems of bodies of constant stiffness, see :class:`vmdg.linear.system.System`.

    At small strain damage changes the tangent at the points of the interfaces only,

        K = K_0 - B^T.D.B,    B_pi = int q_p.Tt(eta_i) dA,    D = C.W^-1,

    with K_0 the bonded tangent at fixed zeta, Tt of (84), C = d zeta/dT of the return maps and W
    the areas of the points. By the formula of Woodbury, with y = K_0^-1.b,

        K^-1.b = y + K_0^-1.B^T.z,    (I - D.S).z = D.B.y,    S = B.K_0^-1.B^T.

    The gap increments z are zero at points without damage. K_0 is factorized once, and again where
    facets of open contact were left out or taken in; S, symmetric and dense, is computed when a
    point is damaged for the first time. The first rank stores it and
    solves the systems of the gaps for all ranks. A second right-hand side costs a third of the
    first.

    Rigid faces move by u = T.q, :mod:`vmdg.assembly.rigid`. With the factors for fixed faces, and X
    the response of all nodes to the motions T of the faces without other forces, the inverse is

        K_0^-1 = (K_0)_rest^-1 + X.(X^T.K_0.X)^-1.X^T.

    Args:
        problem: A small-strain problem; its prescribed dofs are those at construction. Collective.
        max_direct: Gap components with damage up to which their system is solved directly.

    Attributes:
        norm: Infinity norm of K_0, prescribed rows included [N/mm].
        iterations: Krylov iterations so far, in systems of many gaps.
    """

    #: Bodies at small strain do not buckle, and their factors never change.
    unstable, drag, lags, multiplier = False, 0.0, False, 0.0

    def __init__(self, problem: Problem, max_direct: int = MAX_DIRECT_GAPS):
        self._problem, self._comm, self._max_direct = problem, problem.comm, max_direct
        active = problem.discretization.active.values()
        self._interfaces = [one for one in active if one.law.inelastic]
        self._areas = np.concatenate([one.point_tangent.areas for one in self._interfaces])
        rigid = problem.loading.rigid
        self._motions = rigid.columns
        self._prescribed = np.union1d(problem.loading.owned_prescribed, rigid.dofs)
        self._factorize()
        self.iterations = 0

    def _factorize(self) -> None:
        """Factorize K_0, with the facets that are in the forms now; collective."""
        problem, self._weights = self._problem, self._flux_weights()
        with timer("factorize bonded bodies"):
            matrix = problem.discretization.create_matrix()
            problem.discretization.assemble_tangent(matrix, damage=False)
            self.norm = matrix.norm(PETSc.NormType.NORM_INFINITY)
            prescribed = matrix.getOwnershipRange()[0] + self._prescribed
            self._lift = _columns(matrix, prescribed)
            # Makes the rounding of MUMPS's square roots independent of units.
            self._unit = float(power_of_two(self.norm))
            matrix.scale(1 / self._unit)
            matrix.zeroRowsColumns(prescribed, 1.0)
            matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self._ksp, self._stiffness = make_ksp(matrix, LDLT), matrix
            self._ksp.setUp()
        refuse_memory(self._ksp.getPC())
        self._tractions = self._over_points(traction_matrix)
        self._forces = self._tractions.transpose(PETSc.Mat())
        self._forces.zeroRows(prescribed, 0.0)
        self._free_faces()
        self._system: GapSystem | None = None

    def _flux_weights(self) -> list[Array]:
        """Of the interfaces whose open facets are left out."""
        return [one.stabilization.weights for one in self._interfaces if lets_go(one)]

    def _follow(self) -> None:
        """Factorize again if facets have been left out or taken in since; collective."""
        pairs = zip(self._weights, now := self._flux_weights(), strict=True)
        if now and global_any(self._comm, not all(np.array_equal(a, b) for a, b in pairs)):
            self.free()
            self._factorize()

    def _free_faces(self) -> None:
        """Compute X, X^T.K_0.X = T^T.K_0.X and B.X for rigid faces; collective."""
        self._moving, self._works = self._motions.T, self._motions
        self._opening = np.zeros((self._tractions.getLocalSize()[0], 0))
        self._resistance = np.zeros((0, 0))
        if not len(self._motions):  # products in PETSc need at least one column
            return
        motions = self._motions.T[self._prescribed]
        self._moving = self._solve_at_rest(np.zeros(self._motions.T.shape), motions)
        self._works = _times(self._lift, motions).T
        self._resistance = global_sum(self._comm, self._works @ self._moving)
        self._opening = _times(self._tractions, self._moving)

    def _over_points(self, integrate: Integrate) -> PETSc.Mat:
        """A matrix of all interfaces with one row per gap component, for the points on this
        rank."""
        rows = csr_array(vstack([integrate(active) for active in self._interfaces]))
        return _distributed(rows, self._stiffness.getSizes()[1][0], self._comm)

    # Systems

    def solve(self, forces: Sequence[Array], moved: Sequence[Array], rtol: float) -> Array:
        """Solve K.du = forces for several right-hand sides (k, owned dofs); collective."""
        self._follow()
        with timer("linear solve"):
            found, D = self._bonded(forces, moved), self._damage()
            if global_any(self._comm, D.any()):
                tractions = _times(self._tractions, found)
                found += self._under_gaps(self._solve_gaps(D, _times_blocks(D, tractions)))
        return found.T

    def solve_with_points(self, forces: Array, moved: Array, dt: float) -> Array:
        """du of linear bodies with the return maps of their points; collective.

        Newton's method on the gap increments z, which the return maps give for the trial tractions,

            z = d zeta(T_tr),    T_tr = T_0 + W^-1.(B.y + S.z),

        with backtracking on the residual nodal forces, B^T.(d zeta - z). The open, sticking and
        sliding points are found with S alone, without another factorization of the bodies.

        Args:
            forces: Forces on owned dofs [N].
            moved: du of owned dofs, used at prescribed ones only [mm].
            dt: Time step of the return maps [s].

        Returns:
            du of owned dofs [mm]; only an approximation if the iteration does not converge.
        """
        self._follow()
        trials = [active.trial() for active in self._interfaces]
        found = self._bonded([forces], [moved])
        tractions = bonded = _times(self._tractions, found)
        gaps = np.zeros_like(bonded)
        mapped, D = self._map_back(trials, tractions, dt)
        left = first = self._left(mapped - gaps)
        for _ in range(MAX_CORRECTIONS):
            if left <= GAP_TOLERANCE * first:
                break
            change = self._solve_gaps(D, mapped - _times_blocks(D, tractions - bonded)) - gaps
            if global_any(self._comm, np.isnan(change).any()):
                break
            moves = self._under_gaps(change)
            along = _times(self._tractions, moves)
            for length in 0.5 ** np.arange(MAX_HALVINGS):
                further = self._map_back(trials, tractions + length * along, dt)
                rest = self._left(further[0] - gaps - length * change)
                if rest < left:
                    break
            else:
                break
            found, gaps = found + length * moves, gaps + length * change
            tractions, (mapped, D), left = tractions + length * along, further, rest
        return found[:, 0]

    def product(self, du: Array) -> Array:
        """K.du with the last K, correct on free dofs, for owned dofs [N]; collective."""
        column = du[:, None]
        forces = _times(self._lift, column[self._prescribed])
        column = column.copy()
        column[self._prescribed] = 0.0
        forces += self._unit * _times(self._stiffness, column)
        tractions = _times(self._tractions, du[:, None])
        forces -= _times(self._forces, _times_blocks(self._damage(), tractions))
        return forces[:, 0]

    def respond(self, forces: Sequence[Array], moved: Sequence[Array]) -> list[tuple[Array, Array]]:
        """As :meth:`solve`, whose K is that of the current state, and K.du for all owned dofs,
        prescribed ones included [N]; collective."""
        found = self.solve(forces, moved, RTOL)
        gaps = _times_blocks(self._damage(), _times(self._tractions, found.T))
        products = np.array(forces)
        x, y = self._lift.createVecs()
        gap, held = self._tractions.createVecs()[::-1]
        for product, du, z in zip(products, found, gaps.T, strict=True):
            y.array[:], gap.array[:] = du, z
            self._lift.multTranspose(y, x)
            self._tractions.multTranspose(gap, held)
            product[self._prescribed] = x.array - held.array[self._prescribed]
        for item in (x, y, gap, held):
            item.destroy()
        return list(zip(found, products, strict=True))

    def _map_back(self, trials: Sequence[Trial], more: Array, dt: float) -> tuple[Array, Array]:
        """Gap increments (local gap components, 1) and D of the return maps with additional
        traction."""
        ends = np.cumsum([len(trial.gap) for trial in trials])[:-1]
        forces = more.reshape(len(self._areas), trials[0].gap.shape[1])
        stresses = np.split(forces / self._areas[:, None], ends)
        gaps, compliances = [], []
        for active, trial, stress in zip(self._interfaces, trials, stresses, strict=True):
            R = np.eye(trial.gap.shape[1])[None] if trial.R is None else trial.R
            load = apply(R.swapaxes(1, 2), trial.total + stress) - trial.r[:, None] * trial.gap
            update = map_back(active.law, load, trial, dt)
            gaps.append(apply(R, update.gap - trial.gap))
            compliances.append(R @ update.tangent @ R.swapaxes(1, 2))
        D = np.concatenate(compliances) / self._areas[:, None, None]
        return np.concatenate(gaps).reshape(-1, 1), D

    def _left(self, gaps: Array) -> float:
        """Norm of the nodal forces of gaps [N]."""
        return global_norm(self._comm, _times(self._forces, gaps).ravel())

    def _bonded(self, forces: Sequence[Array], moved: Sequence[Array]) -> Array:
        """Displacements (owned dofs, k) of bonded bodies."""
        right = np.column_stack(forces)
        found = self._solve_at_rest(right, np.column_stack(moved)[self._prescribed])
        return found + self._faces_under(self._motions @ right - self._works @ found)

    def _under_gaps(self, gaps: Array) -> Array:
        """Displacements of bonded bodies (owned dofs, k) due to gaps."""
        found = self._relax(_times(self._forces, gaps))
        return found + self._faces_under(self._opening.T @ gaps)

    def _solve_at_rest(self, forces: Array, known: Array) -> Array:
        """Displacements (owned dofs, k) of bonded bodies with fixed rigid faces, from forces and
        prescribed displacements (prescribed, k)."""
        right = forces - _times(self._lift, known)
        right[self._prescribed] = self._unit * known
        return self._relax(right)

    def _faces_under(self, forces: Array) -> Array:
        """X.q (owned dofs, k), the response of rigid faces to forces on their motions, summed over
        ranks (motions, k)."""
        if not len(self._motions):
            return np.zeros((len(self._moving), forces.shape[1]))
        forces = global_sum(self._comm, forces)
        return self._moving @ np.linalg.solve(self._resistance, forces)

    def _damage(self) -> Array:
        """Diagonal blocks of D of the last return maps (points here, d, d) [mm/N]."""
        C = np.concatenate([active.values.compliance for active in self._interfaces])
        return C / self._areas[:, None, None]

    def _relax(self, right: Array) -> Array:
        """K_0^-1.right (owned dofs, k)."""
        b = _dense(right / self._unit, self._comm)
        x = b.duplicate()
        self._ksp.matSolve(b, x)
        found = x.getDenseArray().copy()
        b.destroy()
        x.destroy()
        return found

    def _solve_gaps(self, D: Array, right: Array) -> Array:
        """z from D.B.y (local gap components, k), NaN where the system is singular."""
        if self._system is None:
            self._system = self._make_system()
        with timer("condensed solve"):
            if self._comm.size == 1:  # no communication needed
                gaps = self._system.solve(D, right)
                self.iterations = self._system.iterations
                return gaps
            parts, answers = self._comm.gather((D, right)), None
            if parts is not None:
                D, right = (np.concatenate(ranks) for ranks in zip(*parts, strict=True))
                gaps = self._system.solve(D, right)
                ends = np.cumsum([len(rows) for _, rows in parts])[:-1]
                answers = [(part, self._system.iterations) for part in np.split(gaps, ends)]
            gaps, self.iterations = self._comm.scatter(answers)
        return gaps

    def _make_system(self) -> GapSystem:
        """The system of the gaps on the first rank; an empty one on the others."""
        with timer("flexibility at points"):
            S = self._make_flexibility()
        jumps = self._gathered(self._over_points(jump_matrix))
        areas = np.repeat(self._areas, self._problem.mesh.geometry.dim)
        everywhere = np.concatenate(self._comm.allgather(areas))
        return GapSystem(S, jumps, everywhere[: len(S)], self._max_direct)

    def _make_flexibility(self) -> Array:
        """S, on the first rank."""
        size, first = self._forces.getSize()[1], self._comm.rank == 0
        owned, total = self._stiffness.getSizes()[1]
        rows = self._gathered(self._forces.transpose(PETSc.Mat()))
        S = np.empty((rows.shape[0], rows.shape[0]))
        factors = self._ksp.getPC().getFactorMatrix()
        factors.setMumpsIcntl(27, BLOCK)
        for start in range(0, size, BLOCK):
            # MUMPS takes sparse right-hand sides from the first rank.
            here = csr_array(rows[start : start + BLOCK])
            right = _distributed(here, total if first else 0, self._comm)
            columns, count = PETSc.Mat().createTranspose(right), right.getSize()[0]
            solution = _dense(np.zeros((owned, count)), self._comm)
            factors.matSolve(columns, solution)
            parts = self._comm.gather(_times(self._tractions, solution.getDenseArray()))
            if parts is not None:
                # S is symmetric: rows equal columns.
                S[start : start + count] = np.concatenate(parts).T / self._unit
            for item in (columns, right, solution):
                item.destroy()
        opening = self._comm.gather(self._opening)
        if opening is not None:
            opening = np.concatenate(opening)
            S += opening @ np.linalg.solve(self._resistance, opening.T)
        return S

    def _gathered(self, matrix: PETSc.Mat) -> csr_array:
        """Rows of all ranks on the first rank, none on the others; destroys the matrix."""
        rows = _rows_here(matrix)
        matrix.destroy()
        parts = self._comm.gather(rows)
        return csr_array(vstack(parts)) if parts is not None else rows[:0]

    def free(self) -> None:
        """Free the PETSc objects; collective."""
        destroy(self._ksp)
        for item in (self._stiffness, self._lift, self._tractions, self._forces):
            item.destroy()


def solve_contact(
    problem: Problem, system: object, forces: Array, moved: Array, dt: float
) -> Array:
    """:meth:`Capacitance.solve_with_points` at the current state of the bodies; collective.

    Args:
        problem: The problem.
        system: Its linear systems, used if they are a capacitance.
        forces, moved, dt: As there.
    """
    if isinstance(system, Capacitance):
        return system.solve_with_points(forces, moved, dt)
    system = Capacitance(problem)
    found = system.solve_with_points(forces, moved, dt)
    system.free()
    return found


class GapSystem:
    """Solves (I - D.S).z = b, for any number of b at once.

    If few points are damaged, directly in their rows; otherwise iteratively. S is stiff for gaps
    that nodal displacements can follow, and small for all others (3,600 gap components of the
    push-out in 3D correspond to 1,014 nodal jumps). The preconditioner approximates S ~
    J.Gamma.J^T, with J_pi = int q_p.eta_i dA over side 2 and Gamma its projection,

        Gamma = M^-1.P^T.S.P.M^-1,    P = W^-1.J,    M = J^T.P,

    whence by the formula of Woodbury

        (I - D.J.Gamma.J^T)^-1 = I + D.J.(Gamma^-1 - J^T.D.J)^-1.J^T.

    GMRES takes 6 to 8 iterations in all states of the push-out, but many more with the
    preconditioner of an earlier D, so it is rebuilt for every D.

    Args:
        S: (n, n) [N/mm].
        jumps: J, with columns for all dofs (n, N) [mm2].
        areas: W (n,) [mm2].
        max_direct: Gap components with damage up to which the system is solved directly.

    Attributes:
        iterations: Krylov iterations so far.
    """

    def __init__(self, S: Array, jumps: csr_array, areas: Array, max_direct: int):
        self._S, self._max_direct = S, max_direct
        self._jumps, self._areas = jumps, areas
        self.iterations = 0

    def solve(self, blocks: Array, right: Array) -> Array:
        """z (n, k), NaN where the matrix is singular [mm].

        Args:
            blocks: Diagonal blocks of D (points, d, d) [mm/N].
            right: b (n, k) [mm].
        """
        loaded = right.any(axis=1).reshape(blocks.shape[:2]).any(axis=1)
        damaged, gaps = np.flatnonzero(blocks.any(axis=(1, 2)) | loaded), None
        try:
            if damaged.size * blocks.shape[1] > self._max_direct:
                gaps = self._iterate(blocks, right)
            return self._solve_rows(blocks, right, damaged) if gaps is None else gaps
        except np.linalg.LinAlgError:
            return np.full_like(right, np.nan)

    def _solve_rows(self, blocks: Array, right: Array, damaged: NDArray[np.intp]) -> Array:
        """z, which is zero except at damaged points."""
        d = blocks.shape[1]
        rows = (damaged[:, None] * d + np.arange(d)).ravel()
        matrix = _times_blocks(-blocks[damaged], self._S[np.ix_(rows, rows)])
        matrix[np.diag_indices(len(rows))] += 1.0
        gaps = np.zeros_like(right)
        gaps[rows] = np.linalg.solve(matrix, right[rows])
        return gaps

    def _iterate(self, blocks: Array, right: Array) -> Array | None:
        """z, or None where GMRES does not converge."""
        starts, size = np.arange(len(blocks) + 1), (len(right),) * 2
        D = csr_array(bsr_array((blocks, starts[:-1], starts), shape=size))
        J, DJ = self._nodal, D @ self._nodal
        inverse = np.linalg.inv(self._coarse - (J.T @ DJ).toarray())

        def precondition(x: Array) -> Array:
            return x + DJ @ (inverse @ (J.T @ x))

        def product(x: Array) -> Array:
            x = precondition(x)
            # S is symmetric: the time is that of reading one half.
            return x - D @ dsymv(1.0, self._S.T, x)

        def count(_: float) -> None:
            self.iterations += 1

        gaps = np.empty_like(right)
        system = LinearOperator(size, product, dtype=float)
        # A restart handles a residual just above the tolerance due to rounding.
        limits = {"rtol": RTOL, "atol": 0.0, "restart": MAX_ITERATIONS, "maxiter": 2}
        for k, column in enumerate(right.T):
            x, failed = gmres(system, column, callback=count, callback_type="pr_norm", **limits)
            if failed:
                return None
            gaps[:, k] = precondition(x)
        return gaps

    @cached_property
    def _nodal(self) -> csr_array:
        """J of the dofs of nodes on the interface (n, m)."""
        largest = abs(self._jumps).max(axis=0).toarray().ravel()
        # Other shape functions vanish there up to rounding.
        return csr_array(self._jumps[:, np.flatnonzero(largest > 1e-12 * largest.max())])

    @cached_property
    def _coarse(self) -> Array:
        """Gamma^-1 (m, m).

        For prescribed nodes Gamma may be nearly singular, so its smallest eigenvalues are raised.
        """
        P = csr_array(self._nodal.multiply(1 / self._areas[:, None]))
        inverse = np.linalg.inv((self._nodal.T @ P).toarray())
        gamma = inverse @ (P.T @ (P.T @ self._S).T) @ inverse
        values, vectors = np.linalg.eigh((gamma + gamma.T) / 2)
        values = np.maximum(values, MIN_EIGENVALUE * values[-1])
        return (vectors / values) @ vectors.T


def _times_blocks(blocks: Array, rows: Array) -> Array:
    """Product of a block-diagonal matrix, its blocks (points, d, d), with rows (points * d, k)."""
    return (blocks @ rows.reshape(*blocks.shape[:2], rows.shape[1])).reshape(rows.shape)


def _columns(matrix: PETSc.Mat, chosen: NDArray[np.int32]) -> PETSc.Mat:
    """Columns of a symmetric matrix by their local numbers, read as rows."""
    numbers = PETSc.IS().createGeneral(chosen, comm=matrix.comm)
    rows = matrix.createSubMatrix(numbers)
    numbers.destroy()
    return rows.transpose()


def _rows_here(matrix: PETSc.Mat) -> csr_array:
    """Local rows of a distributed matrix, with all columns."""
    starts, columns, values = matrix.getValuesCSR()
    return csr_array((values, columns, starts), shape=(len(starts) - 1, matrix.getSize()[1]))


def _distributed(rows: csr_array, columns: int, comm: MPI.Comm) -> PETSc.Mat:
    """A distributed matrix from the rows of this rank and its number of columns."""
    starts, indices = (x.astype(PETSc.IntType) for x in (rows.indptr, rows.indices))
    size = ((rows.shape[0], None), (columns, rows.shape[1]))
    return PETSc.Mat().createAIJ(size, csr=(starts, indices, rows.data), comm=comm)


def _dense(rows: Array, comm: MPI.Comm) -> PETSc.Mat:
    """A distributed dense matrix from the rows of this rank."""
    size = ((rows.shape[0], None), (None, rows.shape[1]))
    matrix = PETSc.Mat().createDense(size, array=np.asfortranarray(rows), comm=comm)
    matrix.assemble()
    return matrix


def _times(matrix: PETSc.Mat, columns: Array) -> Array:
    """Product with columns distributed by rows (local rows, k)."""
    x, y = matrix.createVecs()
    found = np.empty((y.getLocalSize(), columns.shape[1]))
    for k, column in enumerate(columns.T):
        x.array = column
        matrix.mult(x, y)
        found[:, k] = y.array
    x.destroy()
    y.destroy()
    return found
