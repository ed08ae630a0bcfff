"""Features that a run of a problem uses or omits, determined from the problem."""

from __future__ import annotations

from typing import NamedTuple

from ..laws.base import is_number
from ..problem.problem import Problem
from .ksp import Choice, Petsc, is_iterative, linear_options


class Switch(NamedTuple):
    """One feature of a run."""

    name: str
    on: bool
    reason: str


def switchboard(problem: Problem, options: Choice | None = None) -> list[Switch]:
    """The features a run of ``problem`` uses and omits, with reasons; collective.

    Args:
        problem: The problem, with its interfaces and open facets.
        options: As :class:`vmdg.SolveOptions`; None for the default.
    """
    discretization = problem.discretization
    interfaces = discretization.active.values()
    tied = sum(not active.law.inelastic for active in interfaces)
    failing = (
        problem.discretization.can_fail,
        "an interface can fail" if problem.discretization.can_fail else "tied only",
    )
    rubbing = any(not is_number(active.law.friction, 0.0) for active in interfaces)
    turning = any(active.turns for active in interfaces)
    small, constant = problem.discretization.bodies.small, discretization.stabilizers.constant
    petsc = options.petsc if options else None
    linear = linear_options(problem, petsc)
    solver = _name(linear.solver) if linear.automatic else "options.petsc"
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
        Switch("linear solver", True, solver),
    ]


def _name(linear: Petsc) -> str:
    kind = {"lu": "LU", "cholesky": "LDL^T", "gamg": "multigrid"}[linear["pc_type"]]
    return f"{linear['ksp_type'].upper()} with {kind}" if is_iterative(linear) else kind
