"""What a user chooses for a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import InitVar, dataclass, field, fields
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from ..base.words import near_keywords
from ..linear.ksp import Petsc

CONTROLS, UNSTABLE = ("auto", "load", "dissipation"), ("jump", "trace")

#: What options may be, in words and as a test.
_SHARE = ("in (0, 1]", lambda value: 0 < value <= 1)
_COUNT = ("a whole number, zero or more", lambda value: value >= 0 and value % 1 == 0)
_POSITIVE = ("positive and finite", lambda value: 0 < value < np.inf)
_SWITCH = ("True or False", lambda value: isinstance(value, bool | np.bool_))
VALUES = {
    "relative_tolerance": _SHARE,
    "max_iterations": _COUNT,
    "max_cuts": _COUNT,
    "control": (f"one of {CONTROLS}", CONTROLS.__contains__),
    "unstable": (f"one of {UNSTABLE}", UNSTABLE.__contains__),
    "max_share": _SHARE,
    "duration": _POSITIVE,
    "cycles": ("zero or positive and finite", lambda value: 0 <= value < np.inf),
    "max_loss": _SHARE,
    "checkpoint_every": ("a whole number, at least 1", lambda value: value >= 1 and value % 1 == 0),
    "petsc": ("a mapping or None", lambda value: isinstance(value, Mapping | None)),
    "path": ("PathOptions(...)", lambda value: isinstance(value, PathOptions)),
    "condensed": ("True, False or None", lambda value: value is None or _SWITCH[1](value)),
    "energy": _SWITCH,
    "verbose": _SWITCH,
    "progress": ("True, False or a number of seconds", lambda value: isinstance(value, Real)),
    "show": ("names of columns or None", lambda value: isinstance(value, Sequence | None)),
}


def _check(options: object, name: str, words: str, fits: Callable[[Any], bool]) -> None:
    """Refuse a value that an option cannot have, of whatever type."""
    value = getattr(options, name)
    try:
        fit = fits(value)
    except TypeError:
        fit = False
    if not fit:
        raise ValueError(f"{type(options).__name__}: {name} = {value!r} must be {words}")


@dataclass(frozen=True, kw_only=True)
class PathOptions:
    """How steps follow the path; all by name. None has a unit.

    Attributes:
        small: What is next to nothing: a residual relative to the largest reaction or load, which
            never may be larger; the work of a step, and that up to which damage only begins,
            relative to the largest of a step; what a limit point may still be off, relative to the
            stage.
        halvings: How often a correction is halved where the parameter alone ends a step, and the
            way to a limit point.
        patience: Corrections after which an attempt is given up if they have hardly lowered the
            residual, jumps at one load factor after which the path is traced, and steps of hardly
            any length after which one goes by load.
        missed: Share of a limit by which a step may miss it, by which a step with cycles stays
            below the loss that is allowed, and of the motion of supports that is not theirs as a
            rigid body, for the body to turn with them.
        aim: Corrections that a step should take; the next one is shorter or longer by that.
        growth: How much longer at most, and how much more than its limit a trial state may break.
        cut: What a failed attempt is cut by, and the least share that the last step may be of a
            first guess that goes on as it did.
        released: Share of its work on bonds that a step may release, and of the stage by which the
            load factor may fall, before that counts as a snap.
        overstress: At the start of a jump, in multiples of H.
        rest: Overstress at which a jump is nearly at rest, and share by which corrections hardly
            lower a residual.
        drag: On bodies in a jump for an overstress of H, relative to the norm of the tangent.
        idle: Steps on which nothing breaks and that come no nearer to their target before a run, or
            a jump, is given up.

    Raises:
        ValueError: a number is not positive and finite.
    """

    small: float = 1e-6
    halvings: int = 8
    patience: int = 3
    missed: float = 0.1
    aim: int = 4
    growth: float = 2.0
    cut: float = 0.25
    released: float = 0.05
    overstress: float = 4.0
    rest: float = 0.02
    drag: float = 1e-3
    idle: int = 100

    def __post_init__(self) -> None:
        for one in fields(self):
            _check(self, one.name, *_POSITIVE)

    def growth_after(self, corrections: int) -> float:
        """How much longer the next step may be, by the corrections that the last one took."""
        return min(self.aim / max(corrections, 1), self.growth)


@near_keywords(
    rtol="relative_tolerance",
    snes_rtol="relative_tolerance",
    tolerance="relative_tolerance",
    tol="relative_tolerance",
    max_it="max_iterations",
    snes_max_it="max_iterations",
    maxiter="max_iterations",
    solver_options="petsc",
)
@dataclass(frozen=True, kw_only=True)
class SolveOptions:
    """How to step; all by name.

    Attributes:
        relative_tolerance: Residual norm relative to the largest force the run has seen; it never
            exceeds 1e-6 of the largest reaction or load.
        max_iterations: Newton corrections before a step is cut.
        max_cuts: Attempts of a step that may fail.
        control: What leads a run. "auto" goes from one given load factor to the next, and where
            this does not lead to an equilibrium while bonds break, by the work on bonds: rows of
            the equilibrium path, whose load factors may fall. Given load factors are met exactly
            where the path passes them for the first time. "dissipation" does so from the start,
            "load" never. Stages in which loads or eigenstrains are not linear in the load factor,
            or laws are viscous, go by load factors.
        unstable: At a limit point behind which the load factor falls by more than a given step:
            "jump" goes to the next equilibrium at that load, as a test machine does, and counts
            what is released as viscosity; "trace" follows the path back. Smaller snaps, of points
            that break one by one, are always traced. Stages that go by load factors jump where the
            smallest attempt has failed, not with ``control="load"``.
        max_share: Share of all bonds that a step of the path breaks at most: with less a row lies
            nearer to a peak, and the error of laws that depend on the way falls in first order.
        duration: Time for one unit of load factor [s]; matters to laws with viscosity only.
        cycles: Cycles of the load for one unit of load factor, which :class:`vmdg.FatigueDebonding`
            feels; 0 for none: the monotonic law. Loads are the largest ones of a cycle. Such a run
            goes by load factors.
        max_loss: Share of its strength that a point loses at most in a step with cycles; steps are
            as long as that allows.
        petsc: Options for SNES, KSP and PC, without prefix. Default: a backtracking line search
            under load control, full steps where the work on bonds is given, and the linear solver
            of :func:`vmdg.linear.ksp.automatic_options`. What PETSc does not use is warned of.
        petsc_options: Another name of ``petsc``, that of DOLFINx.
        path: How steps follow the path, see :class:`PathOptions`.
        condensed: Solve the systems of a problem of small strain by factors of its linear bodies,
            made once, and a dense matrix of the gaps at the interface points, see
            :mod:`vmdg.linear.capacitance`: None where that is possible and cheaper, False never,
            True wherever it is possible, see :mod:`vmdg.linear.condensation`.
        energy: Add the energies of every step to the history. At finite strain the external work
            of every step is then integrated accurately, which costs one or more residuals a step.
        progress: Show a progress bar and the summary of the run (rank 0): load factor, size,
            iterations of the step, forces, share of the interfaces that is debonded, and with
            ``energy`` the imbalance relative to the largest work put in. A number is the time
            between two states of the bar [s].
        show: Names of the columns of the history that the bar shows as forces; None for the first
            three called force or reaction, alone or with more words ("force_x").
        verbose: Print what leads every attempt of a step, its residual norms, Krylov iterations and
            why it fails, and the summary (rank 0); ``petsc={"snes_monitor": None}`` tells more.
        csv: File for the history, written while the run goes on: a row that is complete is on the
            disk. Rows of an earlier run that ``history`` does not have are dropped.
        checkpoint: Folder for a checkpoint of the run, see :func:`vmdg.read_checkpoint`.
        checkpoint_every: Steps between two checkpoints: one is written at the first of the given
            load factors that is reached after so many, and at the end of the run.

    Raises:
        ValueError: both ``petsc`` and ``petsc_options`` are given, or an option is none of its
            values.
    """

    relative_tolerance: float = 1e-9
    max_iterations: int = 20
    max_cuts: int = 6
    control: str = "auto"
    unstable: str = "jump"
    max_share: float = 0.1
    duration: float = 1.0
    cycles: float = 0.0
    max_loss: float = 0.2
    petsc: Petsc | None = None
    petsc_options: InitVar[Petsc | None] = None
    path: PathOptions = field(default_factory=PathOptions)
    condensed: bool | None = None
    energy: bool = False
    progress: bool | float = False
    show: Sequence[str] | str | None = None
    verbose: bool = False
    csv: str | Path | None = None
    checkpoint: str | Path | None = None
    checkpoint_every: int = 10

    def __post_init__(self, petsc_options: Petsc | None) -> None:
        for name, (words, fits) in VALUES.items():
            _check(self, name, words, fits)
        if petsc_options is None:
            return
        if self.petsc is not None:
            raise ValueError("SolveOptions: petsc and petsc_options are the same; give one of them")
        object.__setattr__(self, "petsc", petsc_options)
