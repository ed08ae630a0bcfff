"""What a problem uses and what it can do without, found out from the problem itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from .linear_solver import LARGE, automatic_options
from .problem import Problem

if TYPE_CHECKING:
    from .solver import SolveOptions

#: Components of gaps n against dofs N beyond which the condensed iteration, with dense matrices, is
#: no longer cheaper: n^2 < CHEAPER N. The push-out in 3D has 306, a mesh of which every facet is an
#: interface thousands.
CHEAPER = 500


class Switch(NamedTuple):
    """One feature of a run.

    Attributes:
        name: What it is.
        on: Whether the run uses it.
        reason: Why, or what takes its place.
    """

    name: str
    on: bool
    reason: str


def switches(problem: Problem, options: SolveOptions | None = None) -> list[Switch]:
    """The features a run of ``problem`` uses and those it spares, with reasons; collective.

    Args:
        problem: With its interfaces, and the facets that are open now.
        options: Of the solver; None for the default.

    Raises:
        ValueError: ``options.condensed`` is True and the problem does not allow it.
    """
    working = problem.discretization.working
    failing = problem.can_fail
    small = problem.small_strain
    tied = sum(not coupling.law.inelastic for coupling in working)
    rubbing = any(coupling.law.friction > 0 for coupling in working)
    turning = any(coupling.turns for coupling in working)
    condensed, why = condensation(problem, options)
    solver = automatic_options(problem)[0]
    kind = {"lu": "LU", "cholesky": "LDL^T", "gamg": "multigrid"}[solver["pc_type"]]
    if solver["ksp_type"] != "preonly":
        kind = f"{solver['ksp_type'].upper()} with {kind}"
    if options is not None and options.petsc is not None:
        kind = "by the options given"
    if condensed:
        kind = "LDL^T of the bonded bodies, once"
    tangent = "small strain: constant" if condensed else "follows the displacement"
    if small and not condensed:
        tangent = "small strain, but the interfaces change it"
    return [
        Switch(
            "history and return map", failing, _by(failing, "an interface can fail", "tied only")
        ),
        Switch("damage tangent", failing, _by(failing, "an interface can fail", "tied only")),
        Switch("tensor tau_s", tied > 0, f"{tied} of {len(working)} interfaces are ties"),
        Switch("friction", rubbing, _by(rubbing, "a law has friction", "no law has friction")),
        Switch(
            "symmetric solver", problem.symmetric, _by(problem.symmetric, "no friction", "friction")
        ),
        Switch("turning frame", turning, _by(turning, "finite strain", _still(small))),
        Switch("terms K of slip", not small, _by(small, "small strain: A is constant", "slip")),
        Switch(
            "tau_s once a step",
            not problem.discretization.constant_stabilization,
            _by(
                problem.discretization.constant_stabilization,
                "small strain: once a run",
                "follows the moduli",
            ),
        ),
        Switch("bodies assembled anew", not condensed, tangent),
        Switch("condensed to the interface", condensed, why),
        Switch("linear solver", True, kind),
    ]


def _by(condition: bool, one: str, other: str) -> str:
    return one if condition else other


def _still(small: bool) -> str:
    return "small strain" if small else 'tied, or frame="reference"'


def condensation(problem: Problem, options: SolveOptions | None = None) -> tuple[bool, str]:
    """Whether steps are condensed to the interface points, and why; collective.

    Args:
        problem: The problem.
        options: ``condensed`` False never, True wherever it is possible, None where it is cheaper.

    Raises:
        ValueError: ``options.condensed`` is True and the problem does not allow it.
    """
    wanted = None if options is None else options.condensed
    if wanted is False:
        return False, "options.condensed = False"
    if refusal := _refusal(problem, options):
        if wanted:
            raise ValueError(f"SolveOptions: condensed = True is not possible: {refusal}")
        return False, refusal
    n, N = gap_components(problem), problem.discretization.owned
    if wanted:
        return True, "options.condensed = True"
    if problem.mesh.topology.dim == 3 and N > LARGE:
        return False, f"{N} dofs are more than are factorized in 3D"
    if n * n > CHEAPER * N:
        return False, f"{n} gap components are too many for {N} dofs"
    return True, f"small strain: {n} gap components for {N} dofs"


def gap_components(problem: Problem) -> int:
    """Points of interfaces that can fail times the dimension, on this rank."""
    working = problem.discretization.working
    points = sum(len(c.quadrature.weights) for c in working if c.law.inelastic)
    return points * problem.mesh.geometry.dim


def _refusal(problem: Problem, options: SolveOptions | None) -> str:
    """Why the condensed iteration does not serve this problem, or nothing."""
    if not problem.small_strain:
        return "finite strain: the tangent of the bodies changes"
    if not problem.can_fail:
        return "tied only: nothing is left to iterate"
    if problem.comm.size > 1:
        return f"{problem.comm.size} ranks: dense matrices are for one"
    if problem.discretization.condensation is not None:
        return "mean dilatation"
    if not problem.discretization.constant_stabilization:
        return "a stabilization of the user's own may change"
    if problem.opens_on_demand:
        return "facets open on demand"
    if options is not None and options.petsc is not None:
        return "options.petsc are for the whole problem"
    return ""
