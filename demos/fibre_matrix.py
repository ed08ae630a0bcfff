"""Fibre-matrix debonding with matrix cracks: section 7.2 of the report, Figures 9 to 12.

A square of matrix with a fibre (or many) is pulled apart at its left and right side. The bond of
the fibre fails first, at its poles; cracks leave the interface, which may run along every facet of
the matrix, and grow to the edges until the cell is in two parts. Two equal cracks in a row would
be an unstable equilibrium: the single fibre stands ``offset`` beside the middle and decides.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from mpi4py import MPI

import numpy as np
from helpers.fibre_matrix import DECK, RADIUS, REPORT, SIZE, Cell, build, curves, pulls, report
from helpers.options import run
from helpers.restart import files, resumed

import vmdg
from vmdg.meshes import fibre_matrix, random_fibres
from vmdg.plot import animate as write_film


def main(
    cell: Annotated[str, ("quadrilateral", "triangle")] = "quadrilateral",
    element_size: float = 0.1,
    critical_gap: float = 0.2,
    step: float = 1e-4,
    growth: float = 1.1,
    end: float | None = None,
    fibres: int = 1,
    fraction: float = 0.35,
    offset: float = 0.01,
    activate: Annotated[str, ("all", "on-demand")] = "all",
    interface_only: bool = False,
    deck: bool = False,
    checkpoint_every: int = 10,
    resume: bool = False,
    animate: bool = False,
    out: str = "results/fibre_matrix",
    plot: bool = True,
    verbose: bool = False,
    seed: int = 0,
) -> vmdg.History:
    """Pull both sides; the history of the run.

    Args:
        cell: Type of the cells.
        element_size: Of the cells [mm].
        critical_gap: Residual gap zeta_c at which a bond is gone [mm].
        step: First steps of the pull of a side [mm].
        growth: Ratio of a step to the one before, beyond .003 mm [-].
        end: Pull of a side at which the run ends [mm], if the cell is not in parts before; without
            it where the cell is in parts.
        fibres: Number of fibres; more than one are put at random places.
        fraction: Share of the area that many fibres have [-].
        offset: Distance of a single fibre from the middle [mm].
        activate: Whether facets of the matrix may fail from the start or open on demand.
        interface_only: Without cracks in the matrix.
        deck: Take the moduli of the public one-fibre deck.
        checkpoint_every: Steps between two checkpoints; 0 for none.
        resume: Go on from the last checkpoint, on any number of ranks.
        animate: Make a film of the run, too.
        out: Folder for pictures, history and checkpoints.
        plot: Draw the pictures.
        verbose: Print the residuals of every step.
        seed: Of the random places: the same seed gives the same places.
    """
    centres, radius = np.array([[SIZE / 2 - offset, SIZE / 2]]), RADIUS
    if fibres > 1:
        centres, radius = random_fibres(fibres, fraction, SIZE, seed=seed)
    tagged = fibre_matrix(MPI.COMM_WORLD, cell, SIZE, radius, centres, element_size)
    cracks = None if interface_only else activate
    problem = build(tagged, DECK if deck else REPORT, critical_gap, cracks)
    right = tagged.facet_tags.find("right")

    snapshots: list[vmdg.Snapshot] = []
    stages = Cell(problem, SIZE, element_size / 2, plot)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        force = problem.reaction(right)[0]
        stage = stages.update(force)
        nodes = problem.space.dofmap.index_map.size_global
        if animate:
            snapshots.append(problem.step.snapshot())
        strain, stress = 2 * problem.t / SIZE, force / SIZE
        row = {"strain [-]": strain, "stress [MPa]": stress}
        return row | {"stage [-]": stage, "nodes [-]": nodes}

    # Fragments that hang on a last point invite distant equilibria: watch the energy.
    checkpoint = Path(out) / "checkpoint"
    options = vmdg.SolveOptions(
        relative_tolerance=1e-8,
        energy=True,
        progress=True,
        show=("stress", "stage"),
        verbose=verbose,
        csv=Path(out) / "history.csv",
        **files(checkpoint, checkpoint_every),
    )
    history = resumed(problem, resume, checkpoint)
    if history:
        stages.skip(history)
    separated = (0.525 if fibres == 1 else 0.65) * critical_gap
    loads = pulls(step, end or (0.005 if interface_only else separated), growth)
    if not (end or interface_only):
        # Fragments between two cracks may bridge them for long.
        loads = np.append(loads, separated * 1.1 ** np.arange(1, 32))
    loads = loads[(loads > problem.t * (1 + 1e-12)) & (stages.stage < 4)]
    history = vmdg.solve(
        problem, loads, options, monitor, history, until=lambda _: stages.stage == 4
    ).history

    if animate:
        film = Path(out) / "fibre_matrix.gif"
        write_film(film, problem, snapshots, history, "strain", "stress", "xx", 10, (0, 30))
    if problem.comm.rank == 0:
        if plot:
            stages.finish().savefig(Path(out) / "fibre_matrix_stages.png", dpi=105)
            curves(history, stages).savefig(Path(out) / "fibre_matrix.png", dpi=130)
        report(history)
        print(f"results are in {out}")
    return history


if __name__ == "__main__":
    run(main)
