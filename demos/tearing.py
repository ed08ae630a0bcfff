"""A soft plate torn from a stiff one: section 7.3 of the report, Table 3, Figures 14 to 22.

Plane strain. The plates are bonded on y = 1.35 mm but for a pre-crack of a quarter of their width
at the left end. The upper edge is fixed, the lower edge is pulled down by strain * 1.35 mm, both
with u_x = 0. Neo-Hookean plates: damage starts at the tip, crosses the bond until the force
peaks at 4 % and opens it until the plates part at 14.8 %. Ogden's rubber stretches instead: the
tip blunts and the crack stays where it is. The report does not print the size of the plates (this
one parts at its strain) nor the length of the pre-crack. Its bulk modulus for the rubber, 4000 and
0.44 in Table 3, is 3500 times the shear modulus, nu = 0.49986: mean dilatation avoids locking.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx.mesh import MeshTags
from matplotlib.axes import Axes
from numpy.typing import NDArray

import vmdg
from vmdg import meshes

WIDTH, HEIGHT, PRECRACK = 1.62, 1.35, 0.405  # mm; HEIGHT of the soft plate
MESHES = {"coarse": 1, "medium": 2, "fine": 4}  # times 24 x 20 under 24 x 10 quadrilaterals
STIFF = vmdg.NeoHookean(E=16000.0, nu=0.44)
KAPPA = 4000.0 / (3 * (1 - 2 * 0.44))  # MPa


class Case(NamedTuple):
    """A soft plate, its bond, and what to show of it, at which strains."""

    soft: vmdg.Material
    strength: float  # MPa
    volumetric: str
    contours: tuple[float, ...]
    profiles: tuple[float, ...]
    limits: tuple[float, float]  # of the colours, MPa
    stages: tuple[tuple[float, float], ...]  # end of a stage, its share of the steps

    def strains(self, steps: int) -> NDArray[np.float64]:
        """Load factors: the stages in even steps, and every strain that is shown."""
        parts, start = [self.contours, self.profiles], 0.0
        for end, share in self.stages:
            parts.append(np.linspace(start, end, round(share * steps) + 1)[1:])
            start = end
        return np.unique(np.concatenate(parts).round(9))


CASES = {
    "neo-hookean": Case(
        vmdg.NeoHookean(E=4000.0, nu=0.44), 200.0, "pointwise",
        (0.04, 0.10, 0.14, 0.147), (0.026, 0.10, 0.14), (0, 250),
        ((0.05, 1.0), (0.145, 0.76), (0.15, 0.4)),
    ),
    "ogden": Case(
        vmdg.Ogden(c=(6.3, 0.012, -0.010), m=(1.3, 5.0, -2.0), kappa=KAPPA), 20.0, "mean",
        (0.04, 0.10, 0.16, 0.19), (0.04, 0.10, 0.19), (0, 6),
        ((0.19, 0.76),),
    ),
}  # fmt: skip


class Run(NamedTuple):
    """The table of a run, and profiles along x by strain: opening and fine scales, both [mm]."""

    history: vmdg.History
    gap: Mapping[float, NDArray[np.float64]]
    error: Mapping[float, NDArray[np.float64]]


def gap_profile(problem: vmdg.Problem, cells: MeshTags) -> NDArray[np.float64]:
    """Rows (x, opening along y) at the nodes of both plates, those of the slit included."""
    X, faces = problem.space.tabulate_dof_coordinates(), []
    for tag in (1, 2):
        nodes = np.unique(problem.space.dofmap.list[cells.find(tag)])
        nodes = nodes[np.isclose(X[nodes, 1], HEIGHT)]
        u = problem.u.x.array.reshape(-1, 2)[nodes, 1]
        rows = problem.comm.allgather(np.column_stack([X[nodes, 0].round(9), u]))
        rows = np.concatenate(rows)
        faces.append(rows[np.unique(rows[:, 0], return_index=True)[1]])
    return np.column_stack([faces[0][:, 0], faces[1][:, 1] - faces[0][:, 1]])


def tear(material: str, mesh: str, steps: int, out: Path, panels: Mapping[float, Axes]) -> Run:
    """Tear the plates on one mesh, and draw them at the strains that have a panel."""
    case, divisions = CASES[material], [MESHES[mesh] * n for n in (24, 20, 10)]
    body, cells, facets = meshes.tearing(
        MPI.COMM_WORLD, "quadrilateral", WIDTH, HEIGHT, HEIGHT / 2, divisions, PRECRACK
    )
    law = vmdg.Debonding(strength=case.strength, critical_gap=0.2)
    bond = vmdg.Interface(between=(1, 2), law=law)
    plates, options = {1: case.soft, 2: STIFF}, {"volumetric": case.volumetric}
    problem = vmdg.Problem(body, cells, plates, [bond], **options)
    bottom, top = facets.find(1), facets.find(2)
    problem.dirichlet(bottom, lambda strain: (0.0, -HEIGHT * strain))
    problem.dirichlet(top, 0.0)
    gap, error = {}, {}

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        for strain, ax in panels.items():
            if np.isclose(problem.t, strain):
                last = ax is list(panels.values())[-1]
                vmdg.plot.stress(problem, "yy", 1, ax, case.limits, edges=0, colorbar=last)
                ax.set_title(f"strain {100 * strain:.3g} %")
        for strain in case.profiles:
            if np.isclose(problem.t, strain):
                fields.write(problem.t)
                gap[strain] = gap_profile(problem, cells)
                error[strain] = vmdg.profile(problem, 0, "fine_scale", "x")[0]
        tip = {
            name: vmdg.profile(problem, 0, size, "x")[0][0, 1]
            for name, size in (
                ("tip_opening [mm]", lambda state: np.linalg.norm(state.opening, axis=1)),
                ("tip_traction [MPa]", lambda state: np.linalg.norm(state.traction, axis=1)),
            )
        }
        damaged = vmdg.average(problem, 0, lambda state: state.softening > 0)
        broken = vmdg.average(problem, 0, lambda state: state.softening >= law.strength)
        row = {"force [N]": problem.reaction(top)[1], "damaged [-]": damaged}
        return row | {"broken [-]": broken} | tip

    table = out / f"history_{material}_{mesh}.csv"
    options = vmdg.SolveOptions(relative_tolerance=1e-8, energy=True, progress=True, csv=table)
    with vmdg.FieldWriter(problem, out / f"fields_{mesh}") as fields:
        history = vmdg.solve(problem, case.strains(steps), options, monitor).history
    return Run(history, gap, error)


def draw(run: Run, axes: Mapping[str, Axes], label: str, style: str = "-") -> None:
    """Force, traction at the tip, and profiles of opening and fine scales."""
    history = run.history
    axes["force"].plot(100 * history["load"], history["force"], style, label=label)
    axes["law"].plot(history["tip_opening"], history["tip_traction"], style, label=label)
    for i, strain in enumerate(run.gap):
        named = {"color": f"C{i}", "label": f"{100 * strain:.3g} %" if style == "-" else None}
        axes["gap"].plot(*run.gap[strain].T, style, **named)
        axes["error"].semilogy(*run.error[strain].T, style, **named)
    axes["force"].set(xlabel="strain [%]", ylabel="force [N/mm]")
    axes["law"].set(xlabel="opening at the tip [mm]", ylabel="traction there [MPa]")
    axes["gap"].set(xlabel="x [mm]", ylabel="opening [mm]")
    axes["error"].set(xlabel="x [mm]", ylabel="fine scales [mm]")
    for ax in axes.values() if style == "-" else ():
        ax.legend(fontsize=7)


def main(
    material: str = "neo-hookean",
    mesh: str = "medium",
    steps: int = 25,
    out: str = "results/tearing",
) -> Run:
    """Tear the plates; the table of the run and its profiles."""
    figure = plt.figure(figsize=(12, 6), layout="constrained")
    states, curves = figure.subfigures(2, 1)
    panels = states.subplots(1, 4, sharey=True)
    panels = dict(zip(CASES[material].contours, panels, strict=True))
    run = tear(material, mesh, steps, Path(out), panels)
    draw(run, curves.subplot_mosaic([["force", "law", "gap", "error"]]), mesh)
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(Path(out) / f"tearing_{material}.png", dpi=120)
        strain, force = run.history["load"], run.history["force"]
        print(f"largest force {force.max():.5g} N/mm at {100 * strain[np.argmax(force)]:.2f} %")
        print(f"results are in {out}")
    return run


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__.replace("%", "%%"),
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    command.add_argument("--material", choices=CASES, default="neo-hookean", help="of a plate")
    command.add_argument("--mesh", choices=MESHES, default="medium", help="how fine")
    command.add_argument("--steps", type=int, default=25, help="load steps to a strain of 0.05 [-]")
    command.add_argument("--out", default="results/tearing", help="folder for the results")
    main(**vars(command.parse_args()))
