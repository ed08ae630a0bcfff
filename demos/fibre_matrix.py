"""Fibre-matrix debonding with matrix cracks: section 7.2 of the report, Figures 9 to 12.

A square of matrix with a fibre (or many) is pulled apart at its left and right side. The bond of
the fibre fails first, at its poles; cracks, which may run along every facet of the matrix, leave
the interface and grow to the edges until the cell is in two parts. Two equal cracks would be an
unstable equilibrium: the single fibre is 0.01 mm off the middle, which selects a branch.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg import meshes

SIZE, RADIUS = 1.0, 0.25  # mm
REPORT = {"fibre": vmdg.NeoHookean(E=40e3, nu=0.4), "matrix": vmdg.NeoHookean(E=10e3, nu=0.33)}
#: What starts in a stage.
STAGES = ("debonding starts", "cracks kink into the matrix", "cracks reach an edge", "separation")


def build(
    tagged: meshes.TaggedMesh, critical_gap: float, cracks: str = "", kinematics: str = "finite"
) -> vmdg.Problem:
    """A cell whose sides are pulled apart, each by the load factor [mm].

    Args:
        tagged: Mesh of :func:`vmdg.meshes.fibre_matrix`.
        critical_gap: Critical gap of the bonds [mm].
        cracks: How facets of the matrix are activated; "" without cracks in the matrix.
        kinematics: "finite" or "small".
    """
    mesh, cells, sides = tagged
    bond = vmdg.Debonding(strength=10.0, critical_gap=critical_gap)
    interfaces = [vmdg.Interface(between=("fibre", "matrix"), law=bond)]
    if cracks:
        crack = vmdg.Debonding(strength=30.0, critical_gap=critical_gap)
        interfaces.append(vmdg.Interface(within="matrix", law=crack, activate=cracks))
    problem = vmdg.Problem(mesh, cells, REPORT, interfaces, kinematics=kinematics)
    problem.dirichlet(sides.find("left"), lambda pull: -pull, "x")
    problem.dirichlet(sides.find("right"), lambda pull: pull, "x")

    def middle(x: np.ndarray) -> np.ndarray:
        return np.isclose(x[1], SIZE / 2) & (np.isclose(x[0], 0) | np.isclose(x[0], SIZE))

    problem.dirichlet_points(middle, 0.0, "y")
    return problem


def pulls(step: float, end: float, growth: float, constant: float = 0.003) -> np.ndarray:
    """Displacements of a side [mm]: equal steps to ``constant``, then growing ones to ``end``."""
    values, size = [step], step
    while values[-1] < end * (1 - 1e-9):
        if values[-1] > constant:
            size = min(size * growth, end / 12)
        values.append(min(values[-1] + size, end))
    return np.array(values)


def events(problem: vmdg.Problem, near: float) -> list[bool]:
    """Whether bond, matrix, and matrix ``near`` an edge [mm] are damaged; collective."""
    damaged = [state.points[state.softening > 0] for state in problem.state]
    at_edge = np.abs(damaged[1][:, 1] - SIZE / 2) > SIZE / 2 - near
    counts = np.array([len(damaged[0]), len(damaged[1]), at_edge.sum()])
    return list(problem.comm.allreduce(counts) > 0)


def main(
    cell: str = "quadrilateral",
    element_size: float = 0.1,
    critical_gap: float = 0.2,
    fibres: int = 1,
    activate: str = "all",
    animate: bool = False,
    out: str = "results/fibre_matrix",
) -> vmdg.History:
    """Pull both sides until the cell is in parts; the history of the run."""
    centres, radius = np.array([[SIZE / 2 - 0.01, SIZE / 2]]), RADIUS
    if fibres > 1:
        centres, radius = meshes.random_fibres(fibres, 0.35, SIZE)
    tagged = meshes.fibre_matrix(MPI.COMM_WORLD, cell, SIZE, radius, centres, element_size)
    problem = build(tagged, critical_gap, activate)
    figure = plt.figure(figsize=(11, 6.6), layout="constrained")
    axes = figure.subplot_mosaic([[0, 1, "curve"], [2, 3, "curve"]], width_ratios=(5, 5, 4))
    stage, peak, snapshots, seen = 0, 0.0, [], (-0.12 * SIZE, 1.12 * SIZE)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        nonlocal stage, peak
        force = problem.reaction(tagged.facet_tags.find("right"))[0]
        strain, peak = 2 * problem.t / SIZE, max(peak, abs(force))
        reached = [*events(problem, element_size / 2), abs(force) < 1e-3 * peak]
        while stage < len(STAGES) and reached[stage]:
            name, scale = f"{stage + 1} {STAGES[stage]}", 20 if problem.t < 0.0055 * SIZE else 1
            style = {"limits": (0, 30), "colorbar": stage % 2 == 1}
            vmdg.plot.stress(problem, "xx", scale, axes[stage], **style)
            axes[stage].set(title=f"{name}, {problem.t * 1e3:.3g} µm", xlim=seen, ylim=seen)
            axes["curve"].plot(100 * strain, force / SIZE, "o", label=stage + 1)
            stage += 1
        if animate:
            snapshots.append(problem.snapshot())
        return {"strain [-]": strain, "stress [MPa]": force / SIZE, "stage [-]": stage}

    # Fragments that hang on a last point invite distant equilibria: watch the energy.
    shown = {"progress": True, "show": ("stress", "stage"), "csv": Path(out) / "history.csv"}
    options = vmdg.SolveOptions(energy=True, **shown)
    separated, growth = (0.525 if fibres == 1 else 0.65) * critical_gap, 1.04 if animate else 1.1
    # Fragments between two cracks may bridge them for long.
    loads = np.append(pulls(1e-4, separated, growth), separated * 1.1 ** np.arange(1, 32))
    history = vmdg.solve(problem, loads, options, monitor, until=lambda _: stage == 4).history
    axes["curve"].semilogx(100 * history["strain"], history["stress"], "k", zorder=0)
    axes["curve"].set(xlabel="strain [%]", ylabel="stress [MPa]")
    axes["curve"].legend(title="stage")
    if animate:
        film, shown = Path(out) / "fibre_matrix.gif", ("strain", "stress", "xx", 10, (0, 30))
        vmdg.plot.animate(film, problem, snapshots, history, *shown)
    if problem.comm.rank == 0:
        figure.savefig(Path(out) / "fibre_matrix.png")
        print(f"peak {history['stress'].max():.4g} MPa; results are in {out}")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    kinds, ways = ("quadrilateral", "triangle"), ("all", "on-demand")
    command.add_argument("--cell", choices=kinds, default=kinds[0], help="type of the cells")
    command.add_argument("--element-size", type=float, default=0.1, help="size of cells [mm]")
    command.add_argument("--critical-gap", type=float, default=0.2, help="zeta_c of bonds [mm]")
    command.add_argument("--fibres", type=int, default=1, help="number; many at random places")
    command.add_argument("--activate", choices=ways, default=ways[0], help="facets of the matrix")
    command.add_argument("--animate", action="store_true", help="also make a film")
    command.add_argument("--out", default="results/fibre_matrix", help="folder for the results")
    main(**vars(command.parse_args()))
