"""Failure of a composite across its fibres: a periodic cell of glass fibres in epoxy.

Plane strain; lengths are in radii of a fibre. The bond of the fibres fails first, then cracks run
through the matrix along any facet. The angle of the mean strain is 0 degrees for tension along x,
90 for shear and 180 for compression, free of stress across. The study ``fibre_cell_strengths``
loads many cells in many directions and compares mean and scatter of the strength with bounds.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg import meshes

ELASTIC = {"fibre": (40e3, 0.33), "matrix": (4e3, 0.4)}  # E [MPa], nu
BODIES = {name: vmdg.NeoHookean(E=E, nu=nu) for name, (E, nu) in ELASTIC.items()}
BOND, MATRIX = (50.0, 0.07), (80.0, 0.14)  # strength [MPa], critical gap


def make_mesh(
    fibres: int, fraction: float, seed: int, cells: float, comm: MPI.Comm = MPI.COMM_WORLD
) -> meshes.TaggedMesh:
    """A cell of fibres of radius 1, with ``cells`` elements per radius."""
    size = np.sqrt(fibres * np.pi / fraction)
    return meshes.fibre_cell(fibres, fraction, seed, size=size, element_size=1 / cells, comm=comm)


def make_problem(tagged: meshes.TaggedMesh, angle: float, friction: float) -> vmdg.Problem:
    """The cell under the mean strain xx = t cos, xy = t sin of an angle [degrees]."""
    bond, matrix = (vmdg.Debonding(*law, friction=friction) for law in (BOND, MATRIX))
    interfaces = [
        vmdg.Interface(between=("fibre", "matrix"), law=bond, name="bond"),
        vmdg.Interface(within="matrix", law=matrix, name="cracks"),
    ]
    # The cell is free of stress in components whose strain is not prescribed.
    shares = {"xx": np.cos(np.radians(angle)), "xy": np.sin(np.radians(angle))}
    strain = {name: lambda t, s=s: s * t for name, s in shares.items() if abs(s) > 1e-12}
    kinds = {"kinematics": "small", "periodic": vmdg.Periodic(strain=strain)}
    return vmdg.Problem(tagged.mesh, tagged.cell_tags, BODIES, interfaces, **kinds)


def main(
    fibres: int = 7,
    fraction: float = 0.5,
    angle: float = 0.0,
    friction: float = 0.0,
    seed: int = 0,
    cells: float = 2.5,
    end: float = 0.02,
    steps: int = 8,
    animate: bool = False,
    out: str = "results/fibre_cell",
) -> vmdg.History:
    """Load a cell beyond its strength; the history of the run."""
    problem = make_problem(make_mesh(fibres, fraction, seed, cells), angle, friction)
    cell, snapshots, peak = vmdg.PeriodicCell(problem), [], 0.0
    stress = "stress_xx" if abs(np.cos(np.radians(angle))) > 0.7 else "stress_xy"
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        nonlocal peak
        row = cell.row()
        if animate:
            snapshots.append(problem.snapshot())
        if abs(row[f"{stress} [MPa]"]) > peak:
            peak = abs(row[f"{stress} [MPa]"])
            axes[1].clear()
            vmdg.plot.interface_map(problem, "damage", axes[1], (0, 1), above=0.0)
            axes[1].set_title(f"damage at the peak, {100 * problem.t:.2f} %")
        return row

    shown = {"progress": True, "show": ("stress_xx", "stress_xy"), "csv": f"{out}/history.csv"}
    options = vmdg.SolveOptions(energy=True, **shown)
    loads = np.linspace(0, end, steps + 1)[1:]
    history = vmdg.solve(problem, loads, options, monitor).history
    if animate:
        film = Path(out) / "fibre_cell.gif"
        vmdg.plot.animate(film, problem, snapshots, history, "load", stress, "mises", 3)
    vmdg.plot.curve(history, "load", stress, ax=axes[0], origin=True, color="black")
    axes[0].set(xlabel="size of the mean strain", ylabel="mean stress [MPa]")
    vmdg.plot.stress(problem, "mises", magnify=3, ax=axes[2])
    axes[2].set_title("stress at the end")
    if problem.comm.rank == 0:
        figure.savefig(f"{out}/fibre_cell.png")
        print(f"largest {stress} {peak:.4g} MPa; results are in {out}")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--fibres", type=int, default=7, help="number of fibres")
    command.add_argument(
        "--fraction", type=float, default=0.5, help="area fraction of the fibres [-]"
    )
    command.add_argument(
        "--angle", type=float, default=0.0, help="angle of the mean strain [degrees]"
    )
    command.add_argument("--friction", type=float, default=0.0, help="friction of crack faces [-]")
    command.add_argument("--seed", type=int, default=0, help="seed of the random places")
    command.add_argument("--cells", type=float, default=2.5, help="elements per radius [-]")
    command.add_argument("--end", type=float, default=0.02, help="mean strain at the end [-]")
    command.add_argument("--steps", type=int, default=8, help="load steps")
    command.add_argument("--animate", action="store_true", help="also make a film")
    command.add_argument("--out", default="results/fibre_cell", help="folder for the results")
    main(**vars(command.parse_args()))
