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

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from _restart import add_options, files, resumed
from _tearing import Contours, Run, curves, error_profile, gap_profile, gathered
from _tearing_cases import CASES, HEIGHT, MESHES, PRECRACK, STIFF, WIDTH, Case

import vmdg
from vmdg.meshes import tearing
from vmdg.output import FieldWriter


def tear(
    case: Case,
    law: vmdg.Debonding,
    mesh: str,
    steps: int,
    out: Path,
    every: int = 10,
    resume: bool = False,
) -> tuple[Run, Contours]:
    """Tear the plates on one mesh; fields and checkpoints go to the folder ``out``."""
    divisions = [MESHES[mesh] * n for n in (24, 20, 10)]
    sizes = WIDTH, HEIGHT, HEIGHT / 2, divisions, PRECRACK
    tagged = tearing(MPI.COMM_WORLD, "quadrilateral", *sizes)
    interface = vmdg.Interface(between=(1, 2), law=law)
    materials = {1: case.soft, 2: STIFF}
    problem = vmdg.Problem(
        tagged.mesh, tagged.cell_tags, materials, [interface], volumetric=case.volumetric
    )
    bottom, top = (tagged.facet_tags.find(tag) for tag in (1, 2))
    problem.dirichlet(bottom, lambda strain: (0.0, -HEIGHT * strain))
    problem.dirichlet(top, 0.0)
    run, contours = Run(), Contours(problem, case.contours, case.limits)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
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
            "force": problem.reaction(top)[1],
            "tip_opening": opening[0],
            "tip_traction": traction[0],
            "damaged": length @ (Q > 0) / length.sum(),
            "broken": length @ (Q >= law.strength) / length.sum(),
        }

    checkpoint = out / f"checkpoint_{mesh}"
    options = vmdg.SolveOptions(1e-8, energy=True, progress=True, **files(checkpoint, every))
    history = resumed(problem, resume, checkpoint)
    # A file of fields is written from its start: those of the first part of a run stay as they are.
    name = f"fields_{mesh}" if history is None else f"fields_{mesh}_from_{problem.t:.6g}"
    loads = case.strains(steps)
    with FieldWriter(problem, out / name) as fields:
        result = vmdg.solve(problem, loads[loads > problem.t + 1e-12], options, monitor, history)
    run.history, run.failures = result.history, result.failures
    return run, contours


def main(
    material: str = "neo-hookean",
    mesh: str = "medium",
    steps: int = 25,
    out: str = "results/tearing",
    checkpoint_every: int = 10,
    resume: bool = False,
) -> dict[str, Run]:
    """Run one mesh or "all"; pictures, histories and fields go to the folder ``out``."""
    case, folder = CASES[material], Path(out)
    law = vmdg.Debonding(strength=case.strength, critical_gap=0.2)
    runs = {}
    for name in MESHES if mesh == "all" else (mesh,):
        runs[name], contours = tear(case, law, name, steps, folder, checkpoint_every, resume)
    if MPI.COMM_WORLD.rank == 0:
        contours.figure.savefig(folder / f"tearing_{material}_contours.png", dpi=150)
        curves(runs, law, PRECRACK).savefig(folder / f"tearing_{material}.png", dpi=120)
        for name, run in runs.items():
            h = run.history
            h.to_csv(folder / f"history_{material}_{name}.csv")
            print(f"{name}: {run.summary()}")
            if len(runs) > 1 and not resume:  # profiles are not part of a checkpoint
                difference = run.gap_difference(list(runs.values())[-1], 0.10)
                print(f"  opening at 10 % strain against the finest mesh: {difference:.2%} off")
        print(f"pictures, histories and ParaView fields are in {out}")
    plt.close("all")
    return runs


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--material", choices=CASES, default="neo-hookean")
    parser.add_argument("--mesh", choices=[*MESHES, "all"], default="medium")
    parser.add_argument("--steps", type=int, default=25, help="steps to 5 %% (default 25)")
    parser.add_argument("--out", default="results/tearing", help="folder")
    add_options(parser)
    main(**vars(parser.parse_args()))
