"""A polycrystal breaks along its grain boundaries: a periodic cell of cubic crystals, each turned.

Nickel, in plane strain or, with ``--solid``, in space. The cell is stretched along x, free of
stress across. Every boundary between two grains can fail. Damage begins where stiff and soft
directions meet, spreads to the junctions of three grains, and one crack crosses the cell from image
to image, bridged by grains that lock until they are pulled out; where much breaks at once the path
leads back to smaller strains. Many cells make the study ``polycrystal_strengths``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

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
    """A rotation for every grain, about z in the plane (grains + 1, 3, 3); the first is of none."""
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

    Plane crystals turn about z, and boundaries between those that are turned by less than 15
    degrees against each other are twice as strong; turned in space hardly any two are so alike.

    Args:
        grains: Their number.
        seed: Of their places and rotations: the same seed, the same cell.
        solid: In space.
        spread: Of their sizes, standard deviation of the logarithm; 0.35 for grown grains [-].
        cells: Along the mean size of a grain [-].
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
    spread: float = 0.0,
    cells: float = 6.0,
    end: float = 0.005,
    steps: int = 20,
    trace: bool = True,
    animate: bool = False,
    out: str = "results/polycrystal",
) -> vmdg.History:
    """Stretch a cell beyond its strength; the history of the run."""
    problem = make_problem(grains, seed, solid, spread, cells)
    cell, snapshots, peak = vmdg.PeriodicCell(problem), [], 0.0
    shape = {"projection": "3d"} if solid else {}
    figure = plt.figure(figsize=(12, 3.6), layout="constrained")
    curve, damage, stress = (
        figure.add_subplot(1, 3, n, **(shape if n > 1 else {})) for n in (1, 2, 3)
    )

    def show_damage(when: str, **style: object) -> None:
        damage.clear()
        vmdg.plot.interface_points(problem, "damage", damage, limits=(0, 1), **style)
        damage.set_title(f"damage at the {when}, {100 * problem.t:.2f} %")

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        nonlocal peak
        row = cell.row()
        if animate:
            snapshots.append(problem.snapshot())
        if row["stress_xx [MPa]"] > peak and not solid:
            peak = row["stress_xx [MPa]"]
            show_damage("peak")
        return row

    options = vmdg.SolveOptions(
        **path_options(solid, trace), progress=True, csv=f"{out}/history.csv"
    )
    loads = np.linspace(0, end, steps + 1)[1:]
    history = vmdg.solve(problem, loads, options, monitor).history
    if animate:
        shown = "strain_xx", "stress_xx", "xx", 20
        vmdg.plot.animate(Path(out) / "polycrystal.gif", problem, snapshots, history, *shown)
    vmdg.plot.curve(history, "strain_xx", "stress_xx", ax=curve, origin=True, color="black")
    if solid:
        show_damage("end", above=0.5)  # what is less damaged hides the crack
    vmdg.plot.stress(problem, "xx", magnify=10, ax=stress, edges=0.2 if solid else 0)
    for ax in (damage, stress) if solid else ():
        ax.locator_params(nbins=3)
        ax.set(zlabel="")
    if problem.comm.rank == 0:
        figure.savefig(f"{out}/polycrystal.png", dpi=130)
        strain, force = history["strain_xx"], history["stress_xx"]
        print(
            f"strength {force.max():.4g} MPa at {100 * strain[np.argmax(force)]:.2f} %; see {out}"
        )
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--grains", type=int, default=50, help="their number")
    command.add_argument("--seed", type=int, default=0, help="of places and orientations")
    command.add_argument("--solid", action="store_true", help="a cell in space")
    command.add_argument(
        "--spread", type=float, default=0.0, help="of grain sizes, 0.35 if grown [-]"
    )
    command.add_argument("--cells", type=float, default=6.0, help="along a grain; 2 in space [-]")
    command.add_argument("--end", type=float, default=0.005, help="mean strain at the end [-]")
    command.add_argument("--steps", type=int, default=20, help="given strains on the way")
    command.add_argument(
        "--no-trace", dest="trace", action="store_false", help="jump where the path leads back"
    )
    command.add_argument("--animate", action="store_true", help="make a film, too")
    command.add_argument("--out", default="results/polycrystal", help="folder for the results")
    main(**vars(command.parse_args()))
