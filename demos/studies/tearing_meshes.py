"""The torn plates of section 7.3 on three meshes: Figures 14 to 22, and what the numbers owe to it.

Runs the example ``tearing`` on its coarse, medium and fine mesh and compares force, opening and
fine scales, which are a measure of the error along the interface.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from parts.options import run
from parts.scenes import tearing


def difference(run: tearing.Run, reference: tearing.Run, strain: float = 0.10) -> float:
    """Largest difference of the openings at ``strain``, relative to the largest opening [-]."""
    x, gap = reference.gap[strain].T
    return float(np.abs(np.interp(x, *run.gap[strain].T) - gap).max() / gap.max())


def main(
    meshes: list[str] | None = None,
    material: Annotated[str, tearing.CASES] = "neo-hookean",
    steps: int = 25,
    out: str = "results/tearing_meshes",
) -> dict[str, tearing.Run]:
    """Tear the plates on all meshes; the runs by mesh.

    Args:
        meshes: Some of coarse, medium and fine, the finest last; all without any.
        material: Of the soft plate.
        steps: Load steps to a strain of 5 %.
        out: Folder for picture, histories and fields.
    """
    runs = {
        mesh: tearing.tear(material, mesh, steps, Path(out), {})
        for mesh in meshes or tearing.MESHES
    }
    figure = plt.figure(figsize=(14, 4), layout="constrained")
    axes = figure.subplot_mosaic([["force", "law", "gap", "error"]])
    for (mesh, each), style in zip(runs.items(), (":", "--", "-")[-len(runs) :], strict=True):
        tearing.draw(each, axes, mesh, style)
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
