"""Strengths of many periodic cells of fibres: their scatter against bounds, and a failure envelope.

Loads cells of the example ``fibre_cell``: ``--seeds 10`` gives mean and scatter of the strength,
``--directions 4 --seeds 3`` an envelope of 12 runs from pull to shear. Several runs are shared by
the ranks of ``demos/run -n 2``, one by all of them; those that ``strengths.csv`` has are not done
again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx.mesh import entities_to_geometry
from numpy.typing import NDArray
from parts.options import run
from parts.scenes import fibre_cell
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

import vmdg
from vmdg.meshes import TaggedMesh

#: Share of its strength below which a cell has failed.
FALLEN = 0.9

KEY = ("fibres", "fraction", "friction", "cells")
COLUMNS = (
    "seed",
    "angle [deg]",
    "stress_xx [MPa]",
    "stress_xy [MPa]",
    "bulk [MPa]",
    "shear [MPa]",
    "cut [MPa]",
    "share",
)


@dataclass(frozen=True)
class Study:
    """Runs that differ in the places of the fibres and in the direction of the mean strain."""

    folder: Path  # For strengths and histories
    fibres: int  # Number of fibres
    fraction: float  # Share of the area that they have
    friction: float  # Of surfaces that have parted
    cells: float  # Along the radius of a fibre
    loads: NDArray[np.float64]  # Sizes of the mean strain (n,)

    @property
    def file(self) -> Path:
        """With one line a run, of all studies in this folder."""
        return self.folder / "strengths.csv"

    @property
    def key(self) -> list[float]:
        """What the runs of this study have in common."""
        return [getattr(self, name) for name in KEY]

    def read(self) -> NDArray[np.float64]:
        """Rows of this study without its key, ordered by their columns (n, m)."""
        lines = self.file.read_text().splitlines()[1:] if self.file.is_file() else []
        width = len(KEY) + len(COLUMNS)
        rows = np.reshape([[float(v) for v in line.split(",")] for line in lines], (-1, width))
        own = rows[np.isclose(rows[:, : len(KEY)], self.key).all(axis=1), len(KEY) :]
        return own[np.lexsort(own.T[::-1])]

    def left(self, runs: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
        """Those of some runs, by seed and angle, that have no row; collective."""
        comm = MPI.COMM_WORLD
        if comm.rank == 0 and not self.file.is_file():
            self.folder.mkdir(parents=True, exist_ok=True)
            self.file.write_text(",".join([*KEY, *COLUMNS]) + "\n")
        known = {tuple(row[:2]) for row in comm.bcast(self.read())}
        return [run for run in runs if run not in known]

    def run(self, seed: int, angle: float, comm: MPI.Comm, verbose: bool) -> None:
        """Load a cell, and add its strength to the file once it has failed; collective."""
        tagged = fibre_cell.make_mesh(self.fibres, self.fraction, seed, self.cells, comm)
        problem = fibre_cell.make_problem(tagged, angle, self.friction)
        known = *plane_moduli(problem), shortest_cut(problem), fibre_share(tagged)
        shown = comm.size > 1 or MPI.COMM_WORLD.rank == 0
        said = {"progress": shown, "show": ("stress_xx", "stress_xy"), "verbose": verbose}
        table, monitor = f"fibre_cell_{seed}_{angle:g}.csv", vmdg.PeriodicCell(problem)
        options = vmdg.SolveOptions(energy=True, csv=self.folder / table, **said)
        try:
            history = vmdg.solve(problem, self.loads, options, lambda _: monitor.row()).history
        except vmdg.StepFailure as failure:
            # The strength is known behind the peak; other runs have yet to be done.
            history = failure.result.history
            size = np.hypot(history["stress_xx"], history["stress_xy"])
            if comm.rank == 0:
                print(f"seed {seed}, {angle:g} degrees, at {size[-1]:.3g} MPa: {failure}")
            if size[-1] > FALLEN * size.max():
                return
        both = np.column_stack([history["stress_xx"], history["stress_xy"]])
        peak = both[np.argmax(np.linalg.norm(both, axis=1))]
        if comm.rank == 0:
            with open(self.file, "a") as file:
                row = *self.key, seed, angle, *peak, *known
                file.write(",".join(repr(float(value)) for value in row) + "\n")
        comm.barrier()

    def summary(self) -> str:
        """Means and standard deviations over the seeds, and the bounds they keep."""
        rows, lines = self.read(), []
        for angle in np.unique(rows[:, 1]):
            own = rows[rows[:, 1] == angle]
            means = [f"{x.mean():.4g} +- {x.std(ddof=len(own) > 1):.2g}" for x in own[:, 2:].T]
            lines.append(
                f"{len(own)} cells, {angle:g} degrees: stress xx {means[0]}, xy {means[1]} MPa; "
                f"weakest cut across x {means[4]} MPa; bulk {means[2]}, shear {means[3]} MPa"
            )
        share = rows[:, 7].mean() if len(rows) else self.fraction
        low, high = hashin_shtrikman(share)
        lines.append(
            f"bounds of Hashin at {share:.4f} of fibres: bulk {low[0]:.4g} to {high[0]:.4g}, shear "
            f"{low[1]:.4g} to {high[1]:.4g} MPa"
        )
        return "\n".join(lines)


def plane_moduli(problem: vmdg.Problem) -> tuple[float, float]:
    """Mean bulk and shear modulus of plane strain at the start, over all directions [MPa]."""
    C = vmdg.macroscopic_tangent(problem)
    bulk = (C[0, 0, 0, 0] + C[1, 1, 1, 1] + 2 * C[0, 0, 1, 1]) / 4
    along = (C[0, 0, 0, 0] + C[1, 1, 1, 1] - 2 * C[0, 0, 1, 1]) / 4
    return bulk, (along + C[0, 1, 0, 1]) / 2


def fibre_share(tagged: TaggedMesh) -> float:
    """Share of the area that the fibres have in the mesh, where they are polygons; collective."""
    mesh, cells, _ = tagged
    owned = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    corners = mesh.geometry.x[entities_to_geometry(mesh, 2, owned)]
    area = np.abs(np.linalg.det(corners[:, 1:, :2] - corners[:, :1, :2]))
    fibre = area[np.isin(owned, cells.find("fibre"))].sum()
    return float(mesh.comm.allreduce(fibre) / mesh.comm.allreduce(area.sum()))


def hashin_shtrikman(fraction: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Lower and upper bound of bulk and shear modulus across the fibres [MPa].

    For plane strain, k = lambda + mu; fibres that are stiffer in both; Hashin 1965 (JMPS 13, 119).
    """
    found = []
    shares = {"matrix": 1 - fraction, "fibre": fraction}
    m = {name: E / (2 + 2 * nu) for name, (E, nu) in fibre_cell.ELASTIC.items()}
    k = {name: m[name] / (1 - 2 * nu) for name, (_, nu) in fibre_cell.ELASTIC.items()}
    for one, two in (("matrix", "fibre"), ("fibre", "matrix")):
        f, f_other = shares[one], shares[two]
        bulk = k[one] + f_other / (1 / (k[two] - k[one]) + f / (k[one] + m[one]))
        soft = f * (k[one] + 2 * m[one]) / (2 * m[one] * (k[one] + m[one]))
        found.append((bulk, m[one] + f_other / (1 / (m[two] - m[one]) + soft)))
    return tuple(found)


def shortest_cut(problem: vmdg.Problem) -> float:
    """Without friction no pull along x alone is larger: the weakest cut [MPa]; collective.

    Along any path of facets from an image of a point to the next one along y the tractions balance
    the mean stress. Where the path leads upwards each is the strength at most along x: pressed
    facets push back (a minimal cut; Strang 1983, Math. Program. 26, 123).
    """
    mesh, rows = problem.mesh, []
    for interface, own in zip(problem.interfaces, problem.step.activation.facets, strict=True):
        ends = mesh.geometry.x[entities_to_geometry(mesh, 1, own.facets), :2]
        rows.append(np.insert(ends.reshape(-1, 4), 4, interface.law.strength, axis=1))
    size = problem.comm.allreduce(mesh.geometry.x.max(), MPI.MAX)
    parts, least = problem.comm.gather(np.concatenate(rows)), np.inf
    if parts:
        rows = np.concatenate(parts)
        ends = rows[:, :4].reshape(-1, 2, 2) / size
        weight = rows[:, 4] * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        # Upwards, level edges to both sides.
        down, level = ends[:, 1, 1] < ends[:, 0, 1], ends[:, 1, 1] == ends[:, 0, 1]
        ends[down] = ends[down, ::-1]
        ends, weight = np.append(ends, ends[level, ::-1], axis=0), np.append(weight, weight[level])
        # Left and right are one place, bottom and top are not.
        places = np.round(ends, 7).reshape(-1, 2) % [1.0, 2.0]
        nodes, number = np.unique(places, axis=0, return_inverse=True)
        graph = coo_array((weight, number.reshape(-1, 2).T), shape=(len(nodes),) * 2).tocsr()
        low, high = ({x: n for n, (x, y) in enumerate(nodes) if y == side} for side in (0, 1))
        for x in low.keys() & high.keys():
            least = min(least, dijkstra(graph, indices=low[x])[high[x]])
    return float(problem.comm.bcast(least))


def draw_envelope(rows: NDArray[np.float64], path: Path) -> None:
    """Strengths in the plane of pull and shear, the means of every direction joined.

    Where both are known, with the quadratic criterion (stress_xx/X)^2 + (stress_xy/S)^2 = 1 of the
    means X of tension and S of shear (Hashin 1980, J. Appl. Mech. 47, 329).
    """
    figure, ax = plt.subplots(figsize=(4.6, 4.2), layout="constrained")
    angle, pull, shear = rows.T[1:4]
    ax.plot(pull, shear, "C0o", mfc="none", label="one cell")
    means = {a: rows[angle == a, 2:4].mean(axis=0) for a in np.unique(angle)}
    ax.plot(*np.transpose(list(means.values())), color="black", label="mean of the cells")
    if {0.0, 90.0} <= means.keys():
        t = np.linspace(0, np.pi / 2)
        ellipse = means[0.0][0] * np.cos(t), means[90.0][1] * np.sin(t)
        ax.plot(*ellipse, color="gray", linestyle=":", label="quadratic criterion")
    ax.set(xlabel="mean tension [MPa]", ylabel="mean shear [MPa]", ylim=0)
    ax.legend()
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(path)
    plt.close(figure)


def main(
    fibres: int = 7,
    fraction: float = 0.5,
    directions: int = 1,
    first: float = 0.0,
    last: float = 90.0,
    friction: float = 0.0,
    seeds: int = 3,
    seed: int = 0,
    cells: float = 2.5,
    end: float = 0.02,
    steps: int = 8,
    out: str = "results/fibre_cell_strengths",
    verbose: bool = False,
) -> np.ndarray:
    """Load every cell in every direction beyond its strength; rows of its table.

    Args:
        fibres: Number of fibres.
        fraction: Share of the area that they have [-].
        directions: Of the mean strain, from the first to the last; 1 for the first alone.
        first: Direction [degrees].
        last: Direction [degrees].
        friction: Of surfaces that have parted [-].
        seeds: Number of cells.
        seed: Of the first one.
        cells: Along the radius of a fibre [-].
        end: Size of the mean strain at the end [-].
        steps: Given strains on the way.
        out: Folder for histories, strengths and the envelope.
        verbose: Print the residuals of every step.
    """
    study = Study(Path(out), fibres, fraction, friction, cells, np.linspace(0, end, steps + 1)[1:])
    angles, world = np.linspace(first, last, directions), MPI.COMM_WORLD
    asked = [(float(n), angle) for n in range(seed, seed + seeds) for angle in angles]
    # One run by all ranks, several shared by them.
    runs, comm = study.left(asked), world
    if len(asked) > 1:
        runs, comm = runs[world.rank :: world.size], MPI.COMM_SELF
    for number, angle in runs:
        study.run(int(number), angle, comm, verbose)
    world.barrier()
    rows = study.read()
    draw_envelope(rows, study.folder / "envelope.png")
    if world.rank == 0:
        print(study.summary())
    if left := study.left(asked):
        raise RuntimeError(f"runs of these seeds and angles have stopped before they fail: {left}")
    return rows


if __name__ == "__main__":
    run(main)
