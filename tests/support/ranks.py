"""Scenes at a coarse size on these ranks, compared with what other numbers of ranks gave.

    demos/run -n 1 tests/support/ranks.py FOLDER [SCENE...]
    demos/run -n 4 tests/support/ranks.py FOLDER [SCENE...]

For every run of :func:`vmdg.solve` rank 0 writes the number of unknowns, the iterations of all
steps, and the norm of the reactions at the end of every step to the folder.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

import vmdg
from vmdg.base.parallel import global_norm
from vmdg.meshes import blocks, fibre_matrix, random_fibres

sys.path.append(str(Path(__file__).resolve().parents[2] / "demos"))
sys.path.append(str(Path(__file__).resolve().parents[2] / "demos" / "studies"))
import fibre_matrix as cell
import load_cycle
import pushout
from parts import two_inclusions

#: Problems and the loads of their runs, one after the other.
Runs = Iterator[tuple[vmdg.Problem, NDArray]]


def cycle(steps: int) -> Runs:
    """Open, close, press, shear, reopen."""
    mesh, cells, facets = blocks(MPI.COMM_WORLD, "quadrilateral")
    material = vmdg.NeoHookean(E=5000.0, nu=0.25)
    interface = vmdg.Interface(between=(1, 2), law=load_cycle.LAW)
    problem = vmdg.Problem(mesh, cells, {1: material, 2: material}, [interface])
    problem.dirichlet(facets.find(1), 0.0)
    problem.dirichlet(facets.find(2), load_cycle.end_of_path)
    yield problem, np.linspace(0, len(load_cycle.LEGS), steps + 1)[1:]


def cracks(shape: str, size: float, critical_gap: float, end: float, **random) -> Runs:
    """One fibre with all facets of the matrix, or several at random with facets on demand."""
    centres, radius = np.array([[cell.SIZE / 2 - 0.01, cell.SIZE / 2]]), cell.RADIUS
    if random:
        centres, radius = random_fibres(size=cell.SIZE, seed=0, **random)
    mesh = fibre_matrix(MPI.COMM_WORLD, shape, cell.SIZE, radius, centres, size)
    activate = "on-demand" if random else "all"
    problem = cell.build(mesh, critical_gap, activate)
    yield problem, cell.pulls(1e-4, end, 1.1)


def push(solid: bool, layers: int, refine: float, steps: int, end: float) -> Runs:
    """Cure and push-out."""
    model = pushout.build(solid, layers, refine, pushout.FRICTION, pushout.FIBRE_MODULUS)
    yield model.problem, np.array([0.5, 1.0])
    model.problem.dirichlet(model.top, lambda t: 1 - t, model.axis, relative=True)
    yield model.problem, 1 + np.linspace(0, end, steps + 1)[1:]


def inclusions(size: float) -> Runs:
    """Two inclusions under the public law."""
    problem, _ = two_inclusions.build(two_inclusions.LAWS["intrinsic"], 1, size)
    yield problem, np.linspace(0, two_inclusions.END, 41)[1:]


SCENES = {
    "load cycle": lambda: cycle(20),
    "fibre": lambda: cracks("quadrilateral", 0.3, 0.01, 0.00525),
    "fibres, on demand": lambda: cracks("triangle", 0.4, 0.2, 1e-3, count=4, fraction=0.35),
    "push-out, section": lambda: push(False, 25, 0.5, 10, 0.174),
    "push-out": lambda: push(True, 5, 0.4, 3, 0.03),
    "inclusions": lambda: inclusions(0.1),
}


def differences(folder: Path) -> list[tuple[str, int, float]]:
    """Scene, ranks, and largest difference of the forces from those of one rank, relative.

    Infinite where unknowns or the number of steps differ. Iterations may: at rest a residual is
    rounding, and below its bound or not.
    """
    alone = json.loads((folder / "ranks_1.json").read_text())
    found = []
    for file in sorted(folder.glob("ranks_*.json")):
        several, ranks = json.loads(file.read_text()), int(file.stem.split("_")[1])
        for name in alone.keys() & several.keys():
            pairs = zip(alone[name], several[name], strict=True)
            found.append((name, ranks, max(difference(*pair) for pair in pairs)))
    return sorted(found)


def difference(run: dict, other: dict) -> float:
    """Largest one of the forces of two runs, relative to the largest force, or infinite."""
    if run["unknowns"] != other["unknowns"] or len(run["forces"]) != len(other["forces"]):
        return float("inf")
    forces = np.array(run["forces"])
    return float(np.abs(forces - other["forces"]).max() / forces.max())


def solve(problem: vmdg.Problem, loads: NDArray) -> dict:
    """Unknowns at the end, iterations of all steps, and reactions at the given load factors."""
    forces = []

    def look(problem: vmdg.Problem) -> None:
        if problem.t not in loads:
            return
        # Facets that open renumber the dofs.
        reactions = problem.discretization.forces.x.array[problem.loading.owned_prescribed]
        forces.append(global_norm(problem.comm, reactions))

    options = vmdg.SolveOptions(relative_tolerance=1e-11, energy=True)
    iterations = vmdg.solve(problem, loads, options, look).history["iterations"].tolist()
    size = problem.space.dofmap.index_map.size_global
    return {"unknowns": size, "iterations": iterations, "forces": forces}


def main(names: list[str], folder: Path) -> None:
    """Run these scenes; writes ``folder``/ranks_N.json."""
    found = {name: [solve(*run) for run in SCENES[name]()] for name in names}
    ranks = MPI.COMM_WORLD.size
    if MPI.COMM_WORLD.rank == 0:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"ranks_{ranks}.json").write_text(json.dumps(found))
        if (folder / "ranks_1.json").is_file():
            for name, ranks, largest in differences(folder):
                print(f"{name:20} {ranks:3} ranks, forces differ by {largest:.1e}")


if __name__ == "__main__":
    main(sys.argv[2:] or list(SCENES), Path(sys.argv[1]))
