"""A soft plate torn from a stiff one: section 7.3 of the report, Table 3, Figures 14 to 22.

Plane strain. The plates are bonded on y = 0 but for a pre-crack of a quarter of their width
at the left end. The upper edge is fixed, the lower edge is pulled down by strain * 1.35 mm, both
with u_x = 0. Neo-Hookean plates: damage starts at the tip and crosses the bond until the force
peaks at a strain of 0.04; the plates separate at 0.148. Ogden's rubber stretches instead: the tip
blunts and the crack does not grow. The report prints neither the size of the plates (these separate
at its strain) nor the length of the pre-crack. Its bulk modulus for the rubber, of 4000 MPa and
0.44 in Table 3, is 3500 times the shear modulus, nu = 0.49986: mean dilatation avoids locking.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg import meshes

WIDTH, HEIGHT, PRECRACK = 1.62, 1.35, 0.405  # of the soft plate, mm
MESHES = {"coarse": 1, "medium": 2, "fine": 4}  # times 24 x 20 under 24 x 10 quadrilaterals


class Case(NamedTuple):
    """A soft plate, its bond, and the load programme."""

    soft: vmdg.Material
    strength: float  # MPa
    volumetric: str
    limits: tuple[float, float]  # of the colours, MPa
    shown: tuple[float, ...]  # strains
    stages: tuple[tuple[float, float], ...]  # end of a stage, its fraction of the steps

    def strains(self, steps: int) -> np.ndarray:
        """Load factors: the stages in even steps, and every strain that is shown."""
        stages = pairwise([(0.0, 0.0), *self.stages])
        parts = [np.linspace(a, b, round(share * steps) + 1)[1:] for (a, _), (b, share) in stages]
        return np.unique(np.concatenate([self.shown, *parts]).round(9))


CASES = {
    "neo-hookean": Case(
        vmdg.NeoHookean(E=4000.0, nu=0.44), 200.0, "pointwise", (0, 250),
        (0.026, 0.04, 0.10, 0.14, 0.147), ((0.05, 1.0), (0.145, 0.76), (0.15, 0.4)),
    ),
    "ogden": Case(
        vmdg.Ogden(c=(6.3, 0.012, -0.010), m=(1.3, 5.0, -2.0), kappa=4000.0 / 0.36),
        20.0, "mean", (0, 6), (0.04, 0.10, 0.16, 0.19), ((0.19, 0.76),),
    ),
}  # fmt: skip


def tear(
    material: str, mesh: str, steps: int, out: Path, look: Callable[[vmdg.Problem, float], None]
) -> vmdg.History:
    """Tear the plates on one mesh, and ``look`` at the problem at strains that are shown."""
    case, counts = CASES[material], MESHES[mesh] * np.array([6, 18, 20, 10])
    body, cells, facets = meshes.beams(
        stations=(0.0, PRECRACK, WIDTH),
        divisions=counts[:2].tolist(),
        height=(HEIGHT, HEIGHT / 2),
        rows=counts[2:].tolist(),
        precrack=PRECRACK,
    )
    law = vmdg.Debonding(strength=case.strength, critical_gap=0.2)
    bond = vmdg.Interface(between=(1, 2), law=law)
    plates = {1: case.soft, 2: vmdg.NeoHookean(E=16000.0, nu=0.44)}
    problem = vmdg.Problem(body, cells, plates, [bond], volumetric=case.volumetric)
    top = facets.find("top")
    problem.dirichlet(facets.find("bottom"), lambda strain: (0.0, -HEIGHT * strain))
    problem.dirichlet(top, 0.0)

    def tip(name: str) -> float:
        norm = vmdg.profile(problem, 0, lambda s: np.linalg.norm(getattr(s, name), axis=1), "x")
        return norm[0][0, 1]

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        for strain in case.shown:
            if np.isclose(problem.t, strain):
                look(problem, strain)
        return {
            "force [N]": problem.reaction(top)[1],
            "damaged [-]": vmdg.average(problem, 0, lambda s: s.softening > 0),
            "broken [-]": vmdg.average(problem, 0, lambda s: s.softening >= law.strength),
            "tip_opening [mm]": tip("opening"),
            "tip_traction [MPa]": tip("traction"),
        }

    table = out / f"history_{material}_{mesh}.csv"
    options = vmdg.SolveOptions(energy=True, progress=True, csv=table)
    return vmdg.solve(problem, case.strains(steps), options, monitor).history


def main(
    material: str = "neo-hookean",
    mesh: str = "medium",
    steps: int = 25,
    out: str = "results/tearing",
) -> vmdg.History:
    """Tear the plates; the history of the run."""
    limits, shown = CASES[material].limits, CASES[material].shown
    figure = plt.figure(figsize=(9, 7), layout="constrained")
    axes = [figure.add_subplot(2, 3, n + 1) for n in range(len(shown) + 1)]
    panels = dict(zip(shown, axes, strict=False))

    def show(problem: vmdg.Problem, strain: float) -> None:
        vmdg.plot.stress(problem, "yy", 1, panels[strain], limits, colorbar=strain in shown[2::3])
        panels[strain].set_title(f"strain {100 * strain:.3g} %")

    history = tear(material, mesh, steps, Path(out), show)
    vmdg.plot.curve(history, "load", "force", axes[-1], origin=True)
    axes[-1].set(xlabel="strain")
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(Path(out) / f"tearing_{material}.png")
        print(f"largest force {history['force'].max():.5g} N/mm; results are in {out}")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument(
        "--material", choices=CASES, default="neo-hookean", help="of the soft plate"
    )
    command.add_argument("--mesh", choices=MESHES, default="medium", help="number of cells")
    command.add_argument("--steps", type=int, default=25, help="load steps to a strain of 0.05 [-]")
    command.add_argument("--out", default="results/tearing", help="folder for the results")
    main(**vars(command.parse_args()))
