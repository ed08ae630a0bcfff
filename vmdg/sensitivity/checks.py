"""What has derivatives by parameters, checked before a run."""

from __future__ import annotations

from typing import Protocol

from ..problem.problem import Problem


class _Options(Protocol):
    """What matters of the options of a run."""

    checkpoint: object


def check_differentiable(problem: Problem, options: _Options, resumed: bool) -> None:
    """Refuse a run that cannot be differentiated.

    Raises:
        ValueError: it cannot; the message says why, and what to do.
    """
    discretization, reason = problem.discretization, None
    if discretization.bodies.points is not None:
        reason = "a body at points such as J2 has a history of its own; use NeoHookean or another"
    elif discretization.means is not None:
        reason = "a periodic cell and generalized plane strain have unknown means; use a body"
    elif problem.step.activation:
        reason = "facets that open on demand change the unknowns; use activate='all'"
    elif discretization.slides:
        reason = "pairs of facets that slide change in every iteration; use sliding=False"
    elif any(interface.law.fatigues for interface in problem.interfaces):
        reason = "the cycles of a step follow its damage; use a law without fatigue"
    elif discretization.surface.fluids:
        reason = "the fluid between crack faces follows the bond; use tractions on a boundary"
    elif options.checkpoint is not None or resumed:
        reason = "they are not in checkpoints and histories; run it whole, without checkpoint="
    if reason is not None:
        raise ValueError(f"solve: derivatives are not available here: {reason}")
