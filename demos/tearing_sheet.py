"""A sheet of rubber is torn off a stiff plate on a mesh that follows the crack, at finite strain.

The plates of section 7.3 of the report, twice as wide, but pulled most at the left end, so that the
crack grows with the load. Cells are small around its front only: the mesh is made again from a
coarse root whenever the front has come near the end of its window, and the state goes there.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg.meshes import beams, refined

WIDTH, HEIGHT, PRECRACK = 3.24, 1.35, 0.81  # mm
SHOWN = (0.25, 0.35, 0.5)  # strains at the left end


def pull(x: np.ndarray, strain: float) -> np.ndarray:
    """Displacement of the lower edge, a fifth at the right end."""
    return np.stack([0 * x[0], -HEIGHT * strain * (1 - 0.8 * x[0] / WIDTH)])


def plates() -> Callable[[Callable[[np.ndarray], np.ndarray]], vmdg.Problem]:
    """A function that makes the plates, pulled by the strain, with cells of a given size."""
    root = beams(
        cell="triangle",
        stations=(0.0, PRECRACK, WIDTH),
        divisions=(3, 9),
        height=(HEIGHT, HEIGHT / 2),
        rows=(5, 2),
        precrack=PRECRACK,
    )

    def make_problem(size: Callable[[np.ndarray], np.ndarray]) -> vmdg.Problem:
        mesh, cells, sides = refined(root, size)
        bond = vmdg.Interface(between=(1, 2), law=vmdg.Debonding(strength=1.0, critical_gap=0.2))
        bodies = {1: vmdg.NeoHookean(E=2.0, nu=0.44), 2: vmdg.NeoHookean(E=200.0, nu=0.44)}
        problem = vmdg.Problem(mesh, cells, bodies, [bond], degree=2)
        problem.dirichlet(sides.find("bottom"), pull)
        problem.dirichlet(sides.find("top"), 0.0)
        return problem

    return make_problem


def main(fine: float = 0.1, out: str = "results/tearing_sheet") -> vmdg.History:
    """Tear the sheet; the history of all meshes."""
    figure, axes = plt.subplots(2, 2, figsize=(9, 6.5), layout="constrained")
    panels = dict(zip(SHOWN, axes.flat, strict=False))

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        for strain, ax in panels.items():
            if np.isclose(problem.t, strain):
                ax.clear()
                vmdg.plot.stress(problem, "yy", 1.0, ax, (0, 1.2), edges=0.3)
                ax.set_title(f"strain {100 * strain:.3g} %")
        force = problem.reaction(lambda x: np.isclose(x[1], HEIGHT / 2))[1]
        return {"force [N]": force, "broken [-]": problem.debonded()}

    loads = np.union1d(np.linspace(0.05, max(SHOWN), 12), SHOWN)
    options = vmdg.SolveOptions(energy=True, progress=True)
    run = vmdg.solve_adaptively(plates(), loads, fine, 5 * fine, options, monitor)
    vmdg.plot.curve(run.history, "load", "force", axes.flat[-1], origin=True)
    axes.flat[-1].set(xlabel="strain at the left end")
    if MPI.COMM_WORLD.rank == 0:
        Path(out).mkdir(parents=True, exist_ok=True)
        figure.savefig(Path(out) / "tearing_sheet.png")
        print(f"{len(run.results)} meshes, largest {run.history['unknowns'].max()} unknowns")
    return run.history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--fine", type=float, default=0.1, help="cells at the front [mm]")
    command.add_argument("--out", default="results/tearing_sheet", help="folder for the picture")
    main(**vars(command.parse_args()))
