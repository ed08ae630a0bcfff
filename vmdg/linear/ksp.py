"""Linear solves in Newton's method: direct, or Krylov with lagged factors or multigrid."""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from typing import NamedTuple, Protocol

from petsc4py import PETSc

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..assembly.means import MeanSpace, lattice_of
from ..assembly.space import count_pieces
from ..base.parallel import warn_together
from ..base.timers import timer
from ..base.words import near
from ..domain.geometry import rigid_motions
from ..forms.geometry import Geometry
from ..problem.problem import Problem

Petsc = Mapping[str, str | int | float | bool | None]


class Choice(Protocol):
    """The user's options for linear systems, see :class:`vmdg.SolveOptions`."""

    petsc: Petsc | None


#: Prefixes of the objects configured by options.
_numbers = count()

#: Unsymmetric and symmetric direct solvers: the former computes the determinant, the latter counts
#: negative pivots, for which the last front must not be factorized by ScaLAPACK. On several ranks
#: PETSc's default, a fifth more memory than MUMPS estimates, is sometimes too little (INFOG(1) =
#: -9). Diagonal scaling is as good for stiffness matrices as MUMPS's default, iterated row and
#: column scaling, and makes factorizations of plane bodies a tenth cheaper.
MUMPS = {
    "ksp_type": "preonly",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_8": 1,
    "mat_mumps_icntl_14": 100,
}
#: INFOG(1) of MUMPS if memory, or its work space, was insufficient.
NO_MEMORY = (-5, -7, -8, -9, -11, -13, -14, -15, -17, -18, -19, -20)
LU = {**MUMPS, "pc_type": "lu", "mat_mumps_icntl_33": 1}
LDLT = {**MUMPS, "pc_type": "cholesky", "mat_mumps_icntl_13": 1}

#: GMRES with the true residual, which is robust for an indefinite softening tangent.
GMRES = {
    "ksp_type": "gmres",
    "ksp_pc_side": "right",
    "ksp_gmres_restart": 100,
    "ksp_max_it": 100,
}
#: With the factors of an earlier tangent. Flexible GMRES stores the preconditioned vectors and
#: saves the final solve of the other: one in five.
GMRES_LU = {**LU, **GMRES, "ksp_type": "fgmres"}
GMRES_LDLT = {**LDLT, **GMRES, "ksp_type": "fgmres"}

#: Smoothed aggregation from the rigid-body modes. Polynomial smoothers, which only multiply by the
#: tangent in nodal blocks, take half the time of sweeps and do not depend on the number of ranks.
#: The interpolation is reused, see :meth:`LinearSolver.coarsen`. The coarsest matrix is as large as
#: can be factorized cheaply, since smoothers on coarse levels diverge for negative eigenvalues.
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
#: Sweeps where bodies flow and are nearly incompressible: two thirds of the iterations and of the
#: time of polynomials.
SWEEPS = {"mg_levels_ksp_max_it": 1, "mg_levels_pc_type": "sor"}
#: The option for its size, which must exceed the number of rigid motions of all bodies.
COARSEST, MOTIONS = "pc_gamg_coarse_eq_limit", 7
#: Number of pieces up to which each is coarsened separately: the factorized coarsest matrix
#: contains the motions of all.
MAX_PIECES = 200
#: Number of dofs from which the memory of freed factors goes back to the system. Of small problems
#: it does not: to get it again takes a tenth of the solve of one load with 1,000 to 4,000 unknowns.
RETURNED = 20_000
#: Algorithm of PETSc for coarse matrices.
PRODUCTS = "matptap_via"
#: For tangents that are symmetric and, unless stability is lost, positive definite.
CG_GAMG = {
    **GAMG,
    "ksp_type": "cg",
    "ksp_pc_side": "left",
    "ksp_norm_type": "unpreconditioned",
    "ksp_max_it": 100,
}

#: Number of dofs in 3D above which factors are lagged, and above which multigrid is cheaper.
MAX_DIRECT, MAX_FACTORED = 3_000, 10_000
#: Iterations after which factors take the place of multigrid, and the number of dofs up to which:
#: a factorization costs 66 iterations at 21,000 dofs, and memory for more may be short.
FEW, MAX_AFFORDED = {"ksp_max_it": 50}, 100_000

#: Cost of a factorization and of the set-up of multigrid in Krylov iterations; measured at 42,000
#: dofs in 3D: 1.8 s to 52 ms, 0.25 s to 13 ms.
FACTORIZATION, COARSENING = 35, 20

#: Loosest and tightest relative tolerance of iterative linear solves. At points that change branch
#: an inexact correction leads to another branch.
MAX_RTOL, MIN_RTOL = 1e-4, 1e-6

#: GMRES with the factors of a direct solve.
REFINE = {**GMRES, "ksp_type": "fgmres", "ksp_max_it": FACTORIZATION}

#: Fraction of the residual goal to which the last linear solve of a step converges, and the least
#: multiple of the goal for earlier ones: in between, the end of a step would depend on how far a
#: Krylov method overshoots, and hence on the number of ranks.
ENOUGH, SHORT = 0.03, 30.0


def automatic_options(
    problem: Problem, max_direct: int = MAX_DIRECT, max_factored: int = MAX_FACTORED
) -> tuple[Petsc, Petsc]:
    """Options of a suitable solver for a problem, and of the fallback.

    Problems in 2D and small ones in 3D are solved directly: LDL^T where the tangent is symmetric
    (no friction), else LU. Larger ones by multigrid, with CG where every interface is a tie and the
    tangent symmetric, else GMRES: at 42,000 dofs the set-up takes 0.25 s and an iteration 13 ms,
    compared with 1.8 s for a factorization and 52 ms for a solve. In between, and for nearly
    incompressible bodies, by GMRES with the factors of an earlier tangent: few of its rows change
    in a step.

    Args:
        max_direct: Dofs in 3D up to which every tangent is factorized.
        max_factored: Dofs in 3D up to which factors are used at all, of compressible bodies.
    """
    direct, lagged = (LDLT, GMRES_LDLT) if problem.discretization.symmetric else (LU, GMRES_LU)
    size = problem.space.dofmap.index_map.size_global * problem.space.dofmap.index_map_bs
    if size <= max_direct or problem.mesh.topology.dim < 3:
        return direct, direct
    if size <= max_factored or problem.discretization.bodies.mean_dilatation:
        return lagged, direct
    more = SWEEPS if problem.discretization.bodies.points is not None else {}
    if size <= MAX_AFFORDED:
        more = more | FEW
    if problem.discretization.symmetric and not problem.discretization.can_fail:
        return CG_GAMG | more, direct
    coarsest = max(MOTIONS * pieces_apart(problem), GMRES_GAMG[COARSEST])
    return GMRES_GAMG | more | {COARSEST: coarsest}, direct


def pieces_apart(problem: Problem) -> int:
    """Number of pieces of the bodies that multigrid coarsens separately, 0 for none; collective."""
    if not problem.discretization.can_fail:
        return 0
    pieces = count_pieces(problem.space)
    return pieces if pieces <= MAX_PIECES else 0


def linear_tolerance(norms: list[float], goal: float) -> float:
    """Relative tolerance of the next linear solve, matched to the accuracy of its correction.

    Choice 2 of Eisenstat and Walker (1996), 0.9 (|R_k| / |R_k-1|)^2 within bounds, and not tighter
    than needed to end well below the goal (Kelley 1995).
    """
    # The residual may be zero while the constraint of the step is not met.
    sizes = [max(norm, goal) for norm in norms[-2:]]
    if not sizes[0]:  # nothing moves
        return MAX_RTOL
    eta = min(max(0.9 * (sizes[-1] / sizes[0]) ** 2, MIN_RTOL), MAX_RTOL)
    left = goal / sizes[-1]
    return min(ENOUGH * left, MAX_RTOL) if eta < SHORT * left else eta


class LinearOptions(NamedTuple):
    """The linear solver of a problem."""

    solver: Petsc
    fallback: Petsc  # Those of the direct solver where an iterative one does not converge
    automatic: bool


def linear_options(problem: Problem, petsc: Petsc | None) -> LinearOptions:
    """The user's linear solver, or the one that fits if ``petsc`` only has options of SNES."""
    solver, fallback = automatic_options(problem)
    own = {name: value for name, value in (petsc or {}).items() if not name.startswith("snes_")}
    return LinearOptions(own or solver, fallback, not own)


def matrix_kind(options: Petsc) -> PETSc.Mat.Type:
    """Preferred matrix type of a solver with these options.

    Multigrid multiplies by nodal blocks, into which insertion takes a third of the time; only
    coarse matrices are made from AIJ.
    """
    return PETSc.Mat.Type.BAIJ if options.get("pc_type") == "gamg" else PETSc.Mat.Type.AIJ


def is_iterative(options: Petsc) -> bool:
    """Whether these options select a Krylov solver, PETSc's default."""
    return options.get("ksp_type") != "preonly"


class LinearSolver:
    """Solves with the tangent, directly or by a Krylov method.

    A Krylov method reuses its preconditioner over Newton iterations and steps. It is rebuilt when
    the iterations that a new one would have saved add up to its cost, and when the method does not
    converge with the old one. If it does not converge with a new one either, as may happen near a
    limit point, the system is solved directly. Where that was multigrid, GMRES with these factors
    solves the next systems, with 2, 4, 8 ... sets of factors before multigrid is tried again: it
    may be bad for the mesh, as for thin arms of laminates, not for this state alone. Systems are
    solved to the given tolerance, unless the options set one.

    Args:
        options: Options of KSP and PC; a ``ksp_type`` other than "preonly" is iterative.

    Attributes:
        coarsened: Whether multigrid has a valid interpolation, or needs none.
    """

    def __init__(self, matrix: PETSc.Mat, options: Petsc, fallback: Petsc):
        self.multigrid = options.get("pc_type") == "gamg"
        self._keeps = self.multigrid and bool(options.get("pc_gamg_reuse_interpolation"))
        self.coarsened = not self._keeps
        self.iterations = 0
        self._matrix, self._options = matrix, options
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
        self._refined: PETSc.KSP | None = None
        self._age = 0  # Iterations that newer factors would have saved
        self._failures = 0  # of multigrid
        self._sets = 0  # of factors to be used before it is tried again

    def coarsen(self) -> None:
        """Build the interpolation of multigrid from the current values of the matrix; collective.

        It is reused for later values, for which only the coarse matrices P^T.K.P are recomputed.
        Nodes that are uncoupled in the current values never share an aggregate.
        """
        self._krylov.getPC().reset()
        self._set_operators(reuse=False)
        with timer("coarsen"):
            self._set_up()
        self.coarsened = True
        self.renew()

    def renew(self) -> None:
        self._excess = math.inf

    def solve(self, b: PETSc.Vec, x: PETSc.Vec, rtol: float) -> None:
        """Solve A x = b with the current values of the tangent, to a relative tolerance.

        A Krylov method starts from x.
        """
        with timer("linear solve"):
            # Reuse the factors of a direct solve.
            if self._krylov is not None and self._factorized != self._matrix.stateGet():
                if self._follows_tolerance:
                    self._krylov.setTolerances(rtol=rtol)
                if self._sets:
                    if self._refine(b, x):
                        return
                    self._sets -= 1
                if not self._sets:
                    if self._excess < self._setup and self._iterate(b, x, reuse=True):
                        return
                    if self._iterate(b, x, reuse=False):
                        return
                    if self.multigrid:
                        self._failures += 1
                        self._sets = 2**self._failures
            self._solve_directly(b, x)

    def _iterate(self, b: PETSc.Vec, x: PETSc.Vec, reuse: bool) -> bool:
        ksp = self._krylov
        reset_failed(ksp.getPC())
        self._set_operators(reuse)
        patience = self._max_it
        if reuse:
            ksp.getPC().setReusePreconditioner(True)
            # An old one is discarded once its extra iterations cost as much as a new one; x is
            # kept.
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
        # The count depends on the tolerance; iterations per digit do not, but need at least one
        # digit.
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

    def _refine(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Solve by GMRES with the factors of the last direct solve, unless these are too old."""
        pc, matrix = self._direct.getPC(), self._in(PETSc.Mat.Type.AIJ)
        if self._age >= FACTORIZATION or pc.getFailedReason() != PETSc.PC.FailedReason.NOERROR:
            return False
        if self._refined is None:
            self._refined = make_ksp(matrix, REFINE)
            self._refined.setPC(pc)
            self._refined.setInitialGuessNonzero(True)
        self._refined.setOperators(matrix)
        pc.setReusePreconditioner(True)
        self._refined.setTolerances(rtol=self._krylov.getTolerances()[0])
        self._refined.solve(b, x)
        iterations = self._refined.getIterationNumber()
        self.iterations += iterations
        self._age += max(iterations - 1, 0)
        return self._refined.getConvergedReason() > 0

    def _set_operators(self, reuse: bool) -> None:
        kind = PETSc.Mat.Type.BAIJ if self.multigrid else PETSc.Mat.Type.AIJ
        _, rows = self._krylov.getOperators()
        if not reuse:
            rows = self._in(PETSc.Mat.Type.AIJ)
        self._krylov.setOperators(self._in(kind), rows)

    def _set_up(self) -> None:
        """Build the preconditioner for the current values; reused parts are kept."""
        self._krylov.getPC().setReusePreconditioner(False)
        with _coarse_products(self._matrix.comm), refused_in_words(self._options):
            self._krylov.setUp()
        refuse_memory(self._krylov.getPC())

    def _in(self, kind: PETSc.Mat.Type) -> PETSc.Mat:
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
            self._factorized, self._age = state, 0
            self._direct.getPC().setReusePreconditioner(False)
            with timer("factorize"), refused_in_words(self._direct_options):
                self._direct.setUp()
            refuse_memory(self._direct.getPC())
        self._direct.solve(b, x)

    @property
    def factored(self) -> bool:
        """Whether the last solve was a direct one, with the current values, that succeeded."""
        if self._direct is None or self._factorized != self._matrix.stateGet():
            return False
        return self._direct.getConvergedReason() > 0

    def solve_more(self, right: NDArray[np.float64]) -> NDArray[np.float64]:
        """Solve for several right-hand sides (n, owned) at once where it is :attr:`factored`, in
        a quarter of the time; collective."""
        rows, columns = self._matrix.getSizes()[0], (PETSc.DECIDE, len(right))
        b, x = (
            PETSc.Mat().createDense((rows, columns), array=array.T, comm=self._matrix.comm)
            for array in (right, np.zeros_like(right))
        )
        with timer("linear solve"):
            self._direct.matSolve(b, x)
        found = x.getDenseArray().T.copy()
        for item in (b, x):
            item.destroy()
        return found

    @property
    def unstable(self) -> bool:
        """Whether the matrix is known to have negative eigenvalues: where it was solved directly,
        from negative pivots of LDL^T, or a negative determinant by LU (an odd number of them)."""
        if self._factorized != self._matrix.stateGet() or self._direct is None:
            return False
        if self._direct_options.get("pc_factor_mat_solver_type") != "mumps":
            return False
        factors = self._direct.getPC().getFactorMatrix()
        if self._direct_options["pc_type"] == "cholesky":
            return factors.getMumpsInfog(12) > 0
        return factors.getMumpsRinfog(12) < 0

    @property
    def chosen(self) -> PETSc.KSP | None:
        """The configured KSP; None before the first solve of a direct one."""
        return self._direct if self._krylov is None else self._krylov

    def free(self) -> None:
        """Free the PETSc objects; collective."""
        for ksp in (self._krylov, self._direct, self._refined):
            if ksp is not None:
                destroy(ksp)
        if self._copy is not None:
            self._copy.destroy()
        if self._matrix.getSize()[0] >= RETURNED:
            return_memory()


@contextmanager
def _coarse_products(comm: PETSc.Comm) -> Iterator[None]:
    """P^T.K.P of multigrid as two products, which takes 0.23 s instead of 0.38 s at 42,849
    unknowns.

    PETSc offers it on one rank by an option without prefix; a user's value takes precedence.
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
    """Release factors after a failure, for example with NaN: MUMPS cannot reuse them."""
    if pc.getFailedReason() != PETSc.PC.FailedReason.NOERROR:
        pc.reset()


def refuse_memory(pc: PETSc.PC) -> None:
    """Check for a lack of memory after a factorization; collective."""
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
            f"a factorization of {size} unknowns ran out of memory{told}: use more memory (more "
            "nodes), a coarser mesh away from the interface, or a solver without factors, "
            "SolveOptions(petsc={'ksp_type': 'gmres', 'pc_type': 'gamg'}); if "
            "the estimate of MUMPS is too low, a larger 'mat_mumps_icntl_14'"
        )


def make_ksp(matrix: PETSc.Mat, options: Petsc) -> PETSc.KSP:
    ksp = PETSc.KSP().create(matrix.comm)
    ksp.setOperators(matrix)
    set_options(ksp, options)
    return ksp


def set_options(item: PETSc.KSP | PETSc.SNES, options: Petsc) -> None:
    """Configure a PETSc object by options without prefix.

    They stay in PETSc's database under a prefix of the object, since parts created later, such as
    factors or smoothers, read them on first use. :func:`destroy` removes them.
    """
    prefix = f"vmdg_{next(_numbers)}_"
    database = PETSc.Options(prefix)
    for name, value in options.items():
        database[name] = value
    item.setOptionsPrefix(prefix)
    with refused_in_words(options):
        item.setFromOptions()


#: Error codes of PETSc for options: a value out of range or not allowed, an unknown type, a missing
#: solver package.
_REFUSALS = (62, 63, 83, 86, 92)

#: Known types by the end of the name of an option.
_TYPES = {
    "ksp_type": PETSc.KSP.Type,
    "pc_type": PETSc.PC.Type,
    "mat_solver_type": PETSc.Mat.SolverType,
    "snes_type": PETSc.SNES.Type,
}


@contextmanager
def refused_in_words(options: Petsc) -> Iterator[None]:
    """Convert an error of PETSc about an option into one that names it and similar names."""
    try:
        yield
    except PETSc.Error as error:
        if error.ierr not in _REFUSALS:
            raise
        # The last line says what is wrong, the lines before it where.
        said = re.sub(r"-?vmdg_\d+_", "", str(error).splitlines()[-1].partition("] ")[2])
        words = set(re.findall(r"[\w.+-]+", said))
        named = {name: str(value) for name, value in options.items() if str(value) in words}
        if not named:
            raise
        meant = ""
        for name, value in named.items():
            kinds = (of for end, of in _TYPES.items() if name.endswith(end))
            known = {of for kind in kinds for word, of in vars(kind).items() if word.isupper()}
            # A known type of a missing package is not misspelt.
            meant += "" if value in known else near(value, sorted(known))
        given = ", ".join(f"{name} = {value!r}" for name, value in named.items())
        raise ValueError(f"SolveOptions: petsc: {given}: PETSc says: {said}{meant}") from error


def warn_of_unused(item: PETSc.KSP | PETSc.SNES) -> None:
    """Warn about unused PETSc options after the first solve; collective.

    Not before, since some parts of a preconditioner read their options during a solve, some on one
    rank only. Silent if PetscOptionsUsed of the C library is not accessible.
    """
    if item.getAttr("options asked for"):
        return
    item.setAttr("options asked for", True)
    used = getattr(ctypes.CDLL(PETSc.__file__), "PetscOptionsUsed", None)
    if used is None:
        return
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
            f"SolveOptions: PETSc does not use {', '.join(names)} among the options petsc=: "
            "misspelt, or for a part that this solver does not have; correct or remove them",
        )


def destroy(item: PETSc.KSP | PETSc.SNES) -> None:
    """Destroy an object configured by :func:`set_options`, and its options; collective."""
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
    """Set the near-null space for multigrid: translations and rotations, along z in axisymmetry.

    One set of modes is enough for all bodies, since an aggregate lies in one body, or in several
    connected by ties, see :meth:`.System.solve`. In a periodic cell only translations,
    since rotations cause strain at its boundary.
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
        for other in (*basis, *basis):  # twice, against rounding for distant origins
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
        basis.append(vector)
    matrix.setNearNullSpace(PETSc.NullSpace().create(vectors=basis, comm=matrix.comm))


def return_memory() -> None:
    """Return freed memory to the system, if the C library supports it (glibc).

    Otherwise the pages of freed factors stay with the process, in fragments that may be too small
    for the next ones: the largest resident size of the push-out in 3D was 1136 MiB instead of 764.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
