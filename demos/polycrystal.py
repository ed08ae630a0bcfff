"""A polycrystal breaks along its grain boundaries: a periodic cell of cubic crystals.

Nickel grains of random orientations, in plane strain or, with ``--solid``, in 3D. The cell is
stretched along x, free of stress across. Every grain boundary can fail. Damage begins where stiff
and soft directions meet and spreads to the junctions of three grains; one crack crosses the cell
from image to image, bridged by interlocking grains until they are pulled out. Where much breaks at
once the path turns back to smaller strains.
"""

from __future__ import annotations

import argparse

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import vmdg
from vmdg import meshes
from vmdg.linear.ksp import LDLT

SIZE, LOW_ANGLE = 0.1, 15.0  # mm, degrees
NICKEL = {"C11": 246.5e3, "C12": 147.3e3, "C44": 124.7e3}  # MPa
STRENGTH, CRITICAL_GAP = 500.0, {2: 2e-4, 3: 4e-4}  # MPa, mm; by dimension, of coarser cells in 3D


def orientations(grains: int, dimension: int, seed: int) -> NDArray[np.float64]:
    """A rotation for every grain, in the plane about z (grains + 1, 3, 3); the first is unused."""
    if dimension == 3:
        q = np.random.RandomState(seed).normal(size=(grains + 1, 4))
        x, y, z, w = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    else:
        half = np.radians(np.random.default_rng(seed).uniform(0, 90, grains + 1)) / 2
        x, y, z, w = 0 * half, 0 * half, np.sin(half), np.cos(half)
    rows = [
        [x * x - y * y - z * z + w * w, 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), -x * x + y * y - z * z + w * w, 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), -x * x - y * y + z * z + w * w],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def make_problem(
    grains: int,
    seed: int,
    solid: bool,
    spread: float,
    cells: float,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> vmdg.Problem:
    """A cell stretched along x by the load factor, free of stress across.

    Plane crystals are rotated about z; boundaries with a misorientation below 15 degrees are twice
    as strong. In 3D hardly any two grains are so alike.

    Args:
        grains: Number of grains.
        seed: Seed of places and orientations: the same seed gives the same cell.
        solid: Whether the cell is in 3D.
        spread: Standard deviation of the logarithm of the sizes; 0.35 for grown grains [-].
        cells: Elements along the mean size of a grain [-].
        comm: Communicator.
    """
    d = 3 if solid else 2
    given = {"dim": d, "spread": spread, "size": SIZE, "comm": comm}
    given["element_size"] = SIZE * grains ** (-1 / d) / cells
    mesh, tags, _ = meshes.polycrystal(grains, seed, **given)
    turns = orientations(grains, d, seed)
    crystals = {n: vmdg.Cubic(**NICKEL, rotation=turns[n]) for n in range(1, grains + 1)}

    def alike(a: NDArray, b: NDArray) -> NDArray:
        return vmdg.misorientation(turns[a], turns[b]) < LOW_ANGLE

    strong, weak = (vmdg.Debonding(f * STRENGTH, CRITICAL_GAP[d]) for f in (2, 1))
    interfaces = [vmdg.Interface(between="all", law=weak, name="boundaries")]
    if not solid:
        interfaces = [
            vmdg.Interface(between=alike, law=strong, name="low-angle"),
            vmdg.Interface(between=lambda a, b: ~alike(a, b), law=weak, name="high-angle"),
        ]
    pull = vmdg.Periodic(strain={"xx": lambda strain: strain})
    return vmdg.Problem(mesh, tags, crystals, interfaces, kinematics="small", periodic=pull)


def path_options(solid: bool, trace: bool) -> dict[str, object]:
    """Follow the path back where it snaps, 1 % of the bonds per row, or jump as a machine does."""
    path = {"unstable": "trace", "max_share": 0.01} if trace else {}
    # Tetrahedra between grains are flat: factors cost less than 130 iterations of multigrid.
    return path | {"petsc": LDLT if solid else None, "energy": True, "show": "stress_xx"}


def main(
    grains: int = 50,
    seed: int = 0,
    solid: bool = False,
    cells: float = 6.0,
    end: float = 0.005,
    steps: int = 20,
    trace: bool = True,
    out: str = "results/polycrystal",
) -> vmdg.History:
    """Stretch a cell beyond its strength; the history of the run."""
    problem = make_problem(grains, seed, solid, 0.0, cells)
    cell, saved = vmdg.PeriodicCell(problem), {"progress": True, "csv": f"{out}/history.csv"}
    options = vmdg.SolveOptions(**path_options(solid, trace), **saved)
    loads = np.linspace(0, end, steps + 1)[1:]
    history = vmdg.solve(problem, loads, options, lambda _: cell.row()).history
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
    curve, damage, stress = axes
    vmdg.plot.curve(history, "strain_xx", "stress_xx", curve, origin=True, color="black")
    vmdg.plot.interface_map(problem, "damage", damage, (0, 1), above=0.5 if solid else -1)
    vmdg.plot.stress(problem, "xx", 10, stress, (-STRENGTH / 2, STRENGTH))
    curve.set(xlabel="mean strain", ylabel="mean stress [MPa]")
    damage.set_title("grain boundaries at the end")
    stress.set_title("stress at the end")
    if problem.comm.rank == 0:
        figure.savefig(f"{out}/polycrystal.png")
        strain, force = history["strain_xx"], history["stress_xx"]
        peak = 100 * strain[np.argmax(force)]
        print(f"strength {force.max():.4g} MPa at {peak:.2f} %; results are in {out}")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--grains", type=int, default=50, help="number of grains")
    command.add_argument("--seed", type=int, default=0, help="seed of places and orientations")
    command.add_argument("--solid", action="store_true", help="a cell in 3D")
    command.add_argument("--cells", type=float, default=6.0, help="elements per grain; 2 in 3D [-]")
    command.add_argument("--end", type=float, default=0.005, help="mean strain at the end [-]")
    command.add_argument("--steps", type=int, default=20, help="load steps")
    command.add_argument("--no-trace", dest="trace", action="store_false", help="jump at snaps")
    command.add_argument("--out", default="results/polycrystal", help="folder for the results")
    main(**vars(command.parse_args()))
