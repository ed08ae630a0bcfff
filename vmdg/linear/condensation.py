"""Decides from the problem whether systems are condensed to the interface."""

from __future__ import annotations

from ..assembly.means import lattice_of
from ..base.parallel import global_sum
from ..problem.problem import Problem
from .ksp import Petsc, linear_options

#: Squared number of gap components over number of dofs above which the dense capacitance matrix is
#: no longer cheaper than factorizing every tangent, by dimension. In 2D lever tests are at 114 and
#: 228 for facets of 0.5 and 0.25 mm, and 2 and 1.3 times as fast with it; a DCB with 560 facets is
#: at 455 and takes twice as long; the push-out in 3D is at 306. At 600 compact bodies are 2.5 times
#: as fast with multigrid, but thin plies, hard for multigrid, 2.8 times as fast without.
MAX_GAPS_SQUARED = {2: 200, 3: 500}

#: The same for a single predictor, whose cost only a few corrections compensate. Square blocks of
#: degree 3 are at 3.4 and take three quarters of the time of the saved corrections; strips of 100
#: times 12 cells are at 18 and break even.
MAX_CLOSED_SQUARED = 20

#: Dofs in 3D up to which the bodies are factorized.
MAX_CONDENSED = 60_000


def condensation(
    problem: Problem, wanted: bool | None = None, petsc: Petsc | None = None
) -> tuple[bool, str]:
    """Whether systems are condensed to the interface points, and why; collective.

    Args:
        problem: The problem.
        wanted: False never, True wherever possible, None where cheaper.
        petsc: Options of the user's, without prefix.

    Raises:
        ValueError: ``wanted`` is True and the problem does not allow it.
    """
    if wanted is False:
        return False, "options.condensed = False"
    if refusal := _refusal(problem, petsc):
        if wanted:
            raise ValueError(f"SolveOptions: condensed = True is not possible: {refusal}")
        return False, refusal
    n, N = global_sum(problem.comm, [gap_components(problem), problem.discretization.owned])
    if wanted:
        return True, "options.condensed = True"
    if problem.mesh.topology.dim == 3 and N > MAX_CONDENSED:
        return False, f"{N} dofs exceed the limit for factorization in 3D"
    if n * n > MAX_GAPS_SQUARED[problem.mesh.topology.dim] * N:
        return False, f"{n} gap components are too many for {N} dofs"
    return True, f"small strain: {n} gap components for {N} dofs"


def closes_points(problem: Problem, wanted: bool | None = None, petsc: Petsc | None = None) -> bool:
    """Whether the predictor determines closing points with condensed linear bodies; collective.

    Args:
        problem: The problem.
        wanted: As for :func:`condensation`.
        petsc: Options of the user's, without prefix.
    """
    if wanted is False or not problem.discretization.can_fail or _not_by_itself(problem, petsc):
        return False
    n, N = global_sum(problem.comm, [gap_components(problem), problem.discretization.owned])
    few = n * n <= MAX_CLOSED_SQUARED * N
    cheap = few and (problem.mesh.topology.dim == 2 or N <= MAX_CONDENSED)
    return bool(cheap) or condensation(problem, wanted, petsc)[0]


def gap_components(problem: Problem) -> int:
    """Number of gap components on this rank: points of interfaces that can fail times the
    dimension."""
    interfaces = problem.discretization.active.values()
    points = sum(len(c.quadrature.weights) for c in interfaces if c.law.inelastic)
    return points * problem.mesh.geometry.dim


def _refusal(problem: Problem, petsc: Petsc | None) -> str:
    """Why systems of this problem cannot be condensed; empty if they can."""
    if not problem.discretization.bodies.small:
        return "finite strain: the tangent of the bodies changes"
    if not problem.discretization.can_fail:
        return "tied only: the tangent does not change"
    if not problem.discretization.constant_stabilization:
        return "a user-defined stabilization may change"
    if problem.step.activation:
        return "facets open on demand"
    return _not_by_itself(problem, petsc)


def _not_by_itself(problem: Problem, petsc: Petsc | None) -> str:
    """Why bonded bodies cannot be factorized separately; empty if they can."""
    if problem.discretization.bodies.points is not None:
        return "plastic bodies: their tangent changes"
    if problem.discretization.bodies.mean_dilatation:
        return "mean dilatation"
    if problem.discretization.slides:
        return "surfaces that slide"
    if lattice_of(problem.discretization.means) is not None:
        return "periodic cell"
    if problem.discretization.means is not None:
        return "generalized plane strain"
    if not linear_options(problem, petsc).automatic:
        return "options.petsc apply to the assembled tangent"
    return ""
