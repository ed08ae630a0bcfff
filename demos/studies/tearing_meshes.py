"""The torn plates of section 7.3 on three meshes: Figures 14 to 22, and the influence of the mesh.

Runs the example ``tearing`` on its coarse, medium and fine mesh and compares force, opening and
fine scales, which are a measure of the error along the interface.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx.mesh import compute_midpoints
from matplotlib.axes import Axes
from numpy.typing import NDArray
from parts.options import run
from parts.scenes import tearing

import vmdg

#: Strains of the profiles.
PROFILES = {"neo-hookean": (0.026, 0.10, 0.14), "ogden": (0.04, 0.10, 0.19)}


class Run(NamedTuple):
    """The history of a run, and profiles along x: rows (x, value) [mm]."""

    history: vmdg.History  # History of the run
    gap: dict[float, NDArray[np.float64]]  # Opening along y at the nodes of the plates, by strain
    fine_scales: dict[float, NDArray[np.float64]]  # Fine scales along the bond, by strain


def gap_profile(problem: vmdg.Problem) -> NDArray[np.float64]:
    """Rows (x, opening along y) at the nodes of both plates, those of the slit included."""
    X, u, faces = problem.space.tabulate_dof_coordinates(), problem.u.x.array[1::2], []
    dofs = problem.space.dofmap.list
    middle = compute_midpoints(problem.mesh, 2, np.arange(len(dofs), dtype=np.int32))
    below = middle[:, 1] < tearing.HEIGHT
    for plate in (below, ~below):
        nodes = np.unique(dofs[plate])
        nodes = nodes[np.isclose(X[nodes, 1], tearing.HEIGHT)]
        rows = problem.comm.allgather(np.column_stack([X[nodes, 0].round(9), u[nodes]]))
        rows = np.concatenate(rows)
        faces.append(rows[np.unique(rows[:, 0], return_index=True)[1]])
    return np.column_stack([faces[0][:, 0], faces[1][:, 1] - faces[0][:, 1]])


def tear(material: str, mesh: str, steps: int, out: Path) -> Run:
    """Tear the plates on one mesh."""
    gap, fine_scales = {}, {}

    def look(problem: vmdg.Problem, strain: float) -> None:
        if strain in PROFILES[material]:
            gap[strain] = gap_profile(problem)
            fine_scales[strain] = vmdg.profile(problem, 0, "fine_scale", "x")[0]

    return Run(tearing.tear(material, mesh, steps, out, look), gap, fine_scales)


def difference(run: Run, reference: Run, strain: float = 0.10) -> float:
    """Largest difference of the openings at ``strain``, relative to the largest opening [-]."""
    x, gap = reference.gap[strain].T
    return float(np.abs(np.interp(x, *run.gap[strain].T) - gap).max() / gap.max())


def draw(run: Run, axes: Mapping[str, Axes], label: str, style: str) -> None:
    """Force, traction at the tip, and profiles of opening and fine scales."""
    history = run.history
    axes["force"].plot(100 * history["load"], history["force"], style, label=label)
    axes["law"].plot(history["tip_opening"], history["tip_traction"], style, label=label)
    for i, strain in enumerate(run.gap):
        named = {"color": f"C{i}", "label": f"{100 * strain:.3g} %" if style == "-" else None}
        axes["gap"].plot(*run.gap[strain].T, style, **named)
        axes["error"].semilogy(*run.fine_scales[strain].T, style, **named)
    axes["force"].set(xlabel="strain [%]", ylabel="force [N/mm]")
    axes["law"].set(xlabel="opening at the tip [mm]", ylabel="traction there [MPa]")
    axes["gap"].set(xlabel="x [mm]", ylabel="opening [mm]")
    axes["error"].set(xlabel="x [mm]", ylabel="fine scales [mm]")
    for ax in axes.values() if style == "-" else ():
        ax.legend(fontsize=7)


def main(
    meshes: list[str] | None = None,
    material: Annotated[str, tearing.CASES] = "neo-hookean",
    steps: int = 25,
    out: str = "results/tearing_meshes",
) -> dict[str, Run]:
    """Tear the plates on all meshes; the runs by mesh.

    Args:
        meshes: Some of coarse, medium and fine, the finest last; all without any.
        material: Material of the soft plate.
        steps: Load steps to a strain of 5 %.
        out: Folder for picture and histories.
    """
    runs = {mesh: tear(material, mesh, steps, Path(out)) for mesh in meshes or tearing.MESHES}
    figure = plt.figure(figsize=(14, 4), layout="constrained")
    axes = figure.subplot_mosaic([["force", "law", "gap", "error"]])
    for (mesh, each), style in zip(runs.items(), (":", "--", "-")[-len(runs) :], strict=True):
        draw(each, axes, mesh, style)
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(Path(out) / f"tearing_meshes_{material}.png", dpi=120)
        for mesh, each in runs.items():
            h, off = each.history, difference(each, list(runs.values())[-1])
            print(
                f"{mesh}: largest force {h['force'].max():.5g} N/mm, broken {h['broken'][-1]:.3g}, "
                f"{len(h)} rows; opening at 10 % strain is {100 * off:.2f} % off the finest mesh"
            )
    return runs


if __name__ == "__main__":
    run(main)
