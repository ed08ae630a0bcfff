"""A soft plate torn from a stiff one: section 7.3 of the report, Table 3, Figures 14 to 22.

Plane strain. The plates are bonded on y = 1.35 mm but for a pre-crack of a quarter of their width
at the left end. The upper edge is held, the lower edge is pulled down by strain * 1.35 mm, both
gripped (u_x = 0). Neo-Hookean plates: damage starts at the tip, crosses the bond until the force
peaks at 4 % and opens it until the plates part at 14.8 %. Ogden's rubber stretches instead: the
tip blunts and the crack stays where it is. The report does not print the size of the plates (this
one parts at its strain) nor the length of the pre-crack. Its bulk modulus for the rubber, 4000 and
.44 in Table 3, is 3500 times the shear modulus, nu = .49986: mean dilatation avoids locking.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from helpers.options import run as run_demo
from helpers.restart import files, resumed
from helpers.tearing import Contours, Run, curves, error_profile, gap_profile, gathered
from helpers.tearing_cases import CASES, HEIGHT, MESHES, PRECRACK, STIFF, WIDTH

import vmdg
from vmdg.meshes import tearing
from vmdg.output.fields import FieldWriter


def tear(
    material: str,
    law: vmdg.Debonding,
    mesh: str,
    steps: int,
    out: Path,
    every: int = 10,
    resume: bool = False,
    plot: bool = True,
    verbose: bool = False,
) -> tuple[Run, Contours | None]:
    """Tear the plates on one mesh; fields and checkpoints go to the folder ``out``."""
    case, sizes = CASES[material], (WIDTH, HEIGHT, HEIGHT / 2)
    divisions = [MESHES[mesh] * n for n in (24, 20, 10)]
    tagged = tearing(MPI.COMM_WORLD, "quadrilateral", *sizes, divisions, PRECRACK)
    interface = vmdg.Interface(between=(1, 2), law=law)
    materials = {1: case.soft, 2: STIFF}
    problem = vmdg.Problem(
        tagged.mesh, tagged.cell_tags, materials, [interface], volumetric=case.volumetric
    )
    bottom, top = (tagged.facet_tags.find(tag) for tag in (1, 2))
    problem.dirichlet(bottom, lambda strain: (0.0, -HEIGHT * strain))
    problem.dirichlet(top, 0.0)
    run = Run()
    contours = Contours(case.contours, case.limits) if plot else None

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        if contours:
            contours.take(problem)
        for strain in case.profiles:
            if np.isclose(problem.t, strain):
                fields.write(problem.t)
                run.gap[strain] = gap_profile(problem, tagged, HEIGHT)
                run.error[strain] = error_profile(problem)
        state = problem.state[0]
        size = [np.linalg.norm(value, axis=1) for value in (state.opening, state.traction)]
        columns = *size, state.softening, state.weights
        _, opening, traction, Q, length = gathered(problem, state.points[:, 0], *columns).T
        return {
            "force [N]": problem.reaction(top)[1],
            "tip_opening [mm]": opening[0],
            "tip_traction [MPa]": traction[0],
            "damaged [-]": length @ (Q > 0) / length.sum(),
            "broken [-]": length @ (Q >= law.strength) / length.sum(),
        }

    checkpoint = out / f"checkpoint_{mesh}"
    shown = {"progress": True, "verbose": verbose, "csv": out / f"history_{material}_{mesh}.csv"}
    options = vmdg.SolveOptions(
        relative_tolerance=1e-8, energy=True, **shown, **files(checkpoint, every)
    )
    history = resumed(problem, resume, checkpoint)
    # A file of fields is written from its start: those of the first part of a run stay as they are.
    name = f"fields_{mesh}" if history is None else f"fields_{mesh}_from_{problem.t:.6g}"
    loads = case.strains(steps)
    with FieldWriter(problem, out / name) as fields:
        result = vmdg.solve(problem, loads[loads > problem.t + 1e-12], options, monitor, history)
    run.history, run.failures = result.history, result.failures
    return run, contours


def main(
    material: Annotated[str, CASES] = "neo-hookean",
    mesh: Annotated[str, (*MESHES, "all")] = "medium",
    steps: int = 25,
    out: str = "results/tearing",
    checkpoint_every: int = 10,
    resume: bool = False,
    plot: bool = True,
    verbose: bool = False,
) -> dict[str, Run]:
    """Tear the plates; the runs by mesh.

    Args:
        material: Of the soft plate.
        mesh: How fine, or all meshes.
        steps: Load steps to a strain of 5 %.
        out: Folder for pictures, histories, fields and checkpoints.
        checkpoint_every: Steps between two checkpoints; 0 for none.
        resume: Go on from the last checkpoint, on any number of ranks.
        plot: Draw the pictures.
        verbose: Print the residuals of every step.
    """
    folder = Path(out)
    law = vmdg.Debonding(strength=CASES[material].strength, critical_gap=0.2)
    runs = {}
    for name in MESHES if mesh == "all" else (mesh,):
        restart = checkpoint_every, resume
        runs[name], contours = tear(material, law, name, steps, folder, *restart, plot, verbose)
    if MPI.COMM_WORLD.rank == 0:
        if contours:
            contours.figure.savefig(folder / f"tearing_{material}_contours.png", dpi=150)
            curves(runs, law, PRECRACK).savefig(folder / f"tearing_{material}.png", dpi=120)
        for name, run in runs.items():
            print(f"{name}: {run.summary()}")
            if len(runs) > 1 and not resume:  # profiles are not part of a checkpoint
                difference = run.gap_difference(list(runs.values())[-1], 0.10)
                print(f"  opening at 10 % strain against the finest mesh: {difference:.2%} off")
        print(f"results are in {out}")
    plt.close("all")
    return runs


if __name__ == "__main__":
    run_demo(main)
