"""What a problem uses and what it can do without, found out from the problem itself."""

from __future__ import annotations

from typing import NamedTuple

from ..base.parallel import global_sum
from ..laws.base import is_number
from ..problem.problem import Problem
from .linear import Petsc, is_iterative, linear_options
from .options import SolveOptions

#: Squared number of gap components over that of the dofs beyond which the capacitance matrix, which
#: is dense, is no longer cheaper than factors of every tangent, by dimension. A DCB with 560 facets
#: has 455, and takes twice as long with it; the push-out in 3D has 306. With 600 compact bodies are
#: 2.5 times as fast by multigrid; thin plies, which it finds hard, are 2.8 times as fast without.
MAX_GAPS_SQUARED = {2: 100, 3: 500}

#: Dofs in 3D up to which the bodies are factorized.
MAX_CONDENSED = 60_000


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


def switchboard(problem: Problem, options: SolveOptions | None = None) -> list[Switch]:
    """The features a run of ``problem`` uses and those it spares, with reasons; collective.

    Args:
        problem: With its interfaces, and the facets that are open now.
        options: Of the solver; None for the default.

    Raises:
        ValueError: ``options.condensed`` is True and the problem does not allow it.
    """
    parts = problem.discretization
    interfaces = parts.active.values()
    tied = sum(not active.law.inelastic for active in interfaces)
    failing = (
        problem.discretization.can_fail,
        "an interface can fail" if problem.discretization.can_fail else "tied only",
    )
    rubbing = any(not is_number(active.law.friction, 0.0) for active in interfaces)
    turning = any(active.turns for active in interfaces)
    small, constant = problem.discretization.bodies.small, parts.constant_stabilization
    condensed, why = condensation(problem, options)
    linear = linear_options(problem, options.petsc if options is not None else None)
    solver = _name(linear.solver) if linear.automatic else "options.petsc"
    if condensed:
        solver = "LDL^T of the bonded bodies, once; dense at the interface"
    still = "small strain" if small else 'tied, or frame="reference"'
    return [
        Switch("history and return map", *failing),
        Switch("damage tangent", *failing),
        Switch("tensor tau_s", tied > 0, f"{tied} of {len(interfaces)} interfaces are ties"),
        Switch("friction", rubbing, "in a law" if rubbing else "in no law"),
        Switch(
            "unsymmetric tangent",
            not problem.discretization.symmetric,
            "by the laws of the interfaces",
        ),
        Switch("turning frame", turning, "finite strain" if turning else still),
        Switch("terms K of (85)", not small, "the moduli are constant" if small else "slip"),
        Switch("tau_s every step", not constant, "once: small strain" if constant else "moduli"),
        Switch("bodies assembled", not condensed, "once" if condensed else "for every tangent"),
        Switch("condensed to interface", condensed, why),
        Switch("linear solver", True, solver),
    ]


def _name(linear: Petsc) -> str:
    kind = {"lu": "LU", "cholesky": "LDL^T", "gamg": "multigrid"}[linear["pc_type"]]
    return f"{linear['ksp_type'].upper()} with {kind}" if is_iterative(linear) else kind


def condensation(problem: Problem, options: SolveOptions | None = None) -> tuple[bool, str]:
    """Whether systems are condensed to the interface points, and why; collective.

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
    n, N = global_sum(problem.comm, [gap_components(problem), problem.discretization.owned])
    if wanted:
        return True, "options.condensed = True"
    if problem.mesh.topology.dim == 3 and N > MAX_CONDENSED:
        return False, f"{N} dofs are more than are factorized in 3D"
    if n * n > MAX_GAPS_SQUARED[problem.mesh.topology.dim] * N:
        return False, f"{n} gap components are too many for {N} dofs"
    return True, f"small strain: {n} gap components for {N} dofs"


def gap_components(problem: Problem) -> int:
    """Points of interfaces that can fail times the dimension, of this rank."""
    interfaces = problem.discretization.active.values()
    points = sum(len(c.quadrature.weights) for c in interfaces if c.law.inelastic)
    return points * problem.mesh.geometry.dim


def _refusal(problem: Problem, options: SolveOptions | None) -> str:
    """Why condensed systems do not serve this problem, or nothing."""
    if not problem.discretization.bodies.small:
        return "finite strain: the tangent of the bodies changes"
    if not problem.discretization.can_fail:
        return "tied only: the tangent does not change"
    if problem.discretization.bodies.mean_dilatation:
        return "mean dilatation"
    if not problem.discretization.constant_stabilization:
        return "a stabilization of the user's own may change"
    if problem.step.activation:
        return "facets open on demand"
    if problem.loading.rigid:
        return "rigid faces"
    if problem.discretization.periodic is not None:
        return "periodic cell"
    if options is not None and not linear_options(problem, options.petsc).automatic:
        return "options.petsc are for the assembled tangent"
    return ""
