"""The linear systems of Newton's method, with prescribed displacements."""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ..assembly.discretization import assemble_bodies, moduli_of
from ..assembly.means import lattice_of
from ..base.arrays import power_of_two
from ..base.parallel import global_any, global_norm, global_sum
from ..output.cell import PeriodicCell
from ..problem.problem import Problem
from .ksp import (
    Choice,
    LinearSolver,
    Petsc,
    linear_options,
    matrix_kind,
    pieces_apart,
    set_rigid_modes,
    warn_of_unused,
)

Array = NDArray[np.float64]

#: Relative tolerance of iterative solves other than for corrections.
PRECISE = 1e-10

#: Residual at which refinement ends, ratio of two above which it is slow, most rounds.
REFINED, SLOW, MOST_REFINEMENTS = 1e-10, 0.2, 8

#: Stiffness of a component of the mean gradient, relative to the norm of K, that counts as
#: rounding.
UNHELD = 1e-11


class System:
    """K.du = forces with the tangent at the state of the last residual.

    Attributes:
        norm: Infinity norm of the first tangent with prescribed rows, but without walls, whose
            moduli have no unit [N/mm].
        drag: Added to the diagonal of K, relative to the norm.
        lags: Whether the last K is reused once, with all right-hand sides but the first.
        multiplier: What the second solution is multiplied with, over the norm of the first forces;
            0 if nothing is known of it [1/N].
        inertia: Matrices of mass and damping with their factors, added to K.
    """

    drag, lags, multiplier = 0.0, False, 0.0
    inertia: Sequence[tuple[PETSc.Mat, float]] = ()

    def __init__(self, problem: Problem, petsc: Petsc | None):
        self._options = linear_options(problem, petsc)
        self._automatic = self._options.automatic
        self._comm, self._discretization = problem.comm, problem.discretization
        # K as assembled; in the matrix, rows and columns of prescribed dofs are replaced.
        self._tangent: PETSc.Mat | None = None
        # Its part of linear bodies, and the number of their moduli.
        self._bodies: PETSc.Mat | None = None
        self._moduli: int | None = None
        self.norm, self._unit = 0.0, 1.0
        self._make_matrix()
        self._apart = self._linear.multigrid and pieces_apart(problem) > 0
        self._x, self._b = self._matrix.createVecs()
        self._loading = loading = problem.loading
        self._means = problem.discretization.means
        # Rigid faces have few unknown motions, solved for last, like means that are not prescribed.
        self._faces, self._motions = loading.rigid.dofs, loading.rigid.columns
        self._rigid = len(self._motions)
        if self._means is not None:
            self._release_means(loading.owned_prescribed)
        self._prescribed = np.concatenate([loading.owned_prescribed, self._faces])
        self._released = False
        self._last: list[Array] = []
        # K times the motions, their responses, and the last solutions.
        self._works = self._moving = self._motions
        self._found: list[Array] = []

    def _make_matrix(self) -> None:
        discretization, options = self._discretization, self._options
        self._pattern = discretization.couple()
        self._matrix = matrix = discretization.create_matrix(matrix_kind(options.solver))
        matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self._linear = LinearSolver(matrix, options.solver, options.fallback)
        if self._linear.multigrid:
            set_rigid_modes(
                discretization.space, discretization.geometry, matrix, discretization.means
            )

    def _renew_matrix(self) -> None:
        """Make matrix and solver again where surfaces that slide have other pairs."""
        iterations = self._linear.iterations
        self._free_matrix()
        self._make_matrix()
        self._linear.iterations = iterations

    def _free_matrix(self) -> None:
        self._linear.free()
        self._matrix.destroy()
        for item in (self._tangent, self._bodies):
            if item is not None:
                item.destroy()
        self._tangent = self._bodies = None

    def _release_means(self, prescribed: NDArray[np.int32]) -> None:
        free = np.setdiff1d(self._means.owned_dofs, prescribed)
        motions = self._means.unit_vectors(self._comm.bcast(free))
        self._faces = np.concatenate([self._faces, free])
        self._motions = np.concatenate([self._motions, motions])

    @property
    def iterations(self) -> int:
        return self._linear.iterations

    @property
    def unstable(self) -> bool:
        """Whether the last K is known to have negative eigenvalues."""
        return self._linear.unstable or self._released

    def solve(self, forces: Sequence[Array], moved: Sequence[Array], rtol: float) -> list[Array]:
        """Solve K.du = forces for one or several right-hand sides; collective.

        Args:
            forces: Forces on owned dofs; ignored at prescribed ones [N].
            moved: du of owned dofs for each of them, used at prescribed ones only [mm].
            rtol: Relative tolerance of iterative solves; for the second and later ones that of the
                sum with the multiplier, if it is known.

        Returns:
            du of owned dofs, not finite where K is singular [mm].
        """
        if self.lags:
            first = self._solve_held(forces[:1], moved[:1], rtol)
            self._found = self._release(np.array(forces[:1]), first) + self._found[1:]
            return self._found
        if self._discretization.couple() != self._pattern:
            self._renew_matrix()
        if not self._linear.coarsened and self._apart:
            self._coarsen()
        self._assemble()
        self._works = self._works_of(self._motions)
        right = [*forces, *np.zeros_like(self._motions)], [*moved, *self._motions]
        held = self._solve_held(*right, rtol)
        self._moving = np.array(held[len(forces) :])
        self._found = self._release(np.array(forces), held[: len(forces)])
        return self._found

    def respond(self, forces: Sequence[Array], moved: Sequence[Array]) -> list[tuple[Array, Array]]:
        """As :meth:`solve`, precisely and with K of the current state, and the product K.du for all
        owned dofs, prescribed ones included [N]; collective.

        The last factors are those of the last correction, close to K: they are corrected by
        iterative refinement, and renewed if that converges slowly.
        """
        self.lags = False
        if self._tangent is None or not self._refine(forces, moved):
            found, self._last = self.solve(forces, moved, PRECISE), []
            self._found = found
        return [(du, self.product(du)) for du in self._found]

    def _refine(self, forces: Sequence[Array], moved: Sequence[Array]) -> bool:
        """Solve with K of the current state by the last factors, into the last solutions; False if
        that does not converge; collective."""
        self._discretization.assemble_tangent(self._tangent)
        if self.drag:
            self._tangent.shift(self.drag * self.norm)
        self.lags, last, self._last = True, self._last, []
        size = global_norm(self._comm, np.array([self._balance(f) for f in forces]).ravel())
        found, left = np.zeros((len(forces), len(forces[0]))), size
        rest, ways, converged = np.array(forces), list(moved), False
        for _ in range(MOST_REFINEMENTS):
            found += self._release(rest, self._solve_held(rest, ways, PRECISE))
            ways = [np.zeros_like(way) for way in moved]
            rest = np.array([f - self.product(du) for f, du in zip(forces, found, strict=True)])
            balanced = np.array([self._balance(one) for one in rest])
            before, left = left, global_norm(self._comm, balanced.ravel())
            scale = size or global_norm(self._comm, (rest - balanced).ravel())
            converged = left <= REFINED * scale
            if converged or not left <= SLOW * (before or scale):
                break
        self.lags, self._last, self._found = False, last, list(found)
        return converged

    def _balance(self, forces: Array) -> Array:
        return self._loading.balance(forces.copy())

    def _assemble(self) -> None:
        """Assemble K at the current state, with a copy."""
        self._discretization.assemble_tangent(self._matrix, bodies=self._linear_bodies())
        for matrix, factor in self.inertia:
            self._matrix.axpy(factor, matrix, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        self.norm = self.norm or self._size()
        if self.drag:
            self._matrix.shift(self.drag * self.norm)
        if self._tangent is None:
            self._tangent = self._matrix.duplicate(copy=True)
        else:
            self._matrix.copy(self._tangent, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)

    def _linear_bodies(self) -> PETSc.Mat | None:
        """The tangent of linear bodies, after a first one of bodies and interfaces; None before,
        and for others; collective."""
        moduli = moduli_of(self._discretization)
        if self._tangent is None or moduli is None:
            return None
        if global_any(self._comm, self._bodies is None or moduli != self._moduli):
            assemble_bodies(self._discretization, self._matrix)
            if self._bodies is None:
                self._bodies = self._matrix.duplicate(copy=True)
            else:
                self._matrix.copy(self._bodies, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            self._moduli = moduli
        return self._bodies

    def _size(self) -> float:
        """Infinity norm of the matrix without walls; collective [N/mm]."""
        parts = self._discretization
        cells = [parts.bodies.cells_of[tag] for tag in parts.bodies.walls]
        if not cells:
            return self._matrix.norm(PETSc.NormType.NORM_INFINITY)
        d = parts.space.dofmap.index_map_bs
        nodes = np.unique(parts.space.dofmap.list[np.concatenate(cells)])
        dofs = (d * nodes[:, None] + np.arange(d)).ravel()
        matrix = self._matrix.duplicate(copy=True)
        matrix.zeroRowsColumnsLocal(dofs[dofs < parts.owned].astype(np.int32), 0.0)
        norm = matrix.norm(PETSc.NormType.NORM_INFINITY)
        matrix.destroy()
        return norm

    def _coarsen(self) -> None:
        """Coarsen every body separately, as if the interfaces that can fail had failed; collective.

        Then, however an interface fails, the bodies can move relative to each other on all levels,
        which halves the iterations. Aggregates across an interface would have to follow a failing
        bond, and adding the rigid motions of every body as modes of the whole would double the
        unknowns of all coarse matrices. Around a crack tip a body stays connected.
        """
        self._discretization.assemble_tangent(self._matrix, failing=False)
        self._prescribe()
        self._linear.coarsen()

    def _prescribe(self) -> None:
        """Scale the matrix and replace the rows of prescribed dofs by those of the identity.

        It is divided by a power of two near its norm, so that PETSc's absolute tolerances and the
        rounding of MUMPS's square roots do not depend on the unit; multigrid suffers from rows of
        very different size.
        """
        self._unit = float(power_of_two(self.norm or self._size()))
        self._matrix.scale(1 / self._unit)
        self._matrix.zeroRowsColumnsLocal(self._prescribed, 1.0)

    def _solve_held(
        self, forces: Sequence[Array], moved: Sequence[Array], rtol: float
    ) -> list[Array]:
        right = [f - self._lift(du) for f, du in zip(forces, moved, strict=True)]
        if not self.lags:
            self._prescribe()
        right, held = np.array(right) / self._unit, np.array(moved)
        right[:, self._prescribed] = held[:, self._prescribed]
        # The response to a load changes little from one correction to the next.
        found, last = [], [None, *self._last[1:]] + [None] * len(right)
        for b, guess in zip(right, last, strict=False):
            if self._linear.factored:
                found += list(self._linear.solve_more(right[len(found) :]))
                break
            self._b.array[:] = b
            self._x.array[:] = 0.0 if guess is None else guess
            # b of a support that moves is as large as the stiffness of the body.
            share = self.multiplier * self._unit * self._b.norm() if found else 0.0
            tight = min(rtol, PRECISE)
            self._linear.solve(self._b, self._x, max(rtol / max(share, 1.0), tight))
            found.append(self._x.array.copy())
        # A Krylov method does not keep a face exactly rigid.
        for du, motion in zip(found, held, strict=True):
            du[self._faces] = motion[self._faces]
        if not self.lags:
            self._last = found
        if not self._automatic:
            warn_of_unused(self._linear.chosen)
        return found

    def condensed(self, motions: Array) -> Array:
        """Schur complement of K (k, k) for motions of prescribed dofs, T^T over owned dofs (k,
        owned); collective [N/mm]."""
        self._assemble()
        works = self._works_of(motions)
        found = self._solve_held(np.zeros_like(motions), motions, PRECISE)
        return global_sum(self._comm, works @ np.array(found).T)

    def _works_of(self, motions: Array) -> Array:
        """Rows T^T.K of motions, over owned dofs (k, owned)."""
        rows = np.empty_like(motions)
        for row, motion in zip(rows, motions, strict=True):
            self._x.array[:] = motion
            self._tangent.multTranspose(self._x, self._b)
            row[:] = self._b.array + self._of_gradient(motion, adjoint=True)
        if self._means is not None and self._rigid:
            self._add_works_on_axial(rows, motions)
        return rows

    def _add_works_on_axial(self, rows: Array, motions: Array) -> None:
        """Add T^T.K.q for motions of rigid faces and F_33, which are not in the matrix."""
        unit = self._means.unit_vectors(self._comm.bcast(self._means.owned_dofs))[0]
        works = global_sum(self._comm, motions[: self._rigid] @ self._of_gradient(unit))
        rows[: self._rigid] += np.outer(works, unit)

    def _release(self, forces: Array, at_rest: list[Array]) -> list[Array]:
        """Solve for the motions of rigid faces, given the forces on them; collective.

        With du_0 for fixed faces and du_k for unit motions k of them without forces,

            T^T.K.(du_0 + sum_k q_k du_k) = T^T.forces.

        K has a negative eigenvalue if it has one for fixed faces (Cauchy), or if its Schur
        complement, the small matrix of q, has one (Haynsworth). A periodic cell that has separated
        has no stiffness, up to rounding, for some components of its mean gradient; these are kept
        fixed.
        """
        if not len(self._motions):
            return at_rest
        at_rest, moving, works = np.array(at_rest), self._moving, self._works
        stiffness, loads = np.split(
            global_sum(
                self._comm,
                np.hstack([works @ moving.T, self._motions @ forces.T - works @ at_rest.T]),
            ),
            [len(moving)],
            axis=1,
        )
        nothing = 0.0 if lattice_of(self._means) is None else UNHELD * self.norm
        try:
            if nothing:
                left, sizes, right = np.linalg.svd(stiffness)
                holds = sizes > nothing
                q = right[holds].T @ (left[:, holds].T @ loads / sizes[holds, None])
            else:
                q = np.linalg.solve(stiffness, loads)
            self._released = bool((np.linalg.eigvals(stiffness).real < -nothing).any())
        except np.linalg.LinAlgError:
            q, self._released = np.full_like(loads, np.nan), False
        return list(at_rest + q.T @ moving)

    def _lift(self, moved: Array) -> Array | float:
        du = np.zeros_like(moved)
        du[self._prescribed] = moved[self._prescribed]
        return self.product(du) if global_any(self._comm, du.any()) else 0.0

    def product(self, du: Array) -> Array:
        """K.du with the last K, of owned dofs, undefined at prescribed ones [N]; collective."""
        self._x.array[:] = du
        self._tangent.mult(self._x, self._b)
        return self._b.array + self._of_gradient(du)

    def _of_gradient(self, du: Array, adjoint: bool = False) -> Array | float:
        """Product of K, or its transpose, with the means in ``du``, which are not in the matrix."""
        if self._means is None:
            return 0.0
        gradient = self._means.gradient_of_owned(du)
        return self._discretization.uniform_forces(gradient, adjoint) if gradient.any() else 0.0

    def free(self) -> None:
        self._free_matrix()
        for item in (self._x, self._b):
            item.destroy()


def macroscopic_tangent(problem: Problem, options: Choice | None = None) -> NDArray[np.float64]:
    """dP_ij/dF_kl of the mean stress by the mean deformation gradient; collective [MPa].

    At small strain d sigma_ij/dE_kl. The tangent of the last step, consistent with its return maps,
    for all components of F_bar, whichever are prescribed: the fluctuation is eliminated by one
    factorization and one solve per component.

    Args:
        problem: A periodic cell at the end of a step, for example in a monitor.
        options: As :class:`vmdg.SolveOptions`, for their ``petsc``; None for the default.

    Returns:
        (n, n, n, n), n = 3 in generalized plane strain, else d.

    Raises:
        ValueError: the problem is not a periodic cell.
    """
    cell, discretization = PeriodicCell(problem), problem.discretization
    discretization.update_means()
    means = discretization.means
    system = System(problem, options.petsc if options else None)
    stiffness = system.condensed(means.unit_vectors(problem.comm.bcast(means.dofs)))
    system.free()
    result = np.zeros(4 * cell.gradient.shape[:1])
    i, j = np.transpose(means.entries)
    result[i[:, None], j[:, None], i, j] = stiffness * means.length**2 / cell.volume
    return result
