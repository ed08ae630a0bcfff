"""Tutorial: your own laminate. From the plies to the curve of a double cantilever beam.

Data of one ply and of its bond, a stacking sequence, two arms of it in 3D, a crack between them.
The arms are opened, the crack runs; the load is set beside classical lamination theory.
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from helpers.options import run

import vmdg
from vmdg.meshes import plates
from vmdg.meshes.plates import INTERFACE, RIGHT, UPPER_LEFT
from vmdg.plot import curve

# 1. The plies: E, nu and G of IM7/8552 in MPa, axis 1 along the fibres, .184 mm each. A laminate is
# a list of them from below, each with its angle to x in degrees; one layer of cells holds all.

PLY = {"E": (161e3, 11.38e3, 11.38e3), "nu": (0.32, 0.32, 0.45), "G": (5170.0, 5170.0, 3920.0)}
THICKNESS, G_C = 0.184, 0.28  # mm, N/mm
LAYUPS = {
    "[0]8": [0] * 8,
    "[0/90]2s": [0, 90] * 2 + [90, 0] * 2,
    "[90/0]2s": [90, 0] * 2 + [0, 90] * 2,
}


def laminate(angles: list[float], bottom: float) -> vmdg.Laminate:
    """An arm whose lower face is at z = ``bottom`` [mm]."""
    return vmdg.Laminate([vmdg.Orthotropic(**PLY, angle=a) for a in angles], THICKNESS, bottom)


# 2. What theory says. With D = D_11 of an arm and a the crack with all that the clamped ends give
# way, P = b sqrt(G_c D)/a and opening 2 P a^3/(3 b D) while the crack runs. Without a:


def theory(angles: list[float], opening: np.ndarray) -> np.ndarray:
    """Load per width [N/mm] at which the crack runs, at an opening [mm]."""
    D = laminate(angles, 0.0).plate_stiffness()[2][0, 0]
    return np.sqrt(2 * (G_C * D) ** 1.5 / (3 * D * opening))


# 3. The test: a strip 2 mm wide that cannot contract sideways, cells of .5 mm where the crack runs,
# facets glued by a bond of 40 MPa. Arms are mirrored, so that the crack is opened and not sheared.
# More planes across y, and free sides, make it a specimen with a curved front: see
# `studies/delamination/plies.py`.


def open_arms(
    angles: list[float], opening: float, steps: int, verbose: bool = False
) -> vmdg.History:
    """Open a crack of 30 mm by ``opening`` [mm]."""
    height, width = THICKNESS * len(angles), 2.0
    x = [*np.linspace(0, 28, 6), *np.arange(29, 52, 0.5), 54, 58, 70]
    mesh, cells, facets = plates(MPI.COMM_WORLD, x, (0, width), height, precrack=30.0)
    arms = {1: laminate(angles[::-1], -height), 2: laminate(angles, 0.0)}
    bond = vmdg.MixedModeDebonding(
        normal_strength=40.0, shear_strength=60.0, normal_energy=G_C, shear_energy=0.8,
        criterion="BK", exponent=2.1,
    )  # fmt: skip
    interface = vmdg.Interface(facets.find(INTERFACE), law=bond)
    problem = vmdg.Problem(mesh, cells, arms, [interface], degree=2, kinematics="small")
    for z, sign in ((-height, -1), (height, 1)):
        problem.dirichlet_points(
            lambda X, z=z: np.isclose(X[0], 0) & np.isclose(X[2], z),
            lambda t, sign=sign: sign * t / 2,
            "z",
        )
    problem.dirichlet(lambda X: np.isclose(X[1], 0) | np.isclose(X[1], width), 0.0, "y")
    problem.dirichlet(facets.find(RIGHT), 0.0)
    crack = vmdg.CrackGrowth(problem, interface, width=width, start=30.0)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        load = problem.reaction(facets.find(UPPER_LEFT))[2] / width
        return {"opening [mm]": problem.t, "force [N/mm]": load} | crack()

    options = vmdg.SolveOptions(progress=True, verbose=verbose, show=("force", "crack"))
    return vmdg.solve(problem, opening * np.arange(1, steps + 1) / steps, options, monitor).history


def main(
    opening: float = 4.0,
    steps: int = 40,
    out: str = "results/tutorial_laminate",
    plot: bool = True,
    verbose: bool = False,
) -> dict[str, vmdg.History]:
    """Test three laminates of the same plies; the history of each.

    Args:
        opening: Of the arms, at the end [mm].
        steps: Load steps.
        out: Folder for tables and picture.
        plot: Draw the picture.
        verbose: Print the residuals of every step.
    """
    figure, (loads, resistance) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    histories = {}
    for number, (name, angles) in enumerate(LAYUPS.items()):
        histories[name] = history = open_arms(angles, opening, steps, verbose)
        curve(history, "opening", "force", loads, origin=True, label=name)
        running = np.linspace(opening / 3, opening)
        loads.plot(running, theory(angles, running), "k--", lw=0.8, zorder=0)
        resistance.plot(history["crack"], history["resistance"], f"C{number}.-", lw=0.6, label=name)
    loads.legend()
    resistance.axhline(G_C, color="k", ls="--", lw=0.8)
    resistance.set(xlabel="crack [mm]", ylabel="G_R [N/mm]", ylim=(0, 2 * G_C))
    if MPI.COMM_WORLD.rank == 0:
        Path(out).mkdir(parents=True, exist_ok=True)
        for number, history in enumerate(histories.values()):
            history.to_csv(Path(out) / f"history_{number}.csv")
        if plot:
            figure.savefig(Path(out) / "tutorial_laminate.png", dpi=120)
        print(f"results are in {out}")
    return histories


if __name__ == "__main__":
    run(main)
