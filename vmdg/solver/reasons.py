"""Reasons of failed steps and remedies: the texts of StepFailure and of the guide."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple


class Reason(NamedTuple):
    """Why a step failed."""

    happened: str
    helps: str  # Options and modelling choices, in the order to try them


_SMALLER = "smaller steps (more load factors, SolveOptions(max_cuts=12))"
_RESIDUAL = (
    f"{_SMALLER}; if the force has a peak, prescribed displacements instead of forces and "
    "SolveOptions(control='auto'), the default; a finer mesh along the interface, or a larger "
    "critical gap (energy) of the bond, so that fewer points break at once; bodies that overlap "
    "deeply at the start held apart by a support, whose motion brings them together"
)
_BROKEN = (
    f"{_SMALLER}; supports for every body that is unconstrained once its bond is broken "
    "(problem.spring is sufficient); a less distorted mesh where strains are largest"
)
_USER = "the PETSc options in SolveOptions(petsc=...): omit them, or relax them"

#: By the reason of the attempt; PETSc's reasons keep their names.
REASONS = {
    "DIVERGED_MAX_IT": Reason(
        "Newton's method did not converge within the maximum number of corrections",
        f"SolveOptions(max_iterations=40) where the residuals still fall; {_RESIDUAL}",
    ),
    "DIVERGED_LOCAL_MIN": Reason(
        "Newton's method stagnated without force balance: there may be no equilibrium nearby, or "
        "points alternate between open and closed, sticking and sliding",
        _RESIDUAL,
    ),
    "DIVERGED_LINE_SEARCH": Reason(
        "no step along Newton's correction, however short, reduced the residual",
        _RESIDUAL,
    ),
    "DIVERGED_FNORM_NAN": Reason(
        "the forces of a trial state are far too large or not finite: inverted cells, a body that "
        "moved far away, or a singular tangent, as of a body without stiffness: a cone of "
        "vmdg.DruckerPrager at its apex that does not harden",
        f"{_BROKEN}; hardening= of a cone that comes to its apex",
    ),
    "MATERIAL_NOT_FINITE": Reason(
        "a material has no finite stress or moduli in a trial state: a mistake in it, or strains "
        "that are far too large",
        f"{_BROKEN}; a material that answers for any det F > 0",
    ),
    "CELLS_INVERTED": Reason(
        "forces balance, but with inverted cells (det F <= 0)",
        f"{_SMALLER}; larger or better shaped cells where strains are largest (notches, crack "
        "tips); a bond that fails before the bodies are crushed",
    ),
    "BODIES_OVERLAP": Reason(
        "forces balance, but a body that slides has moved through the surface of the other one, or "
        "is inside it where no facet faces it within 60 degrees",
        f"{_SMALLER}; blunter edges of the bodies",
    ),
    "STABILIZATION_OUTGROWN": Reason(
        "tau_s is too small at the end of the step, also after repetitions with the tau_s of the "
        "end: strains at the interface change too much in one step",
        f"{_SMALLER}; a finer mesh along the interface; lower compression of the cells at it",
    ),
    "JUMPED": Reason(
        "the step passed a snap: it released energy off the equilibrium path",
        f"SolveOptions(control='dissipation'), which follows the path; {_SMALLER}",
    ),
    "UNSTABLE": Reason(
        "forces balance, but the state is unstable: a body buckles, or is detached",
        f"a small imperfection (load, eigenstrain); supports for detached bodies; {_SMALLER}",
    ),
    "PROGRAMME_LEFT": Reason(
        "the path returned to load factors with other loads",
        "a small imperfection, a load or an eigenstrain, with which the path does not return; "
        f"{_SMALLER}; loads that are linear also before these load factors, if the return is "
        "intended",
    ),
    "TURNED_BACK": Reason(
        "the step went back the way that the path had come: bonds that were breaking unload",
        _SMALLER,
    ),
    "WORN": Reason(
        "the loss of strength by cycles exceeds max_loss, however few they are: the crack grows by "
        "itself at this load",
        "SolveOptions(unstable='jump'), the default; a larger max_loss, 1 at most; fewer cycles",
    ),
    "STILL_CRACKING": Reason(
        "the damage of the bodies has not converged in the passes of a step, or PETSc found none",
        f"SolveOptions(path=vmdg.PathOptions(passes=10000)) where a crack runs far; {_SMALLER}; "
        "prescribed displacements instead of forces",
    ),
    "NO_END": Reason(
        "under arc-length control nothing breaks, and the load factor does not reach its target: "
        "there may be no structure left to carry a larger load",
        "prescribed displacements instead of forces; until= of vmdg.solve, which ends the run; "
        "supports or problem.spring for detached bodies",
    ),
    "JUMP_FAILED": Reason(
        "there is no equilibrium nearby at this load, and the jump found none: there may be no "
        "structure left to carry the load, or too much moves at once",
        "prescribed displacements instead of forces; supports or problem.spring for detached "
        "bodies; SolveOptions(unstable='trace') to follow the path back",
    ),
}

_SHORTER = "shorter steps (more times, SolveOptions(max_cuts=12))"
_CRUSHED = (
    "larger or better shaped cells where strains are largest; a bond that fails before the bodies "
    "are crushed; a lower speed of supports, or loads that grow more slowly"
)

#: Of runs in time, where these have other remedies.
IN_TIME = {
    "DIVERGED_MAX_IT": Reason(
        "the corrections of a step did not converge: of Newton's method, or of nodes in contact",
        f"{_SHORTER}; SolveOptions(max_iterations=40) where the residuals still fall; a smaller "
        "safety of CentralDifferences; vmdg.Rayleigh(beta=) where friction makes a body vibrate",
    ),
    "DIVERGED_LOCAL_MIN": Reason(
        "Newton's method stagnated without force balance: points may alternate between open and "
        "closed, sticking and sliding",
        f"{_SHORTER}; vmdg.CentralDifferences(), which needs no Newton's method",
    ),
    "DIVERGED_LINE_SEARCH": Reason(
        "no step along Newton's correction, however short, reduced the residual",
        f"{_SHORTER}; vmdg.CentralDifferences(), which needs no Newton's method",
    ),
    "DIVERGED_FNORM_NAN": Reason(
        "the forces of a trial state are far too large or not finite: inverted cells, or a load "
        "that throws a body away",
        f"{_SHORTER}; {_CRUSHED}",
    ),
    "CELLS_INVERTED": Reason("cells are inverted (det F <= 0)", f"{_SHORTER}; {_CRUSHED}"),
    "BODIES_OVERLAP": Reason(
        "a body that slides has moved into the other one, past its surface",
        f"{_SHORTER}; larger facets at the surfaces, which are paired across two of their radii",
    ),
    "STABILIZATION_OUTGROWN": Reason(
        "tau_s is too small at the end of the step: strains at the interface change too much in it",
        f"{_SHORTER}; a finer mesh along the interface; lower compression of the cells at it",
    ),
    "ENERGY_GAINED": Reason(
        "kinetic and stored energy grew by more than the work of loads and supports: the step is "
        "too long for what happens in it, such as an impact, a snap or a large rotation",
        f"{_SHORTER}; a smaller safety or renewal of CentralDifferences; where a corner slides "
        "past nodes of the other surface, larger facets there, of a rigid wall a single one",
    ),
    "ENERGY_LOST": Reason(
        "the scheme lost more than 1 % of the energy where surfaces met or parted: the step is too "
        "long for that",
        _SHORTER,
    ),
    "STEP_VANISHES": Reason(
        "steps are shorter than the longest critical one so far over 2^max_cuts",
        f"{_CRUSHED}; SolveOptions(max_cuts=12)",
    ),
}

#: Other reasons of PETSc, due to user options.
_OTHER = Reason("Newton's method was stopped", _USER)


def reason(text: str, in_time: bool = False) -> Reason:
    """The reason that an attempt names.

    Args:
        text: `Attempt.reason`: a reason of PETSc or of a step, possibly with details, or a complete
            sentence with its remedy.
    """
    word = text.partition(" ")[0]
    if in_time and word in IN_TIME:
        return IN_TIME[word]
    if word in REASONS:
        return REASONS[word]
    return _OTHER if re.fullmatch(r"[A-Z_]+|-?\d+", word) else Reason(text, "")


def explained(attempts: Sequence[str], in_time: bool = False) -> str:
    """Message for a failed step: what happened, from the last attempt backwards, and what helps."""
    told = []
    for text in dict.fromkeys(reversed(attempts)):
        times = attempts.count(text)
        told.append(
            f"{reason(text, in_time).happened} ({text}{f', {times} times' if times > 1 else ''})"
        )
    others = f"; before, {'; '.join(told[1:])}" if told[1:] else ""
    # Steps vanish by what has made them shorter.
    causes = [text for text in attempts if text != "STEP_VANISHES"] or attempts
    helps = reason(causes[-1], in_time).helps
    return f"{told[0]}{others}" + (f". What helps: {helps}" if helps else "")
