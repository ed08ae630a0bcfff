"""User options of a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import InitVar, dataclass, field, fields, replace
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..linear.ksp import Petsc

CONTROLS, UNSTABLE = ("auto", "load", "dissipation"), ("jump", "trace")

#: Valid values of options, as text and as a test.
_SHARE = ("in (0, 1]", lambda value: 0 < value <= 1)
_COUNT = ("an integer >= 0", lambda value: value >= 0 and value % 1 == 0)
_POSITIVE = ("positive and finite", lambda value: 0 < value < np.inf)
_SWITCH = ("True or False", lambda value: isinstance(value, bool | np.bool_))
_PATH = (
    "a path or None",
    lambda value: value is None or (isinstance(value, str | PathLike) and str(value)),
)
VALUES = {
    "relative_tolerance": _SHARE,
    "max_iterations": _COUNT,
    "max_cuts": _COUNT,
    "control": (f"one of {CONTROLS}", CONTROLS.__contains__),
    "unstable": (f"one of {UNSTABLE}", UNSTABLE.__contains__),
    "max_share": _SHARE,
    "duration": ("positive and finite, or None", lambda v: v is None or 0 < v < np.inf),
    "cycles": ("zero or positive and finite", lambda value: 0 <= value < np.inf),
    "max_loss": _SHARE,
    "checkpoint_every": ("an integer >= 1", lambda value: value >= 1 and value % 1 == 0),
    "petsc": (
        "options by name, {'ksp_rtol': 1e-8}, or None",
        lambda value: value is None or all(map(_petsc_option, value.items())),
    ),
    "path": ("PathOptions(...)", lambda value: isinstance(value, PathOptions)),
    "energy": _SWITCH,
    "verbose": _SWITCH,
    "progress": ("True, False or a number of seconds", lambda value: isinstance(value, Real)),
    "show": (
        "names of columns or None",
        lambda value: value is None or all(isinstance(name, str) for name in value),
    ),
    "csv": _PATH,
    "checkpoint": _PATH,
}


def _petsc_option(item: tuple[object, object]) -> bool:
    name, value = item
    return isinstance(name, str) and bool(name) and isinstance(value, str | Real | None)


def _check(options: object, name: str, words: str, fits: Callable[[Any], bool]) -> None:
    value = getattr(options, name)
    try:
        fit = fits(value)
    except (TypeError, ValueError, AttributeError):  # what has no order, or is an array
        fit = False
    if not fit:
        raise ValueError(f"{type(options).__name__}: {name} = {value!r} must be {words}")


def silent(options: Any) -> Any:
    """Options without those that may differ between ranks: what is printed."""
    if not isinstance(options, SolveOptions):
        return options
    return replace(options, progress=False, verbose=False, show=None)


@dataclass(frozen=True, kw_only=True)
class PathOptions:
    """Numerical parameters of path following, keyword only and dimensionless.

    Attributes:
        small: Tolerance for negligible quantities: the largest residual relative to the largest
            reaction or load; the work of a step, and that at the onset of damage, relative to the
            largest of a step; the error of a limit point relative to the stage.
        halvings: Maximum number of trials along a correction at a constant load, and of halvings of
            the interval around a limit point.
        patience: Number of corrections that hardly reduce the residual before an attempt fails, of
            jumps at one load factor before the path is traced, and of negligible steps before one
            under load control.
        missed: Relative tolerance of a limit, relative margin to the allowed loss in a step with
            cycles, and the non-rigid fraction of the motion of supports up to which the body is
            rotated with them.
        aim: Desired number of corrections per step, which controls the size of the next one.
        growth: Largest growth factor of the step size, and of the damage work of a trial state
            relative to its limit.
        cut: Reduction factor of a failed attempt, and the smallest size of the last step relative
            to an extrapolation of it.
        released: Released energy of a step relative to its damage work, and decrease of the load
            factor relative to the stage, above which a snap is detected.
        peak: Excess of a smooth maximum of the force in a step, relative to it, above which it is
            a row.
        twice: Fraction of a strength that may be lost a second time where the load falls and comes
            back, and of the damage work there that friction and flow may take on the way back;
            above it the snap is jumped over.
        overstress: Initial overstress of a jump, in multiples of H.
        rest: Overstress at which a jump is nearly complete, and relative reduction of the residual
            that counts as negligible.
        drag: Viscous resistance of bodies in a jump for an overstress of H, relative to the norm of
            the tangent.
        damage: Largest change of the damage of bodies after the last pass of a step.
        passes: Maximum number of passes of a step in which bodies crack.
        idle: Number of steps without damage or progress towards the target before a run, or a jump,
            fails.

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
    peak: float = 1e-3
    twice: float = 1e-3
    overstress: float = 4.0
    rest: float = 0.02
    drag: float = 1e-3
    damage: float = 1e-4
    passes: int = 1000
    idle: int = 100

    def __post_init__(self) -> None:
        for one in fields(self):
            _check(self, one.name, *_POSITIVE)

    def growth_after(self, corrections: int, slides: bool = False) -> float:
        """Growth factor of the next step.

        Args:
            corrections: Their number in the last step.
            slides: Whether surfaces slide: their corrections converge linearly, however short the
                step.
        """
        return self.growth if slides else min(self.aim / max(corrections, 1), self.growth)


@dataclass(frozen=True, kw_only=True)
class SolveOptions:
    """Options of a run, keyword only.

    Attributes:
        relative_tolerance: Residual norm relative to the largest force of the run so far; never
            more than 1e-6 of the largest reaction or load. The default moves rows by some 1e-6;
            1e-9 is for comparisons to more digits, and for small imperfections.
        max_iterations: Maximum number of Newton corrections before a step is cut.
        max_cuts: Maximum number of step reductions.
        control: Control parameter. "auto" steps from one given load factor to the next and, if this
            finds no equilibrium while bonds break, follows the equilibrium path by the damage work,
            with load factors that may decrease. Given load factors are met exactly when the path
            first passes them. "dissipation" does so from the start, "load" never. Stages with loads
            or eigenstrains nonlinear in the load factor, or with viscous laws, use load control.
        unstable: Treatment of a limit point beyond which the load factor decreases by more than a
            given step: "jump" moves to the next equilibrium at that load, as in a test machine, and
            counts the released energy as viscosity; "trace" follows the path back. Smaller snaps,
            of points that break one by one, are always traced. Under load control a jump follows
            the smallest failed attempt, but not with ``control="load"``.
        max_share: Largest fraction of all bonds broken in a step of the path: smaller values
            resolve peaks better and reduce the first-order error of path-dependent laws.
        duration: Time per unit of load factor [s], 1 s by default; bodies whose stress depends on
            time, as those of :class:`vmdg.Viscoelastic`, need it.
        cycles: Load cycles per unit of load factor, for :class:`vmdg.FatigueDebonding`; 0 for
            monotonic loading. Loads are the maxima of a cycle. Such a run uses load control.
        max_loss: Largest fraction of the strength lost at a point in a step with cycles, which
            determines the step size.
        petsc: Options for SNES, KSP and PC, without prefix. Default: where the load is
            constant, corrections as long as the residual does work along them, otherwise whole
            ones, and the linear solver of :func:`vmdg.linear.ksp.automatic_options`. Unused options
            cause a warning.
        petsc_options: DOLFINx's name for ``petsc``.
        path: Parameters of path following, see :class:`PathOptions`.
        energy: Add the energies of every step to the history. At finite strain the external work
            of every step is then integrated accurately, which costs one or more residuals per step.
        progress: Show a progress bar and the summary of the run (rank 0): load factor, size,
            iterations of the step, forces, share of the interfaces that is debonded, and with
            ``energy`` the imbalance relative to the largest work put in. A number is the update
            interval of the bar [s].
        show: Names of the columns of the history that the bar shows as forces; None for the first
            three called force or reaction, possibly with a suffix ("force_x").
        verbose: Print for every attempt of a step its control, residual norms, Krylov iterations
            and reason of failure, and the summary (rank 0); ``petsc={"snes_monitor": None}`` prints
            more.
        csv: File for the history, written during the run: every completed row is on disk. A file
            that does not begin with the rows of ``history`` is kept: t.csv becomes t.1.csv. The
            run ends with an OSError if the file is removed.
        checkpoint: Folder for a checkpoint of the run, see :func:`vmdg.read_checkpoint`.
        checkpoint_every: Number of steps between checkpoints: one is written at the first given
            load factor reached after that, and at the end of the run.

    Raises:
        ValueError: both ``petsc`` and ``petsc_options`` are given, or an option has an invalid
            value.
    """

    relative_tolerance: float = 1e-6
    max_iterations: int = 20
    max_cuts: int = 6
    control: str = "auto"
    unstable: str = "jump"
    max_share: float = 0.1
    duration: float | None = None
    cycles: float = 0.0
    max_loss: float = 0.2
    petsc: Petsc | None = None
    petsc_options: InitVar[Petsc | None] = None
    path: PathOptions = field(default_factory=PathOptions)
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
        for name in ("csv", "checkpoint"):  # a monitor may change the present folder
            if (path := getattr(self, name)) is not None:
                object.__setattr__(self, name, Path(path).absolute())
        if petsc_options is None:
            return
        if self.petsc is not None:
            raise ValueError("SolveOptions: petsc and petsc_options are the same; give one of them")
        object.__setattr__(self, "petsc", petsc_options)
        _check(self, "petsc", *VALUES["petsc"])
