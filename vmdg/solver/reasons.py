"""Why steps fail, in words, and what helps: the texts of StepFailure and of the guide."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple


class Reason(NamedTuple):
    """Why a step was given up.

    Attributes:
        happened: A main clause.
        helps: Options and modelling choices, from what is tried first.
    """

    happened: str
    helps: str


_SMALLER = "smaller steps (more load factors, SolveOptions(max_cuts=12))"
_RESIDUAL = (
    f"{_SMALLER}; where the force has a peak, prescribed displacements in place of forces and "
    "SolveOptions(control='auto'), the default; a mesh that is finer along the interface, or a "
    "larger critical gap (energy) of the bond, so that fewer points break at once"
)
_BROKEN = (
    f"{_SMALLER}; supports for every body that nothing holds once its bond is gone "
    "(problem.spring will do); no mesh that is badly distorted where strains are largest"
)
_USER = "the PETSc options given to SolveOptions(petsc=...): leave them out, or allow more"

#: By the word of the attempt: those of PETSc keep its names.
REASONS = {
    "DIVERGED_MAX_IT": Reason(
        "Newton's method found no equilibrium within the corrections that it may take",
        f"SolveOptions(max_iterations=40) where the residuals still fall; {_RESIDUAL}",
    ),
    "DIVERGED_LOCAL_MIN": Reason(
        "Newton's method came to a stop where forces do not balance: there may be no equilibrium "
        "near, or points change to and fro between open and closed, held and sliding",
        _RESIDUAL,
    ),
    "DIVERGED_LINE_SEARCH": Reason(
        "no step along Newton's correction, however short, made the forces balance better",
        _RESIDUAL,
    ),
    "DIVERGED_FNORM_NAN": Reason(
        "the forces of a trial state are far too large, or no numbers: cells turned inside out, a "
        "body flew away, or the tangent was singular",
        _BROKEN,
    ),
    "CELLS_INVERTED": Reason(
        "forces balance, but with cells turned inside out (det F <= 0)",
        f"{_SMALLER}; larger or better shaped cells where strains are largest (notches, crack "
        "tips); a bond that gives way before the bodies are crushed",
    ),
    "STABILIZATION_OUTGROWN": Reason(
        "the step ends where its tau_s no longer holds the interface, and steps done again with "
        "the tau_s of their end did so too: strains at the interface change much in one step",
        f"{_SMALLER}; a finer mesh along the interface; lower compression of the cells at it",
    ),
    "JUMPED": Reason(
        "the step passed a snap: it released energy that no equilibrium accounts for",
        f"SolveOptions(control='dissipation'), which follows the path; {_SMALLER}",
    ),
    "UNSTABLE": Reason(
        "forces balance, but a body would leave this state by itself: it buckles, or came free",
        f"a small imperfection (load, eigenstrain); supports where bodies come free; {_SMALLER}",
    ),
    "PROGRAMME_LEFT": Reason(
        "the path led back to load factors for which other loads were given",
        "a small imperfection, a load or an eigenstrain, with which the path does not turn back; "
        f"{_SMALLER}; loads as straight before these load factors as behind them, if the way back "
        "is wanted",
    ),
    "WORN": Reason(
        "cycles wear a point by more than a step may, however few they are: the crack grows by "
        "itself at this load",
        "SolveOptions(unstable='jump'), the default; a larger max_loss, 1 at most; fewer cycles",
    ),
    "NO_END": Reason(
        "the displacement leads, nothing breaks, and the load factor does not come to where it is "
        "to go: nothing may be left that bears a larger load",
        "prescribed displacements in place of forces; until= of vmdg.solve, which ends the run; "
        "supports or problem.spring for bodies that come free",
    ),
    "JUMP_FAILED": Reason(
        "the load has no equilibrium near, and the jump to the next one came to none: nothing may "
        "be left that bears the load, or too much moves at once",
        "prescribed displacements in place of forces; supports or problem.spring for bodies that "
        "come free; SolveOptions(unstable='trace') to follow the path back",
    ),
}

#: What else PETSc may say, by options of the user.
_OTHER = Reason("Newton's method was given up", _USER)


def reason(text: str) -> Reason:
    """The reason that an attempt names.

    Args:
        text: Of `StepReport.reason`: a word of PETSc or of a step, perhaps with more behind it, or
            a sentence of its own, which says what helps.
    """
    word = text.partition(" ")[0]
    if word in REASONS:
        return REASONS[word]
    return _OTHER if re.fullmatch(r"[A-Z_]+|-?\d+", word) else Reason(text, "")


def explained(attempts: Sequence[str]) -> str:
    """Sentences for a step that has failed: what happened, from the last attempt on, what helps.

    Args:
        attempts: Reasons of its attempts.
    """
    told = []
    for text in dict.fromkeys(reversed(attempts)):
        times = attempts.count(text)
        told.append(f"{reason(text).happened} ({text}{f', {times} times' if times > 1 else ''})")
    others = f"; before, {'; '.join(told[1:])}" if told[1:] else ""
    helps = reason(attempts[-1]).helps
    return f"{told[0]}{others}" + (f". What helps: {helps}" if helps else "")
