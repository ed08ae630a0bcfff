"""What a user chooses for a run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass
from pathlib import Path


Petsc = Mapping[str, str | int | float | bool | None]


@dataclass(frozen=True, kw_only=True)
class SolveOptions:
    """How to step; all by name.

    Attributes:
        relative_tolerance: Residual norm relative to the largest force the run has seen; it never
            exceeds 1e-6 of the largest reaction or load.
        max_iterations: Newton corrections before a step is cut.
        max_cuts: How often a step may be halved.
        jump: Where cutting does not help, pass an unstable stage by steps with viscous overstress
            at constant load that end in an equilibrium without it. What they dissipate is counted
            as viscosity.
        jump_after: Cuts of a step before a jump is tried: the load at which the stage starts is
            met to ``step / 2**jump_after``.
        max_jump_steps: Steps with overstress before a jump is given up.
        jump_rest: Largest overstress, relative to the strength, at which the end of a jump is
            tried without it.
        predictor: How a step starts: "path" extrapolates the last states where that is good and
            else does as "tangent", the tangent with the damage of the last state; "elastic" holds
            the damage.
        duration: Time for one unit of load factor [s]; matters to laws with viscosity only.
        petsc: Options for SNES, KSP and PC, without prefix. Default: a backtracking line search and
            the linear solver of :func:`vmdg.solver.linear.automatic_options`.
        petsc_options: Another name of ``petsc``, that of DOLFINx.
        condensed: Iterate on the gaps at the interface points alone, the linear bodies of a problem
            of small strain condensed to them: None where that is possible and cheaper, False never,
            True wherever it is possible, see :mod:`vmdg.solver.features`.
        energy_guard: Reject a step that ends in a distant equilibrium: one whose stored and
            dissipated energy exceed what was there and the work put in by more than this share of
            the work seen so far (for example 0.05). Off by default: a coarse step over a peak of
            the force misses some of the work by itself.
        energy: Add the energies of every step to the history.
        progress: Show a progress bar and the summary of the run (rank 0): load factor, size,
            iterations of the step, forces, share of the interfaces that is debonded, and with
            ``energy`` the imbalance relative to the largest work put in. A number is the time
            between two states of the bar [s].
        show: Names of the columns of the history that the bar shows as forces; None for the first
            three called force or reaction, alone or with more words ("force_x").
        verbose: Print the residual norms of every step, with the ratio to the norm before, the
            residuals the line search has tried, Krylov iterations and their tolerance, why steps
            fail, and the summary (rank 0).
        csv: File for the history, written while the run goes on: a row that is complete is on the
            disk. Rows of an earlier run that ``history`` does not have are dropped.
        checkpoint: Folder for a checkpoint of the run, see :func:`vmdg.read_checkpoint`.
        checkpoint_every: Steps between two checkpoints: one is written at the first of the given
            load factors that is reached after so many, and at the end of the run.

    Raises:
        ValueError: both ``petsc`` and ``petsc_options`` are given.
    """

    relative_tolerance: float = 1e-9
    max_iterations: int = 10
    max_cuts: int = 6
    jump: bool = True
    jump_after: int = 2
    max_jump_steps: int = 200
    jump_rest: float = 0.1
    control: str = "auto"
    unstable: str = "jump"
    duration: float = 1.0
    petsc: Petsc | None = None
    petsc_options: InitVar[Petsc | None] = None
    condensed: bool | None = None
    energy_guard: float = math.inf
    energy: bool = False
    progress: bool | float = False
    show: Sequence[str] | str | None = None
    verbose: bool = False
    csv: str | Path | None = None
    checkpoint: str | Path | None = None
    checkpoint_every: int = 10

    def __post_init__(self, petsc_options: Petsc | None):
        if petsc_options is None:
            return
        if self.petsc is not None:
            raise ValueError("SolveOptions: petsc and petsc_options are the same; give one of them")
        object.__setattr__(self, "petsc", petsc_options)
