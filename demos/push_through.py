"""A fibre is pushed out of its matrix and on through it, each with a mesh of its own.

The push-out of section 7.4 continues: after the bond is broken, the fibre slides by several lengths
of its elements, and friction fades as it leaves the matrix. Facets keep their partners while their
bond holds, and meet others when it is broken.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx.mesh import CellType, Mesh, MeshTags, create_rectangle, meshtags

import vmdg
from vmdg.meshes import apart

RADIUS, HOLE, OUTER, HEIGHT = 0.95, 1.025, 4.3, 5.36  # mm
FIBRE, MATRIX = vmdg.NeoHookean(E=2500.0, nu=0.35), vmdg.NeoHookean(E=4000.0, nu=0.33)  # MPa
BOND = vmdg.Debonding(strength=22.0, critical_gap=0.011, friction=0.525)  # MPa, mm
SHRINKAGE = 0.0022


def part(tag: int, radii: Sequence[float], layers: int) -> tuple[Mesh, MeshTags, MeshTags]:
    """Half of the section of a sleeve, with nodes at these radii, as if from a file of its own."""
    n = len(radii) - 1
    corners = [np.zeros(2), np.array([1.0, HEIGHT])]
    mesh = create_rectangle(MPI.COMM_WORLD, corners, (n, layers), CellType.quadrilateral)
    mesh.geometry.x[:, 0] = np.interp(mesh.geometry.x[:, 0], np.linspace(0, 1, n + 1), radii)
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    none = np.zeros(0, dtype=np.int32)
    return mesh, meshtags(mesh, 2, cells, np.full_like(cells, tag)), meshtags(mesh, 1, none, none)


def main(layers: int = 25, steps: int = 20, end: float = 3.0, out: str = "results/push_through"):
    """Cure the matrix and push the fibre; the history of the push."""
    inside = RADIUS * (1 - np.linspace(1, 0, 9) ** 1.5)
    outside = HOLE + (OUTER - HOLE) * (np.geomspace(1, 11, 15) - 1) / 10
    sleeve = [RADIUS, *outside]
    mesh, cells, _ = apart([part(1, inside, layers), part(2, sleeve, round(1.2 * layers))])
    bond = vmdg.Interface(between=(1, 2), law=BOND, sliding=True)
    cure = {2: lambda t: -SHRINKAGE * min(t, 1.0)}
    problem = vmdg.Problem(
        mesh, cells, {1: FIBRE, 2: MATRIX}, [bond], eigenstrain=cure, symmetry="axisymmetric"
    )

    def top(x):
        return np.isclose(x[1], HEIGHT) & (x[0] < RADIUS + 1e-9)

    problem.dirichlet(lambda x: np.isclose(x[1], 0) & (x[0] > HOLE - 1e-9), 0.0, "y")
    vmdg.solve(problem, np.linspace(0.25, 1, 4))
    # The punch displaces the top of the fibre as it is after the cure.
    problem.dirichlet(top, lambda t: 1 - t, "y", relative=True)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        force = -problem.reaction(top)[1]
        return {"punch [mm]": problem.t - 1, "force [N]": force, "off [-]": problem.debonded(0)}

    loads = 1 + np.append(np.linspace(0, 0.174, 2 * steps + 1)[1:], np.linspace(0.174, end, steps))
    shown = {"progress": True, "show": ("force", "off"), "csv": Path(out) / "history.csv"}
    options = vmdg.SolveOptions(**shown)
    history = vmdg.solve(problem, np.unique(loads[loads <= 1 + end]), options, monitor).history

    figure, (curve, section) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    vmdg.plot.curve(history, "punch", "force", ax=curve, origin=True)
    vmdg.plot.stress(problem, "mises", ax=section)
    if problem.comm.rank == 0:
        figure.savefig(Path(out) / "push_through.png")
        print(f"largest force {history['force'].max():.5g} N, last {history['force'][-1]:.5g} N")
        print(f"results are in {out}")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--layers", type=int, default=25, help="cells along the fibre")
    command.add_argument("--steps", type=int, default=20, help="load steps of the way after 0.174")
    command.add_argument("--end", type=float, default=3.0, help="displacement of the punch [mm]")
    command.add_argument("--out", default="results/push_through", help="folder for the results")
    main(**vars(command.parse_args()))
