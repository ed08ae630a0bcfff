"""Periodic cells of crystals whose boundaries can fail, pictures, and a table of many cells."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import process_time

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import vmdg
from helpers.study import Table, reports
from vmdg.linear.ksp import LDLT
from vmdg.meshes import polycrystal
from vmdg.output.values import scalar

SIZE, LOW_ANGLE = 0.1, 15.0  # mm, degrees
NICKEL = {"C11": 246.5e3, "C12": 147.3e3, "C44": 124.7e3}  # MPa
STRENGTH, CRITICAL_GAP = 500.0, {2: 2e-4, 3: 4e-4}  # MPa, mm; by dimension, of coarser cells in 3D

#: Share of its strength below which a cell has parted: nothing but rounding and grains that rub.
PARTED = 1e-3

#: Share of the bonds that breaks from row to row of a path that is traced.
ROW = 0.01

COLUMNS = (
    "seed",
    "unknowns",
    "boundaries",
    "facets",
    "rows",
    "factorizations",
    "residuals",
    "failed",
    "jumps",
    "seconds",
    "strength [MPa]",
    "strain at the peak",
    "strain where parted",
    "stress at the end [MPa]",
)


@dataclass(frozen=True)
class Study:
    """Runs that differ in the places and orientations of the grains.

    Attributes:
        folder: For the table, histories and pictures.
        dimension: 2 or 3.
        grains: Their number.
        spread: Of their sizes.
        cells: Along the mean size of a grain.
        loads: Mean strains (n,).
        trace: Follow the path back at a snap, or else jump.
    """

    folder: Path
    dimension: int
    grains: int
    spread: float
    cells: float
    loads: NDArray[np.float64]
    trace: bool

    @property
    def table(self) -> Table:
        """What runs have found."""
        names = ("dimension", "grains", "spread", "cells", "trace")
        key = {n: getattr(self, n) for n in names} | {"end": self.loads[-1]}
        return Table(self.folder / "cells.csv", key, COLUMNS)

    def problem(self, seed: int, comm: MPI.Comm) -> vmdg.Problem:
        """A cell stretched along x by the load factor, free of stress across.

        Plane crystals turn about z, and boundaries between those that are turned by less than 15
        degrees against each other are twice as strong; turned in space hardly any two are so alike.

        Args:
            seed: Of places and rotations.
            comm: Communicator.
        """
        d, fine = self.dimension, SIZE * self.grains ** (-1 / self.dimension) / self.cells
        given = {"dim": d, "spread": self.spread, "size": SIZE, "element_size": fine}
        mesh, tags, _ = polycrystal(self.grains, seed, comm=comm, **given)
        turns = rotations(self.grains, d, seed)
        crystals = {n: vmdg.Cubic(**NICKEL, rotation=turns[n]) for n in range(1, self.grains + 1)}

        def alike(a: NDArray, b: NDArray) -> NDArray:
            return vmdg.misorientation(turns[a], turns[b]) < LOW_ANGLE

        strong, weak = (vmdg.Debonding(f * STRENGTH, CRITICAL_GAP[d]) for f in (2, 1))
        interfaces = [vmdg.Interface(between="all", law=weak, name="boundaries")]
        if d == 2:
            interfaces = [
                vmdg.Interface(between=alike, law=strong, name="low-angle"),
                vmdg.Interface(between=lambda a, b: ~alike(a, b), law=weak, name="high-angle"),
            ]
        kinds = {
            "kinematics": "small",
            "periodic": vmdg.Periodic(strain={"xx": lambda strain: strain}),
        }
        return vmdg.Problem(mesh, tags, crystals, interfaces, **kinds)

    def run(self, seed: int, comm: MPI.Comm, plot: bool, animate: bool, verbose: bool) -> None:
        """Stretch a cell to the end, and add its row to the table; collective."""
        name, start = f"{self.folder}/polycrystal_{seed}", process_time()
        problem = self.problem(seed, comm)
        monitor = CellMonitor(problem, animate)
        said = {"progress": reports(comm), "show": ("stress_xx",), "verbose": verbose}
        path = {"unstable": "trace", "max_share": ROW} if self.trace else {}
        # Tetrahedra between grains are flat: factors cost less than 130 iterations of multigrid.
        solver = path | {"petsc": LDLT if self.dimension == 3 else None}
        options = vmdg.SolveOptions(**solver, energy=True, csv=f"{name}.csv", **said)
        try:
            result = vmdg.solve(problem, self.loads, options, monitor)
        except vmdg.StepFailure as failure:
            if comm.rank == 0:
                print(f"seed {seed}: {failure}")
            return
        if animate:
            shown = "strain_xx", "stress_xx", "xx", 20
            vmdg.plot.animate(f"{name}.gif", problem, monitor.snapshots, result.history, *shown)
        if plot:
            draw_run(problem, result.history, monitor.states, f"{name}.png")
        row = seed, *size_of(problem), *found(result, process_time() - start)
        if comm.rank == 0:
            self.table.add(*row)
        comm.barrier()

    def summary(self) -> str:
        """Means and standard deviations over the seeds."""
        rows = self.table.read()
        lines = [f"{len(rows)} cells of {self.grains} grains"]
        for name, column in zip(COLUMNS[1:], rows.T[1:], strict=True):
            known = column[np.isfinite(column)]
            if len(known):
                scatter = known.std(ddof=len(known) > 1)
                lines.append(f"  {name}: {known.mean():.4g} +- {scatter:.2g} of {len(known)}")
        return "\n".join(lines)


def rotations(grains: int, dimension: int, seed: int) -> NDArray[np.float64]:
    """A rotation for every grain, about z in the plane (grains + 1, 3, 3); the first is of none."""
    if dimension == 3:
        return Rotation.random(grains + 1, random_state=seed).as_matrix()
    angle = np.random.default_rng(seed).uniform(0, 90, grains + 1)
    return Rotation.from_euler("z", angle[:, None], degrees=True).as_matrix()


def size_of(problem: vmdg.Problem) -> tuple[int, int, int]:
    """Unknowns, boundaries between two grains, facets of all of them; collective."""
    dofs = problem.space.dofmap
    tags = np.concatenate([facets.tags for facets in problem.step.activation.facets])
    tags = np.concatenate(problem.comm.allgather(tags))
    unknowns = dofs.index_map.size_global * dofs.index_map_bs
    return unknowns, len(np.unique(np.sort(tags, axis=1), axis=0)), len(tags)


def found(result: vmdg.Result, seconds: float) -> tuple[float, ...]:
    """Columns from the rows of the run on; no strain where it has not parted."""
    history, counts = result.history, result.counts
    strain, stress = history["strain_xx"], history["stress_xx"]
    above = np.flatnonzero(np.abs(stress) > PARTED * stress.max())[-1]
    parted = strain[above + 1] if above + 1 < len(stress) else np.nan
    work = len(history), counts.factorizations, counts.residuals, len(result.failures)
    jumps = np.count_nonzero(history["jump_steps"])
    return *work, jumps, seconds, stress.max(), strain[stress.argmax()], parted, stress[-1]


def damage(problem: vmdg.Problem) -> NDArray[np.float64]:
    """Places and Q/strength of all points of all interfaces (n, d + 1), on rank 0; collective."""
    d = problem.mesh.geometry.dim
    rows = [
        np.column_stack([state.points[:, :d], scalar(problem, interface, "damage")])
        for state, interface in zip(problem.state, problem.interfaces, strict=True)
    ]
    parts = problem.comm.gather(np.concatenate(rows))
    return np.concatenate(parts) if parts else np.zeros((0, d + 1))


class CellMonitor:
    """Monitor of a run: what a cell has for every row, and states for pictures; collective.

    Args:
        problem: A periodic cell.
        film: Whether to keep what a film needs.

    Attributes:
        states: :func:`damage` of every row.
        snapshots: Of every row, for a film; else none.
    """

    def __init__(self, problem: vmdg.Problem, film: bool):
        self._cell, self._film = vmdg.PeriodicCell(problem), film
        self.states, self.snapshots = [], []

    def __call__(self, problem: vmdg.Problem) -> dict[str, float]:
        """Columns of the row."""
        if self._film:
            self.snapshots.append(problem.step.snapshot())
        self.states.append(damage(problem))
        return self._cell.row()


def draw_damage(ax: Axes, points: NDArray, title: str) -> None:
    """Points of the interfaces, coloured by their damage; in space those that have much of it.

    Args:
        ax: Where to draw.
        points: Of :func:`damage`.
        title: Of the picture.
    """
    if points.shape[1] == 4:
        points = points[points[:, 3] > 0.5]
        ax.set(xlim=(0, SIZE), ylim=(0, SIZE), zlim=(0, SIZE))
    colours = {"c": points[:, -1], "cmap": "inferno_r", "vmin": 0, "vmax": 1}
    drawn = ax.scatter(*points[:, :-1].T, s=4, **colours)
    ax.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", title=title)
    vmdg.plot.add_colorbar(ax, drawn)


def draw_run(
    problem: vmdg.Problem, history: vmdg.History, states: list[NDArray], path: str
) -> None:
    """Curve, damage at the peak or in space at the end, stress at the end; collective."""
    solid = problem.mesh.geometry.dim == 3
    space = {"projection": "3d"} if solid else {}
    figure = plt.figure(figsize=(12, 3.6), layout="constrained")
    axes = [figure.add_subplot(1, 3, n, **(space if n > 1 else {})) for n in (1, 2, 3)]
    vmdg.plot.curve(history, "strain_xx", "stress_xx", ax=axes[0], origin=True, color="black")
    row, when = (-1, "end") if solid else (int(np.argmax(history["stress_xx"])), "peak")
    draw_damage(axes[1], states[row], f"damage at the {when}, {history['strain_xx'][row]:.2%}")
    vmdg.plot.stress(problem, "xx", magnify=10, ax=axes[2], edges=0.2 if solid else 0)
    if solid:
        for ax in axes[1:]:
            ax.locator_params(nbins=3)
            ax.set(zlabel="")
    if problem.comm.rank == 0:
        figure.savefig(path, dpi=130)
    plt.close(figure)
