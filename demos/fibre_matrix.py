"""Fibre-matrix debonding with matrix cracks: section 7.2 of the report, Figures 9 to 12.

A square of matrix with a fibre (or many) is pulled apart at its left and right side. The bond of
the fibre fails first, at its poles; cracks, which may run along every facet of the matrix, leave
the interface and grow to the edges until the cell is in two parts. Two equal cracks would be an
unstable equilibrium: the single fibre is ``offset`` from the middle, which selects a branch.
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

SIZE, RADIUS = 1.0, 0.25  # mm
REPORT = {"fibre": vmdg.NeoHookean(E=40e3, nu=0.4), "matrix": vmdg.NeoHookean(E=10e3, nu=0.33)}
#: What starts in a stage, and the factor on the displacement of its picture.
STAGES = {
    "debonding starts": 20,
    "cracks kink into the matrix": 20,
    "cracks reach an edge": 20,
    "separation": 1,
}


def build(
    tagged: meshes.TaggedMesh,
    materials: dict[str, vmdg.Material],
    critical_gap: float,
    cracks: str | None = None,
    kinematics: str = "finite",
) -> vmdg.Problem:
    """A cell whose sides are pulled apart, each by the load factor [mm].

    Args:
        tagged: Of :func:`vmdg.meshes.fibre_matrix`.
        materials: Of "fibre" and "matrix".
        critical_gap: Of the bonds [mm].
        cracks: How facets of the matrix are activated; None without cracks in the matrix.
        kinematics: "finite" or "small".
    """
    mesh, cells, sides = tagged
    bond = vmdg.Debonding(strength=10.0, critical_gap=critical_gap)
    interfaces = [vmdg.Interface(between=("fibre", "matrix"), law=bond)]
    if cracks:
        crack = vmdg.Debonding(strength=30.0, critical_gap=critical_gap)
        interfaces.append(vmdg.Interface(within="matrix", law=crack, activate=cracks))
    problem = vmdg.Problem(mesh, cells, materials, interfaces, kinematics=kinematics)
    problem.dirichlet(sides.find("left"), lambda pull: -pull, "x")
    problem.dirichlet(sides.find("right"), lambda pull: pull, "x")

    def middle(x: NDArray) -> NDArray:
        return np.isclose(x[1], SIZE / 2) & (np.isclose(x[0], 0) | np.isclose(x[0], SIZE))

    problem.dirichlet_points(middle, 0.0, "y")
    return problem


def pulls(step: float, end: float, growth: float, constant: float = 0.003) -> NDArray[np.float64]:
    """Displacements of a side [mm]: equal steps to ``constant``, then growing ones to ``end``."""
    values, size = [step], step
    while values[-1] < end * (1 - 1e-9):
        if values[-1] > constant:
            size = min(size * growth, end / 12)
        values.append(min(values[-1] + size, end))
    return np.array(values)


def events(problem: vmdg.Problem, near: float) -> list[bool]:
    """Whether the bond is damaged, the matrix, and the matrix ``near`` an edge [mm]; collective."""
    damaged = [state.points[state.softening > 0] for state in problem.state]
    matrix = damaged[1] if len(damaged) > 1 else np.zeros((0, 3))
    at_edge = np.abs(matrix[:, 1] - SIZE / 2) > SIZE / 2 - near
    counts = np.array([len(damaged[0]), len(matrix), at_edge.sum()])
    return list(problem.comm.allreduce(counts) > 0)


def main(
    cell: str = "quadrilateral",
    element_size: float = 0.1,
    critical_gap: float = 0.2,
    step: float = 1e-4,
    growth: float = 1.1,
    end: float | None = None,
    fibres: int = 1,
    fraction: float = 0.35,
    offset: float = 0.01,
    activate: str = "all",
    interface_only: bool = False,
    animate: bool = False,
    out: str = "results/fibre_matrix",
    seed: int = 0,
) -> vmdg.History:
    """Pull both sides until the cell is in parts, or to the end; the history of the run."""
    centres, radius = np.array([[SIZE / 2 - offset, SIZE / 2]]), RADIUS
    if fibres > 1:
        centres, radius = meshes.random_fibres(fibres, fraction, SIZE, seed=seed)
    tagged = meshes.fibre_matrix(MPI.COMM_WORLD, cell, SIZE, radius, centres, element_size)
    problem = build(tagged, REPORT, critical_gap, None if interface_only else activate)
    right = tagged.facet_tags.find("right")
    figure = plt.figure(figsize=(11, 6.6), layout="constrained")
    axes = figure.subplot_mosaic([[*STAGES][:2] + ["curve"], [*STAGES][2:] + ["gap"]])
    stage, peak, snapshots = 0, 0.0, []

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        nonlocal stage, peak
        force = problem.reaction(right)[0]
        peak = max(peak, abs(force))
        come = [*events(problem, element_size / 2), abs(force) < 1e-3 * peak]
        while stage < 4 and come[stage]:
            show(stage)
            stage += 1
        if animate:
            snapshots.append(problem.snapshot())
        nodes = problem.space.dofmap.index_map.size_global
        row = {"strain [-]": 2 * problem.t / SIZE, "stress [MPa]": force / SIZE}
        return row | {"stage [-]": stage, "nodes [-]": nodes}

    def show(number: int) -> None:
        name, scale = list(STAGES.items())[number]
        style = {"limits": (0, 30), "edges": 0.2, "colorbar": number % 2 == 1}
        vmdg.plot.stress(problem, "xx", scale, axes[name], **style)
        axes[name].set_title(f"{number + 1} {name}\n{problem.t * 1e3:.3g} µm, x {scale}", size=9)
        theta, gap = vmdg.profile(problem, 0, "opening", "angle")[0].T
        label = f"stage {number + 1}, max {gap.max() * 1e3:.3g} µm"
        axes["gap"].plot(theta, gap / gap.max(), color=f"C{number}", label=label)

    # Fragments that hang on a last point invite distant equilibria: watch the energy.
    shown = {"progress": True, "show": ("stress", "stage"), "csv": Path(out) / "history.csv"}
    options = vmdg.SolveOptions(relative_tolerance=1e-8, energy=True, **shown)
    separated = (0.525 if fibres == 1 else 0.65) * critical_gap
    loads = pulls(step, end or (0.005 if interface_only else separated), growth)
    if not (end or interface_only):
        # Fragments between two cracks may bridge them for long.
        loads = np.append(loads, separated * 1.1 ** np.arange(1, 32))
    history = vmdg.solve(problem, loads, options, monitor, until=lambda _: stage == 4).history

    if animate:
        film = Path(out) / "fibre_matrix.gif"
        shown = "strain", "stress", "xx", 10, (0, 30)
        vmdg.plot.animate(film, problem, snapshots, history, *shown)
    strain, stress = history["strain"], history["stress"]
    axes["curve"].semilogx(100 * strain, stress, color="black")
    for number, name in enumerate(STAGES):
        axes[name].set_visible(number < stage)
        if number < stage:
            first = np.argmax(history["stage"] > number)
            axes["curve"].plot(100 * strain[first], stress[first], "o", label=f"{number + 1}")
    axes["curve"].set(xlabel="strain [%]", ylabel="stress [MPa]")
    axes["gap"].set(xlabel="angle [°]", ylabel="normal gap / largest", xlim=(0, 360), ylim=(0, 1.7))
    if stage:
        axes["curve"].legend(title="stage")
        axes["gap"].legend(fontsize=8)
    if problem.comm.rank == 0:
        figure.savefig(Path(out) / "fibre_matrix.png", dpi=110)
        lost = history["imbalance"][-1] / history["external"][-1]
        print(f"{len(history)} steps, peak {stress.max():.4g} MPa, stage {stage}")
        print(f"energy imbalance {lost:.2e} of the work; results are in {out}")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    kinds = ("quadrilateral", "triangle")
    command.add_argument("--cell", choices=kinds, default=kinds[0], help="type of the cells")
    command.add_argument("--element-size", type=float, default=0.1, help="of the cells [mm]")
    command.add_argument("--critical-gap", type=float, default=0.2, help="zeta_c of bonds [mm]")
    command.add_argument("--step", type=float, default=1e-4, help="first pulls of a side [mm]")
    command.add_argument(
        "--growth", type=float, default=1.1, help="growth of steps beyond 0.003 mm [-]"
    )
    command.add_argument("--end", type=float, help="pull at the end; until it has parted [mm]")
    command.add_argument("--fibres", type=int, default=1, help="number; many at random places")
    command.add_argument("--fraction", type=float, default=0.35, help="of many fibres [-]")
    command.add_argument("--offset", type=float, default=0.01, help="of one from the middle [mm]")
    ways = ("all", "on-demand")
    command.add_argument("--activate", choices=ways, default=ways[0], help="facets of the matrix")
    command.add_argument("--interface-only", action="store_true", help="no cracks in the matrix")
    command.add_argument("--animate", action="store_true", help="make a film, too")
    command.add_argument("--out", default="results/fibre_matrix", help="folder for the results")
    command.add_argument("--seed", type=int, default=0, help="of the random places")
    main(**vars(command.parse_args()))
