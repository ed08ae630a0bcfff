"""Tutorial: your own laminate. From the plies to the curve of a double cantilever beam.

From the data of a ply and of its bond and a stacking sequence follow two arms in 3D with a crack
between them. The arms are opened, the crack runs, and the load is compared with lamination theory.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg.meshes.beams import INTERFACE, LOWER_LEFT, RIGHT, UPPER_LEFT, plates
from vmdg.plot import curve

# 1. The plies: E, nu and G of IM7/8552 in MPa, axis 1 along the fibres, 0.184 mm each. A laminate
# is a list of plies from below, each with its angle to x in degrees; one layer of cells has all.

PLY = {"E": (161e3, 11.38e3, 11.38e3), "nu": (0.32, 0.32, 0.45), "G": (5170.0, 5170.0, 3920.0)}
THICKNESS, G_C = 0.184, 0.28  # mm, N/mm
CROSS, TURNED = [0, 90, 0, 90], [90, 0, 90, 0]
LAYUPS = {"[0]8": [0] * 8, "[0/90]2s": CROSS + CROSS[::-1], "[90/0]2s": TURNED + TURNED[::-1]}


def laminate(angles: list[float], bottom: float) -> vmdg.Laminate:
    """An arm whose lower face is at z = ``bottom`` [mm]."""
    return vmdg.Laminate([vmdg.Orthotropic(**PLY, angle=a) for a in angles], THICKNESS, bottom)


# 2. Theory. With D = D_11 of an arm and the crack length a, corrected for the compliance ahead of
# the tip, P = b sqrt(G_c D)/a and the opening is 2 P a^3/(3 b D) while the crack runs; without a:


def theory(angles: list[float], opening: np.ndarray) -> np.ndarray:
    """Load per width [N/mm] at which the crack runs, at an opening [mm]."""
    D = laminate(angles, 0.0).plate_stiffness()[2][0, 0]
    return np.sqrt(2 * (G_C * D) ** 1.5 / (3 * D * opening))


# 3. The test: a strip 2 mm wide that cannot contract sideways, cells of 0.5 mm where the crack
# runs, a bond of 40 MPa. The arms are mirror images, so that the crack opens without shear.
# More planes across y, and free sides, make it a specimen with a curved front: see
# `studies/parts/delamination/plies.py`.


def open_arms(angles: list[float], openings: np.ndarray) -> vmdg.History:
    """Open a crack of 30 mm in steps [mm]."""
    height, width = THICKNESS * len(angles), 2.0
    x = [*np.linspace(0, 28, 6), *np.arange(29, 52, 0.5), 54, 58, 70]
    mesh, cells, facets = plates(MPI.COMM_WORLD, x, (0, width), height, precrack=30.0)
    arms = {1: laminate(angles[::-1], -height), 2: laminate(angles, 0.0)}
    bond = vmdg.MixedModeDebonding(40.0, 60.0, G_C, 0.8, criterion="BK", exponent=2.1)
    interface = vmdg.Interface(facets.find(INTERFACE), law=bond)
    problem = vmdg.Problem(mesh, cells, arms, [interface], degree=2, kinematics="small")
    problem.dirichlet(facets.find(LOWER_LEFT), lambda t: -t / 2, "z")
    problem.dirichlet(facets.find(UPPER_LEFT), lambda t: t / 2, "z")
    problem.dirichlet(facets.find(RIGHT), 0.0)
    problem.dirichlet(lambda X: np.isclose(X[1], 0) | np.isclose(X[1], width), 0.0, "y")
    crack = vmdg.CrackGrowth(problem, interface, width=width, start=30.0)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        load = problem.reaction(facets.find(UPPER_LEFT))[2] / width
        return {"opening [mm]": problem.t, "force [N/mm]": load} | crack()

    options = vmdg.SolveOptions(progress=True, show=("force", "crack"))
    return vmdg.solve(problem, openings, options, monitor).history


def main(out: str = "results/tutorial_laminate") -> dict[str, vmdg.History]:
    """Test three laminates of the same plies; the history of each."""
    figure, (loads, resistance) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    openings, histories = np.linspace(0.1, 4.0, 40), {}
    for name, angles in LAYUPS.items():
        histories[name] = history = open_arms(angles, openings)
        shown = name.replace("]", "]$_{") + "}$"
        curve(history, "opening", "force", loads, origin=True, label=shown)
        exact, label = theory(angles, openings[13:]), "_" * (len(histories) - 1) + "laminate theory"
        loads.plot(openings[13:], exact, "k--", lw=0.8, zorder=0, label=label)
        curve(history, "crack", "resistance", resistance)
    resistance.axhline(G_C, color="k", ls="--", lw=0.8, label="$G_c$")
    resistance.set_ylim(0, 2 * G_C)
    loads.legend()
    resistance.legend()
    if MPI.COMM_WORLD.rank == 0:
        Path(out).mkdir(parents=True, exist_ok=True)
        for number, history in enumerate(histories.values()):
            history.to_csv(Path(out) / f"history_{number}.csv")
        figure.savefig(Path(out) / "tutorial_laminate.png")
    return histories


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument(
        "--out", default="results/tutorial_laminate", help="folder for the results"
    )
    main(**vars(command.parse_args()))
