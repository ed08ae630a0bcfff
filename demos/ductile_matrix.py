"""A fibre in a ductile matrix: the matrix flows while the bond of the fibre fails.

A square of matrix with a fibre is pulled apart at its left and right side, with the same bond in an
elastic matrix, in one that hardens and in one that does not. Until the bond has failed at a pole
the curves agree. Then an elastic matrix carries ever more around the crack; a ductile one flows
above and below the fibre, where its section is smallest, at a stress that only hardening can raise.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg import meshes

SIZE, RADIUS = 1.0, 0.3  # mm
E, NU, YIELD = 4000.0, 0.35, 60.0  # MPa, of an epoxy
FIBRE = vmdg.NeoHookean(E=70e3, nu=0.2)
MATRICES = {
    "elastic": vmdg.NeoHookean(E=E, nu=NU),
    "hardening": vmdg.J2(E, NU, YIELD, hardening=300.0, saturation=80.0, exponent=60.0),
    "perfectly plastic": vmdg.J2(E, NU, YIELD),
}


def build(
    matrix: vmdg.Material, element_size: float, strength: float
) -> tuple[vmdg.Problem, np.ndarray]:
    """The cell, each side pulled by the load factor [mm], and the facets of its right side."""
    # A little off the middle: two equal cracks would be an unstable equilibrium.
    centres = [[SIZE / 2 - 0.01, SIZE / 2]]
    mesh, cells, sides = meshes.fibre_matrix(
        MPI.COMM_WORLD, "quadrilateral", SIZE, RADIUS, centres, element_size
    )
    bond = vmdg.Debonding(strength=strength, critical_gap=0.02)
    interface = vmdg.Interface(between=("fibre", "matrix"), law=bond)
    problem = vmdg.Problem(mesh, cells, {"fibre": FIBRE, "matrix": matrix}, [interface], degree=2)
    problem.dirichlet(sides.find("left"), lambda pull: -pull, "x")
    problem.dirichlet(sides.find("right"), lambda pull: pull, "x")

    def middle(x: np.ndarray) -> np.ndarray:
        return np.isclose(x[1], SIZE / 2) & (np.isclose(x[0], 0) | np.isclose(x[0], SIZE))

    problem.dirichlet_points(middle, 0.0, "y")
    return problem, sides.find("right")


def main(
    element_size: float = 0.06,
    strength: float = 50.0,
    end: float = 0.03,
    steps: int = 20,
    out: str = "results/ductile_matrix",
) -> dict[str, vmdg.History]:
    """Pull the cell with each matrix; the histories by matrix."""
    figure = plt.figure(figsize=(10, 6.4), layout="constrained")
    axes = figure.subplot_mosaic([[*MATRICES], ["curve"] * 3])
    histories, last = {}, list(MATRICES)[-1]
    for name, matrix in MATRICES.items():
        problem, right = build(matrix, element_size, strength)

        def monitor(problem: vmdg.Problem, right: np.ndarray = right) -> dict[str, float]:
            force = problem.reaction(right)[0]
            energy = problem.energy()
            return {
                "strain [-]": 2 * problem.t / SIZE,
                "stress [MPa]": force / SIZE,
                "plastic work [N mm]": energy.plastic,
                "damage work [N mm]": energy.damage,
            }

        options = vmdg.SolveOptions(
            progress=True, show=("stress", "plastic work"), csv=Path(out) / f"{name}.csv"
        )
        loads = np.linspace(0.0, end, steps + 1)[1:]
        histories[name] = history = vmdg.solve(problem, loads, options, monitor).history
        vmdg.plot.stress(problem, "xx", 1.0, axes[name], limits=(0, 150), colorbar=name == last)
        axes[name].set_title(f"{name} matrix")
        axes["curve"].plot(100 * history["strain"], history["stress"], ".-", label=name)
    axes["curve"].set(xlabel="strain [%]", ylabel="stress [MPa]")
    axes["curve"].legend()
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(Path(out) / "ductile_matrix.png")
        print(f"the picture and the tables are in {out}")
    return histories


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--element-size", type=float, default=0.06, help="size of cells [mm]")
    command.add_argument("--strength", type=float, default=50.0, help="of the bond [MPa]")
    command.add_argument("--end", type=float, default=0.03, help="pull of each side [mm]")
    command.add_argument("--steps", type=int, default=20, help="number of given pulls")
    command.add_argument("--out", default="results/ductile_matrix", help="folder for the results")
    main(**vars(command.parse_args()))
