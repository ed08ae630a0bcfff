"""Linear solves of Newton's method: direct, or Krylov with lagged factors or multigrid."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from typing import NamedTuple, Protocol

from petsc4py import PETSc

from dolfinx import fem

from ..assembly.means import MeanSpace, lattice_of
from ..assembly.space import count_pieces
from ..base.parallel import warn_together
from ..base.timers import timer
from ..domain.geometry import rigid_motions
from ..forms.geometry import Geometry
from ..problem.problem import Problem

Petsc = Mapping[str, str | int | float | bool | None]


class Choice(Protocol):
    """What a user chooses of linear systems, see :class:`vmdg.SolveOptions`."""

    petsc: Petsc | None
    condensed: bool | None


#: Of the objects that options have configured.
_numbers = count()

#: Unsymmetric and symmetric direct solvers: the former finds the determinant, the latter counts all
#: negative pivots, for which the last front must not be left to ScaLAPACK. On several ranks a fifth
#: more memory than MUMPS foresees, PETSc's default, is too little now and then (INFOG(1) = -9).
#: Scaled by the diagonal, which for stiffness is as good as the iterated scaling by rows and
#: columns that MUMPS takes by itself: a tenth less for the factors of bodies in the plane.
MUMPS = {
    "ksp_type": "preonly",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_8": 1,
    "mat_mumps_icntl_14": 100,
}
#: INFOG(1) of MUMPS where memory, or its work space, was too little.
NO_MEMORY = (-5, -7, -8, -9, -11, -13, -14, -15, -17, -18, -19, -20)
LU = {**MUMPS, "pc_type": "lu", "mat_mumps_icntl_33": 1}
LDLT = {**MUMPS, "pc_type": "cholesky", "mat_mumps_icntl_13": 1}

#: GMRES with the true residual, which does not mind an indefinite softening tangent.
GMRES = {
    "ksp_type": "gmres",
    "ksp_pc_side": "right",
    "ksp_gmres_restart": 100,
    "ksp_max_it": 100,
}
#: With the factors of an earlier tangent. The flexible kind keeps what these made of every vector,
#: and spares the solve with which the other ends: one in five.
GMRES_LU = {**LU, **GMRES, "ksp_type": "fgmres"}
GMRES_LDLT = {**LDLT, **GMRES, "ksp_type": "fgmres"}

#: Smoothed aggregation from the rigid-body modes. Smoothers that only multiply, by the tangent in
#: blocks of nodes, take half the time of sweeps, and do not depend on the number of ranks. The
#: interpolation is kept, see :meth:`LinearSolver.coarsen`. The coarsest matrix is as large as it is
#: cheap to factorize: smoothers of coarse levels diverge where it has negative eigenvalues.
GAMG = {
    "pc_type": "gamg",
    "pc_gamg_threshold": 0.01,
    "pc_gamg_reuse_interpolation": True,
    "pc_gamg_coarse_eq_limit": 500,
    "pc_use_amat": True,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_ksp_max_it": 3,
    "mg_levels_pc_type": "pbjacobi",
}
GMRES_GAMG = {**GMRES, **GAMG}
#: The option of its size, which is to hold the rigid motions of all bodies, and a few more.
COARSEST, MOTIONS = "pc_gamg_coarse_eq_limit", 7
#: Pieces up to which each is coarsened for itself: the coarsest matrix, factorized, moves them all.
MAX_PIECES = 200
#: How PETSc makes coarse matrices.
PRODUCTS = "matptap_via"
#: For tangents that are symmetric and, away from a loss of stability, positive.
CG_GAMG = {
    **GAMG,
    "ksp_type": "cg",
    "ksp_pc_side": "left",
    "ksp_norm_type": "unpreconditioned",
    "ksp_max_it": 100,
}

#: Dofs in 3D beyond which factors are lagged, and beyond which they cost more than multigrid.
MAX_DIRECT, MAX_FACTORED = 3_000, 10_000

#: What a factorization and the set-up of multigrid cost in Krylov iterations; measured at 42,000
#: dofs in 3D: 1.8 s against 52 ms, .25 s against 13 ms.
FACTORIZATION, COARSENING = 35, 20

#: Loosest and tightest relative tolerance of iterative linear solves. Where points change branch a
#: correction that is not exact leads to another branch.
MAX_RTOL, MIN_RTOL = 1e-4, 1e-6

#: Share of its goal that the solve of a correction may leave where that ends the step, and how many
#: times the goal it leaves at least where it does not: in between a step would end or not by how
#: far a Krylov method overshoots, which depends on the number of ranks.
ENOUGH, SHORT = 0.03, 30.0


def automatic_options(
    problem: Problem, max_direct: int = MAX_DIRECT, max_factored: int = MAX_FACTORED
) -> tuple[Petsc, Petsc]:
    """Options of the solver that fits a problem, and of the one to fall back on.

    Problems in 2D and small ones in 3D are solved directly: LDL^T where the tangent is symmetric
    (no friction), else LU. Larger ones by multigrid, with CG where every interface is a tie, else
    GMRES: at 42,000 dofs it is made in .25 s and takes 13 ms an iteration, where a factorization
    takes 1.8 s and a solve with its factors 52 ms. In between, and where bodies are hardly
    compressible, by GMRES with the factors of an earlier tangent: few of its rows change in a step.

    Args:
        problem: The problem.
        max_direct: Dofs in 3D up to which every tangent is factorized.
        max_factored: Dofs in 3D up to which factors are used at all, of compressible bodies.
    """
    direct, lagged = (LDLT, GMRES_LDLT) if problem.discretization.symmetric else (LU, GMRES_LU)
    size = problem.space.dofmap.index_map.size_global * problem.space.dofmap.index_map_bs
    if size <= max_direct or problem.mesh.topology.dim < 3:
        return direct, direct
    if size <= max_factored or problem.discretization.bodies.mean_dilatation:
        return lagged, direct
    if not problem.discretization.can_fail:
        return CG_GAMG, direct
    coarsest = max(MOTIONS * pieces_apart(problem), GMRES_GAMG[COARSEST])
    return GMRES_GAMG | {COARSEST: coarsest}, direct


def pieces_apart(problem: Problem) -> int:
    """Pieces of the bodies that multigrid coarsens each for itself, 0 for none; collective."""
    if not problem.discretization.can_fail:
        return 0
    pieces = count_pieces(problem.space)
    return pieces if pieces <= MAX_PIECES else 0


def linear_tolerance(norms: list[float], goal: float) -> float:
    """Relative tolerance of the next linear solve, as exact as its correction can be.

    Choice 2 of Eisenstat and Walker (1996), .9 (|R_k| / |R_k-1|)^2 within bounds, and no more than
    the step still needs to end well below its goal (Kelley 1995).

    Args:
        norms: Residual norms of the step so far.
        goal: Residual norm at which the step has converged.
    """
    # Below the goal a residual may be zero, where the control asks for more than equilibrium.
    sizes = [max(norm, goal) for norm in norms[-2:]]
    eta = min(max(0.9 * (sizes[-1] / sizes[0]) ** 2, MIN_RTOL), MAX_RTOL)
    left = goal / sizes[-1]
    return min(ENOUGH * left, MAX_RTOL) if eta < SHORT * left else eta


class LinearOptions(NamedTuple):
    """The linear solver of a problem.

    Attributes:
        solver: Options of KSP and PC.
        fallback: Those of the direct solver where an iterative one does not converge.
        automatic: Whether both were chosen by :func:`automatic_options`.
    """

    solver: Petsc
    fallback: Petsc
    automatic: bool


def linear_options(problem: Problem, petsc: Petsc | None) -> LinearOptions:
    """The user's linear solver, or the one that fits if ``petsc`` only has options of SNES."""
    solver, fallback = automatic_options(problem)
    own = {name: value for name, value in (petsc or {}).items() if not name.startswith("snes_")}
    return LinearOptions(own or solver, fallback, not own)


def matrix_kind(options: Petsc) -> PETSc.Mat.Type:
    """In what a solver with these options likes a tangent to be assembled.

    Multigrid multiplies by blocks of nodes, and values are inserted into them in a third of the
    time; only coarse matrices are made of rows.
    """
    return PETSc.Mat.Type.BAIJ if options.get("pc_type") == "gamg" else PETSc.Mat.Type.AIJ


def is_iterative(options: Petsc) -> bool:
    """Whether these options are of a Krylov solver; PETSc's default is one."""
    return options.get("ksp_type") != "preonly"


class LinearSolver:
    """Solves with the tangent, directly or by a Krylov method.

    A Krylov method keeps its preconditioner over Newton iterations and steps. It is made anew where
    the iterations that a fresh one would have spared add up to what it costs, and where the method
    does not converge with an old one. Where it does not converge with a fresh one either, which
    happens near a limit point, the system is solved directly. Systems are solved to the tolerance
    asked for, unless the options set one.

    Args:
        matrix: The tangent, of :func:`matrix_kind` or the other.
        options: Of KSP and PC; a ``ksp_type`` other than "preonly" is iterative.
        fallback: Options of the direct solver.

    Attributes:
        multigrid: Whether it asks for the rigid modes.
        coarsened: Whether multigrid has an interpolation that served so far, or needs none.
        iterations: Krylov iterations so far.
    """

    def __init__(self, matrix: PETSc.Mat, options: Petsc, fallback: Petsc):
        self.multigrid = options.get("pc_type") == "gamg"
        self._keeps = self.multigrid and bool(options.get("pc_gamg_reuse_interpolation"))
        self.coarsened = not self._keeps
        self.iterations = 0
        self._matrix = matrix
        self._copy: PETSc.Mat | None = None
        self._copied = -1
        self._krylov = make_ksp(matrix, options) if is_iterative(options) else None
        if self._krylov is not None:
            self._krylov.setInitialGuessNonzero(True)
            self._krylov.setConvergenceHistory(reset=True)
            self._max_it = self._krylov.getTolerances()[3]
        self._setup = COARSENING if self.multigrid else FACTORIZATION
        self._direct: PETSc.KSP | None = None
        self._factorized = -1
        self._direct_options = options if self._krylov is None else fallback
        self._follows_tolerance = "ksp_rtol" not in options
        self._fresh_effort, self._excess = 0.0, math.inf

    def coarsen(self) -> None:
        """Make the interpolation of multigrid from the present values of the matrix; collective.

        It is kept for the values that follow, whose coarse matrices P^T.K.P are made anew. Nodes
        without coupling in the present values never share an aggregate.
        """
        self._krylov.getPC().reset()
        self._set_operators(reuse=False)
        with timer("coarsen"):
            self._set_up()
        self.coarsened = True
        self.renew()

    def renew(self) -> None:
        """Make the preconditioner anew in the next solve."""
        self._excess = math.inf

    def solve(self, b: PETSc.Vec, x: PETSc.Vec, rtol: float) -> None:
        """Solve A x = b with the current values of the tangent, to a relative tolerance.

        A Krylov method begins with x.
        """
        with timer("linear solve"):
            # What was solved directly has its factors.
            if self._krylov is not None and self._factorized != self._matrix.stateGet():
                if self._follows_tolerance:
                    self._krylov.setTolerances(rtol=rtol)
                if self._excess < self._setup and self._iterate(b, x, reuse=True):
                    return
                if self._iterate(b, x, reuse=False):
                    return
            self._solve_directly(b, x)

    def _iterate(self, b: PETSc.Vec, x: PETSc.Vec, reuse: bool) -> bool:
        ksp = self._krylov
        reset_failed(ksp.getPC())
        self._set_operators(reuse)
        patience = self._max_it
        if reuse:
            ksp.getPC().setReusePreconditioner(True)
            # An old one that takes as many more as a fresh one costs is given up; x remains.
            foreseen = -self._fresh_effort * math.log10(ksp.getTolerances()[0])
            patience = min(patience, math.ceil(foreseen) + self._setup)
        else:
            with timer("set up preconditioner"):
                self._set_up()
        ksp.setTolerances(max_it=patience)
        ksp.solve(b, x)
        iterations = ksp.getIterationNumber()
        self.iterations += iterations
        norms = ksp.getConvergenceHistory()
        # Iterations to the tolerance vary with it; their number per digit does not, which less than
        # a digit does not tell.
        digits = math.log10(norms[0] / norms[-1]) if len(norms) and norms[-1] > 0 else 0.0
        self._excess += iterations - self._fresh_effort * max(digits, 1.0)
        if not reuse:
            self._fresh_effort = iterations / digits if digits >= 1.0 else self._fresh_effort
            self._excess = 0.0
        converged = ksp.getConvergedReason() > 0
        if not converged:
            self.renew()
            self.coarsened = self.coarsened and (reuse or not self._keeps)
        return converged

    def _set_operators(self, reuse: bool) -> None:
        """What is multiplied by, and what the preconditioner is made of where it is not kept."""
        kind = PETSc.Mat.Type.BAIJ if self.multigrid else PETSc.Mat.Type.AIJ
        _, rows = self._krylov.getOperators()
        if not reuse:
            rows = self._in(PETSc.Mat.Type.AIJ)
        self._krylov.setOperators(self._in(kind), rows)

    def _set_up(self) -> None:
        """Make the preconditioner for the present values; what is kept of it stays."""
        self._krylov.getPC().setReusePreconditioner(False)
        with _coarse_products(self._matrix.comm):
            self._krylov.setUp()
        refuse_memory(self._krylov.getPC())

    def _in(self, kind: PETSc.Mat.Type) -> PETSc.Mat:
        """The tangent by rows or in blocks of nodes."""
        if self._matrix.type in ("seq" + kind, "mpi" + kind):
            return self._matrix
        if self._copy is None:
            self._copy = self._matrix.convert(kind, out=PETSc.Mat())
            self._copy.setNearNullSpace(self._matrix.getNearNullSpace())
        elif self._matrix.stateGet() != self._copied:
            self._matrix.convert(kind, out=self._copy)
        self._copied = self._matrix.stateGet()
        return self._copy

    def _solve_directly(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        if self._direct is None:
            self._direct = make_ksp(self._in(PETSc.Mat.Type.AIJ), self._direct_options)
        reset_failed(self._direct.getPC())
        self._direct.setOperators(self._in(PETSc.Mat.Type.AIJ))
        state = self._matrix.stateGet()
        if state != self._factorized:
            self._factorized = state
            with timer("factorize"):
                self._direct.setUp()
            refuse_memory(self._direct.getPC())
        self._direct.solve(b, x)

    @property
    def unstable(self) -> bool:
        """Whether the matrix is known to have negative eigenvalues: where it was solved directly,
        from negative pivots of LDL^T, or a negative determinant by LU (an odd number of them)."""
        if self._factorized != self._matrix.stateGet() or self._direct is None:
            return False
        if "mumps" not in self._direct_options.values():
            return False
        factors = self._direct.getPC().getFactorMatrix()
        if self._direct_options["pc_type"] == "cholesky":
            return factors.getMumpsInfog(12) > 0
        return factors.getMumpsRinfog(12) < 0

    @property
    def chosen(self) -> PETSc.KSP | None:
        """What the options have configured; None before the first solve of a direct one."""
        return self._direct if self._krylov is None else self._krylov

    def free(self) -> None:
        """Free the PETSc objects; collective."""
        for ksp in (self._krylov, self._direct):
            if ksp is not None:
                destroy(ksp)
        if self._copy is not None:
            self._copy.destroy()
        return_memory()


@contextmanager
def _coarse_products(comm: PETSc.Comm) -> Iterator[None]:
    """P^T.K.P of multigrid as two products, which takes .23 s instead of .38 s at 42,849 unknowns.

    PETSc offers it on one rank, by an option without prefix, which the user's own goes before.
    """
    database = PETSc.Options()
    if comm.size > 1 or PRODUCTS in database:
        yield
        return
    database[PRODUCTS] = "rap"
    try:
        yield
    finally:
        database.delValue(PRODUCTS)


def reset_failed(pc: PETSc.PC) -> None:
    """Let go of factors that failed, of NaN for example: MUMPS does no more after that."""
    if pc.getFailedReason() != PETSc.PC.FailedReason.NOERROR:
        pc.reset()


def refuse_memory(pc: PETSc.PC) -> None:
    """After a factorization; collective.

    Raises:
        MemoryError: it had not enough memory.
    """
    reasons, failed, told = PETSc.PC.FailedReason, pc.getFailedReason(), ""
    if failed == reasons.NOERROR:
        return
    if pc.getType() in ("lu", "cholesky") and pc.getFactorSolverType() == "mumps":
        code, amount = map(pc.getFactorMatrix().getMumpsInfog, (1, 2))
        told = f" (MUMPS: INFOG(1) = {code}, INFOG(2) = {amount})"
        failed = reasons.FACTOR_OUTMEMORY if code in NO_MEMORY else failed
    if failed == reasons.FACTOR_OUTMEMORY:
        size = pc.getOperators()[0].getSize()[0]
        raise MemoryError(
            f"a factorization of {size} unknowns ran out of memory{told}: take more memory (more "
            "nodes), a coarser mesh away from the interface, or a solver without factors, "
            "SolveOptions(condensed=False, petsc={'ksp_type': 'gmres', 'pc_type': 'gamg'}); where "
            "it is MUMPS that foresees too little, a larger 'mat_mumps_icntl_14'"
        )


def make_ksp(matrix: PETSc.Mat, options: Petsc) -> PETSc.KSP:
    """A solver with its own options."""
    ksp = PETSc.KSP().create(matrix.comm)
    ksp.setOperators(matrix)
    set_options(ksp, options)
    return ksp


def set_options(item: PETSc.KSP | PETSc.SNES, options: Petsc) -> None:
    """Configure a PETSc object by options named without prefix.

    They stay in PETSc's database under a prefix of the object: what is made when it is first used,
    factors or the smoothers of multigrid, reads them then. :func:`destroy` takes them away.
    """
    prefix = f"vmdg_{next(_numbers)}_"
    database = PETSc.Options(prefix)
    for name, value in options.items():
        database[name] = value
    item.setOptionsPrefix(prefix)
    item.setFromOptions()


def warn_of_unused(item: PETSc.KSP | PETSc.SNES) -> None:
    """Warn of options that PETSc has not asked for, after the first solve; collective.

    Not before: parts of a preconditioner that are made in a solve read theirs there, some on one
    rank only. Silent where petsc4py does not show PetscOptionsUsed of the C library.
    """
    used = getattr(ctypes.CDLL(PETSc.__file__), "PetscOptionsUsed", None)
    if used is None or item.getAttr("options asked for"):
        return
    item.setAttr("options asked for", True)
    prefix, unused = item.getOptionsPrefix(), []
    for name in PETSc.Options(prefix).getAll():
        found = ctypes.c_int(0)
        used(None, f"{prefix}{name}".encode(), ctypes.byref(found))
        if not found.value:
            unused.append(name)
    comm = item.comm.tompi4py()
    names = sorted(set.intersection(*(set(one) for one in comm.allgather(unused))))
    if names:
        warn_together(
            comm,
            f"SolveOptions: PETSc has no use for {', '.join(names)} among the options petsc=: "
            "misspelt, or of a part that this solver does not have; mend or remove them",
        )


def destroy(item: PETSc.KSP | PETSc.SNES) -> None:
    """Destroy an object that :func:`set_options` has configured, and its options; collective."""
    database = PETSc.Options(item.getOptionsPrefix())
    for name in database.getAll():
        database.delValue(name)
    item.destroy()


def set_rigid_modes(
    space: fem.FunctionSpace,
    geometry: Geometry,
    matrix: PETSc.Mat,
    means: MeanSpace | None = None,
) -> None:
    """Tell multigrid the motions without strain: translations, rotations, along z in axisymmetry.

    One set of modes serves all bodies: an aggregate lies in one body, or in several that ties join,
    and sees its rigid motions, see :meth:`.AssembledSystem.solve`. In a periodic cell a rotation
    strains what crosses its boundary: translations.
    """
    d, owned = space.dofmap.index_map_bs, space.dofmap.index_map.size_local
    x = space.tabulate_dof_coordinates()[:owned]
    modes = rigid_motions(x[:, :d], geometry)
    basis: list[PETSc.Vec] = []
    for mode in modes if lattice_of(means) is None else modes[:d]:
        vector = matrix.createVecRight()
        vector.array[:] = mode.ravel()
        if means is not None:
            vector.array[means.owned_rows] = 0.0
        for other in (*basis, *basis):  # twice: rounding of far-off origins
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
        basis.append(vector)
    matrix.setNearNullSpace(PETSc.NullSpace().create(vectors=basis, comm=matrix.comm))


def return_memory() -> None:
    """Return freed memory to the system, where the C library knows how (glibc).

    Without it the pages of freed factors stay with the process, in pieces that the next ones may
    not fit into: the largest resident size of the push-out in 3D was 1136 MiB instead of 764.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
