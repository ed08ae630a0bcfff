"""Push-out of a fibre, section 7.4: cure shrinkage, debonding, the snap at the peak, and friction.

The matrix shrinks around the fibre, then a punch pushes the fibre's top down by .174 mm while the
bottom of the matrix rests on a plate with a hole. Friction holds the fibre after the bond is gone.
The report does not print its friction coefficient: .525 gives its largest and its final force,
412.2 and 105.5 N, within .3%. Drawn and computed in 3D (a quarter) or as an axisymmetric section.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from mpi4py import MPI

import numpy as np
from helpers.options import run
from helpers.pushout import (
    FIBRE_MODULUS,
    FRICTION,
    STUDIES,
    Levels,
    build,
    curves,
    describe,
    studied,
)
from helpers.restart import files, resumed

import vmdg

END = 0.174  # mm


def main(
    solid: bool = False,
    layers: int = 25,
    refine: float = 1,
    steps: int = 100,
    end: float = END,
    friction: float = FRICTION,
    fibre_modulus: float = FIBRE_MODULUS,
    checkpoint_every: int = 25,
    resume: bool = False,
    plot: bool = True,
    out: str = "results/pushout",
    verbose: bool = False,
    study: Annotated[str | None, STUDIES] = None,
) -> vmdg.History | dict[str, vmdg.History]:
    """Cure the matrix and push the fibre; the history of the push, of a study one by label.

    Args:
        solid: Take a quarter in 3D, not the axisymmetric section.
        layers: Cells along the fibre.
        refine: Factor on all numbers of cells [-].
        steps: Load steps of the punch.
        end: Travel of the punch [mm].
        friction: Coefficient of friction [-].
        fibre_modulus: Young's modulus of the fibre [MPa].
        checkpoint_every: Steps between two checkpoints; 0 for none.
        resume: Go on from the last checkpoint, on any number of ranks.
        plot: Draw the pictures.
        out: Folder for pictures, history and checkpoints.
        verbose: Print the residuals of every step.
        study: Run several moduli or frictions (Figures 30 and 31), meshes or numbers of steps.
    """
    if study:
        given = {"solid": solid, "layers": layers, "refine": refine, "steps": steps, "end": end}
        given |= {"friction": friction, "fibre_modulus": fibre_modulus, "verbose": verbose}
        given |= {"checkpoint_every": checkpoint_every, "resume": resume}
        return studied(main, study, STUDIES[study][2], Path(out), plot, **given)
    model, folder = build(solid, layers, refine, friction, fibre_modulus), Path(out)
    problem, rank = model.problem, MPI.COMM_WORLD.rank
    checkpoint, cure = folder / "checkpoint", folder / "checkpoint_cure"
    if resumed(problem, resume, cure, checkpoint) is None:
        options = vmdg.SolveOptions(relative_tolerance=1e-8, verbose=verbose)
        vmdg.solve(problem, np.linspace(0.25, 1, 4), options)
        if checkpoint_every:
            vmdg.write_checkpoint(problem, cure)
    levels = Levels(model) if plot else None
    problem.dirichlet(model.top, lambda t: 1 - t, model.axis, relative=True)
    history = vmdg.read_checkpoint(problem, checkpoint)
    if levels and history:
        levels.skip(history)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        measured = model.measures(problem)
        if levels:
            levels.update(measured["force [N]"], measured["damaged [mm]"])
        return measured

    loads = 1 + np.linspace(0, end, steps + 1)[1:]
    shown = {"progress": True, "verbose": verbose, "csv": folder / "history.csv"}
    # A looser tolerance spares a sixth of the section's residuals, and nothing in 3D.
    shown["relative_tolerance"] = 1e-9 if solid else 1e-7
    options = vmdg.SolveOptions(**shown, **files(checkpoint, checkpoint_every))
    loads = loads[loads > problem.t + 1e-12]
    history = vmdg.solve(problem, loads, options, monitor, history).history
    figure = levels.draw() if levels else None
    if rank == 0:
        print(describe({"solid" if solid else "section": history}))
        if figure:
            figure.savefig(folder / "pushout_levels.png", dpi=110)
            name = "3D" if solid else "axisymmetric"
            drawn = curves({name: history}, friction, fibre_modulus)
            drawn.savefig(folder / "pushout.png", dpi=130)
        print(f"results are in {folder}")
    return history


if __name__ == "__main__":
    run(main)
