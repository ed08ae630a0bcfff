"""What the two patch tests share: the blocks, and pictures of their deformed side."""

from __future__ import annotations

from collections.abc import Mapping

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg.meshes import TaggedMesh, blocks
from vmdg.plot import cell_means, deformed_polygons, draw_cells

MATERIAL = vmdg.NeoHookean(E=5000.0, nu=0.25)
BACK = 6  # facets at z = 0, drawn in the pictures


def build(
    law: vmdg.Law, divisions=(1, 1, 1), line=(1.0, 1.0), comm=MPI.COMM_WORLD, **options
) -> tuple[vmdg.Problem, TaggedMesh]:
    """Blocks of :data:`MATERIAL` with u_x = 0 on the left and u_x = t [mm] on the right."""
    tagged = blocks(comm, "hexahedron", divisions, interface=line)
    interface = vmdg.Interface(between=(1, 2), law=law, frame="reference", **options)
    problem = vmdg.Problem(tagged.mesh, tagged.cell_tags, {1: MATERIAL, 2: MATERIAL}, [interface])
    problem.dirichlet(tagged.facet_tags.find(1), 0.0, "x")
    problem.dirichlet(tagged.facet_tags.find(2), lambda delta: delta, "x")
    return problem, tagged


class Snapshots:
    """A column of pictures of sigma_xx on the deformed side, one for each chosen load.

    Args:
        limits: Of the colours [MPa].
    """

    def __init__(
        self, tagged: TaggedMesh, titles: Mapping[float, str], limits: tuple[float, float]
    ):
        self._titles, self._limits = titles, limits
        self._side = tagged.facet_tags.find(BACK)
        mosaic = [["curve", load] for load in titles]
        self.figure, axes = plt.subplot_mosaic(
            mosaic, figsize=(9.5, 5.2), width_ratios=[1.3, 1], layout="constrained"
        )
        self.curve = axes.pop("curve")
        self._axes = axes

    def take(self, problem: vmdg.Problem) -> None:
        """Draw the current state if its load is one of the chosen; collective."""
        for load, ax in self._axes.items():
            if not np.isclose(problem.t, load):
                continue
            polygons, cells = deformed_polygons(problem, self._side)
            values = cell_means(problem.stress(), (0, 0))[cells]
            drawn = draw_cells(ax, problem, polygons, values, self._limits)
            title = self._titles[load]
            ax.set(title=title, ylabel="y [mm]", xlim=(-0.05, 2.45), ylim=(-0.25, 1.05))
            if ax is list(self._axes.values())[-1]:
                ax.set_xlabel("x [mm]")
                self.figure.colorbar(
                    drawn, ax=list(self._axes.values()), label=r"$\sigma_{xx}$ [MPa]"
                )
