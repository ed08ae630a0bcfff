"""A hub is shrunk onto a shaft, which is then pulled out of it.

Both are meshed separately: the shaft is thicker than the hole by the interference, which the first
step relaxes. The pressure is that of Lame; the force is friction times pressure times what is left
of the contact, until the shaft is out.
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

RADIUS, OUTER, LENGTH, SHAFT = 10.0, 20.0, 20.0, 30.0  # hole, hub, its length, shaft [mm]
INTERFERENCE, FRICTION = 0.01, 0.15  # of the radii [mm]
STEEL = vmdg.NeoHookean(E=210e3, nu=0.3)  # MPa


def pressure() -> float:
    """Of a long hub on a long solid shaft of the same material, by Lame [MPa].

    The hub widens by p R/E ((R_o^2 + R^2)/(R_o^2 - R^2) + nu), the shaft gives way by
    p R/E (1 - nu), both free along the axis.
    """
    hub = (OUTER**2 + RADIUS**2) / (OUTER**2 - RADIUS**2) + 0.3
    return 210e3 * INTERFERENCE / RADIUS / (hub + 1 - 0.3)


def part(tag: int, radii: Sequence[float], length: float, n: tuple[int, int]) -> tuple:
    """Half of the section of a ring, as if from a file of its own."""
    corners = [np.array([radii[0], 0.0]), np.array([radii[1], length])]
    mesh: Mesh = create_rectangle(MPI.COMM_WORLD, corners, n, CellType.quadrilateral)
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    none = np.zeros(0, dtype=np.int32)
    tags: MeshTags = meshtags(mesh, 2, cells, np.full_like(cells, tag))
    return mesh, tags, meshtags(mesh, 1, none, none)


def main(cells: int = 20, steps: int = 40, out: str = "results/shrink_fit"):
    """Shrink and pull; the history."""
    shaft = part(1, (0.0, RADIUS + INTERFERENCE), SHAFT, (cells // 3, round(1.7 * cells)))
    hub = part(2, (RADIUS, OUTER), LENGTH, (cells // 2, cells))
    mesh, tags, _ = apart([shaft, hub])
    fit = vmdg.Interface(
        between=(1, 2), law=vmdg.Contact(friction=FRICTION), sliding=True, gap="keep"
    )
    problem = vmdg.Problem(mesh, tags, {1: STEEL, 2: STEEL}, [fit], symmetry="axisymmetric")

    def end(x):
        return np.isclose(x[1], SHAFT)

    def face(x):
        return np.isclose(x[1], LENGTH) & (x[0] > RADIUS + INTERFERENCE + 1e-9)

    problem.dirichlet(end, lambda t: t, "y")
    problem.dirichlet(face, 0.0, "y")

    figure, (curve, section) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        if problem.t == LENGTH / 2:
            vmdg.plot.stress(problem, "mises", ax=section)
        return {"pulled [mm]": problem.t, "force [N]": problem.reaction(end)[1]}

    first = [0.0, 0.01, 0.02, 0.05, LENGTH / 2]
    loads = np.unique(np.append(first, np.linspace(0, LENGTH + 1, steps + 1)))
    shown = {"progress": True, "show": ("pulled", "force"), "csv": Path(out) / "history.csv"}
    history = vmdg.solve(problem, loads, vmdg.SolveOptions(**shown), monitor).history

    vmdg.plot.curve(history, "pulled", "force", ax=curve)
    friction = FRICTION * pressure() * 2 * np.pi * RADIUS * LENGTH
    curve.plot([0, LENGTH], [friction, 0], "k--", label="Lamé, without ends")
    curve.set(ylim=(0, None))
    curve.legend()
    figure.savefig(Path(out) / "shrink_fit.png")
    print(f"largest force {history['force'].max():.4g} N, by Lame {friction:.4g} N")
    print(f"results are in {out}")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--cells", type=int, default=20, help="cells along the hub")
    command.add_argument("--steps", type=int, default=40, help="load steps")
    command.add_argument("--out", default="results/shrink_fit", help="folder for the results")
    main(**vars(command.parse_args()))
