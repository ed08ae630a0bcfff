"""A periodic cell of fibres whose bond and matrix can fail, pictures, and strengths in a file."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import vmdg
from helpers.polycrystal import draw_damage
from vmdg.meshes import fibre_cell
from vmdg.meshes.packing import UNIT_BALL

#: Glass in epoxy; lengths are relative to the cell, as on a scale of a few micrometres.
BODIES = {"fibre": vmdg.NeoHookean(E=40e3, nu=0.33), "matrix": vmdg.NeoHookean(E=4e3, nu=0.4)}
BOND, MATRIX = vmdg.Debonding(50.0, 0.01), vmdg.Debonding(80.0, 0.02)

COLUMNS = "seed,angle [deg],stress_xx [MPa],stress_xy [MPa]"


def build(fibres: int, fraction: float, seed: int, cells: float, angle: float) -> vmdg.Problem:
    """A cell under the mean strain xx = t cos, xy = t sin of an angle, free of stress across.

    Args:
        fibres: Number of fibres.
        fraction: Share of the area that they have.
        seed: Of their places.
        cells: Along the radius of a fibre.
        angle: Between pull along x, at 0, and shear, where xx is free of stress too [degrees].
    """
    radius = np.sqrt(fraction / (fibres * UNIT_BALL[2]))
    mesh, tags, _ = fibre_cell(fibres, fraction, seed, element_size=radius / cells)
    interfaces = [
        vmdg.Interface(between=("fibre", "matrix"), law=BOND, name="bond"),
        vmdg.Interface(within="matrix", law=MATRIX, name="cracks"),
    ]
    shares = {"xx": np.cos(np.radians(angle)), "xy": np.sin(np.radians(angle))}
    given = {name: lambda t, s=s: s * t for name, s in shares.items() if abs(s) > 1e-12}
    load = vmdg.Periodic(strain=given)
    return vmdg.Problem(mesh, tags, BODIES, interfaces, kinematics="small", periodic=load)


def _file(folder: Path) -> Path:
    return folder / "strengths.csv"


def strengths(folder: Path) -> NDArray[np.float64]:
    """Seed, angle and stresses xx and xy of the runs that are done (n, 4)."""
    if not _file(folder).is_file():
        return np.zeros((0, 4))
    return np.loadtxt(_file(folder), delimiter=",", skiprows=1, ndmin=2)


def is_done(folder: Path, seed: int, angle: float) -> bool:
    """Whether the file has the strength of this run."""
    return bool((strengths(folder)[:, :2] == (seed, angle)).all(axis=1).any())


def keep_strength(
    folder: Path, seed: int, angle: float, history: vmdg.History, comm: MPI.Comm
) -> None:
    """Add the largest stress of a run, by the size of (xx, xy), to the file; collective."""
    both = np.column_stack([history["stress_xx"], history["stress_xy"]])
    peak = both[np.argmax(np.linalg.norm(both, axis=1))]
    if comm.rank == 0:
        new = not _file(folder).is_file()
        with open(_file(folder), "a") as file:
            file.write(COLUMNS + "\n" if new else "")
            file.write(",".join(repr(float(v)) for v in (seed, angle, *peak)) + "\n")
    comm.barrier()


def draw_run(
    problem: vmdg.Problem,
    history: vmdg.History,
    stress: str,
    states: list[NDArray],
    path: Path | str,
) -> None:
    """Curve, damage at the peak, stress at the end; collective."""
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    vmdg.plot.curve(history, "load", stress, ax=axes[0], origin=True, color="black")
    axes[0].set(xlabel="size of the mean strain [-]")
    peak = int(np.argmax(history[stress]))
    draw_damage(axes[1], problem, states[peak], f"{history['load'][peak]:.2%}")
    vmdg.plot.stress(problem, "mises", magnify=3, ax=axes[2], edges=0)
    if problem.comm.rank == 0:
        figure.savefig(path, dpi=130)
    plt.close(figure)


def draw_envelope(rows: NDArray[np.float64], path: Path) -> None:
    """Strengths in the plane of pull and shear, the means of every direction joined."""
    figure, ax = plt.subplots(figsize=(4.6, 4.2), layout="constrained")
    seed, angle, pull, shear = rows.T
    drawn = ax.scatter(pull, shear, c=seed, s=14, cmap="viridis")
    means = [rows[angle == a, 2:].mean(axis=0) for a in np.unique(angle)]
    ax.plot(*np.transpose(means), color="black")
    figure.colorbar(drawn, ax=ax, label="seed")
    ax.set(xlabel="mean stress xx [MPa]", ylabel="mean stress xy [MPa]", xlim=0, ylim=0)
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(path, dpi=130)
    plt.close(figure)
