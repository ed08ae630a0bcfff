"""Scenes at a coarse size on these ranks, compared with what other numbers of ranks gave.

    demos/run -n 1 tests/support/ranks.py FOLDER [SCENE...]
    demos/run -n 4 tests/support/ranks.py FOLDER [SCENE...]

For every run of :func:`vmdg.solve` rank 0 writes the number of unknowns, the iterations of all
steps, and the norm of the reactions and the works at the end of every step to the folder.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

import vmdg
from vmdg.base.parallel import global_norm
from vmdg.meshes import apart as put_together
from vmdg.meshes import blocks, fibre_matrix, random_fibres

sys.path.append(str(Path(__file__).resolve().parents[1]))
sys.path.append(str(Path(__file__).resolve().parents[2] / "demos"))
sys.path.append(str(Path(__file__).resolve().parents[2] / "demos" / "studies"))
import ductile_grains
import fibre_matrix as cell
import load_cycle
import pushout
import two_inclusions

from support import apart
from support.scenes import DIMENSION

HARD_AND_SOFT = {1: vmdg.NeoHookean(E=1000.0, nu=0.3), 2: vmdg.NeoHookean(E=300.0, nu=0.3)}

FLOWING = {1: HARD_AND_SOFT[1], 2: vmdg.J2(300.0, 0.3, 4.0, hardening=30.0)}

#: Laws of bodies that slide.
WEAK = vmdg.Debonding(strength=3.0, critical_gap=0.03, friction=0.3)
RUBS = vmdg.Contact(friction=0.3)

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
    model = pushout.build(solid, layers, refine, pushout.LAW, pushout.FIBRE_MODULUS)
    yield model.problem, np.array([0.5, 1.0])
    model.problem.dirichlet(model.top, lambda t: 1 - t, model.axis, relative=True)
    yield model.problem, 1 + np.linspace(0, end, steps + 1)[1:]


def inclusions(size: float) -> Runs:
    """Two inclusions under the public law."""
    problem, _ = two_inclusions.build(two_inclusions.LAWS["intrinsic"], 1, size)
    yield problem, np.linspace(0, two_inclusions.END, 41)[1:]


def grains() -> Runs:
    """Grains that flow at a crack, until all of their boundaries across the square have come off.

    Where the last one does, the damage work along the path is rounding.
    """
    problem, _ = ductile_grains.build(12, 2.5, 1, ductile_grains.YIELDS["hard"], 300.0)
    yield problem, np.linspace(0.0, 7e-3, 8)[1:]


def rings() -> Runs:
    """A ring bonded in another one, with curved cells 2:3, that is pulled off."""
    scene = apart.rings("triangle", (16, 24), (1.0, 2.0, 3.0), 2, MPI.COMM_WORLD)
    law = vmdg.Debonding(strength=10.0, critical_gap=0.3, friction=0.3)
    interface = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, HARD_AND_SOFT, [interface], degree=2)
    problem.dirichlet(scene.facet_tags.find(11), 0.0)
    problem.dirichlet(scene.facet_tags.find(22), lambda t: (t, 0.3 * t))
    yield problem, np.linspace(0.02, 0.2, 5)


def cantilever() -> Runs:
    """A double cantilever whose arms have 16 and 24 cells, at small strain."""
    parts = [
        apart.block("quadrilateral", (16, 2), (0.0, -1.0), (20.0, 0.0), 1, MPI.COMM_WORLD),
        apart.block("quadrilateral", (24, 2), (0.0, 0.0), (20.0, 1.0), 2, MPI.COMM_WORLD),
    ]
    scene = put_together(parts)
    interface = vmdg.Interface(
        between=(1, 2),
        law=vmdg.Debonding(strength=1.0, critical_gap=0.15),
        initial_damage=lambda x: np.where(x[0] < 6.0, 1.0, 0.0),
    )
    given = scene.mesh, scene.cell_tags, HARD_AND_SOFT, [interface]
    problem = vmdg.Problem(*given, degree=2, kinematics="small")
    for y in (-1.0, 1.0):
        corner = partial(_corner, y=y)
        problem.dirichlet_points(corner, 0.0, "x")
        problem.dirichlet_points(corner, lambda t, y=y: y * t, "y")
    problem.dirichlet(lambda x: np.isclose(x[0], 20.0), 0.0)
    yield problem, np.linspace(0.0, 1.2, 5)[1:]


def _corner(x: NDArray, y: float) -> NDArray:
    return np.isclose(x[0], 0.0) & np.isclose(x[1], y)


def sliding(
    cell: str,
    law: vmdg.Law = WEAK,
    materials: dict[int, vmdg.Material] = HARD_AND_SOFT,
    way: float = 1.0,
    **options,
) -> Runs:
    """A block is pressed on a longer one, where its bond breaks, and slides along it."""
    d = DIMENSION[cell]
    sides = [((9, 4, 2), (0.0, 0.0, -1.0), (3.0, 1.2, 0.0))]
    sides += [((3, 3, 2), (0.6, 0.1, 0.0), (1.6, 1.1, 1.0))]
    axes = [0, 1, 2] if d == 3 else [0, 2]
    parts = [
        apart.block(cell, *([array[i] for i in axes] for array in side), tag, MPI.COMM_WORLD)
        for tag, side in enumerate(sides, start=1)
    ]
    scene = put_together(parts)
    interface = vmdg.Interface(between=(1, 2), law=law, sliding=True)
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, materials, [interface], **options)
    problem.dirichlet(scene.facet_tags.find(11), 0.0)

    def top(t: float) -> NDArray:
        return np.array([way * max(t - 1.0, 0.0), *[0.0] * (d - 2), -0.05 * min(t, 1.0)])

    problem.dirichlet(scene.facet_tags.find(22), top)
    yield problem, np.array([0.5, 1.0, 1.1, 1.4, 1.8])


SCENES = {
    "load cycle": lambda: cycle(20),
    "fibre": lambda: cracks("quadrilateral", 0.3, 0.01, 0.00525),
    "fibres, on demand": lambda: cracks("triangle", 0.4, 0.2, 1e-3, count=4, fraction=0.35),
    "push-out, section": lambda: push(False, 25, 0.5, 10, 0.174),
    "push-out": lambda: push(True, 5, 0.4, 3, 0.03),
    "inclusions": lambda: inclusions(0.1),
}

#: Bodies that were meshed separately.
APART = {
    "rings": rings,
    "cantilever": cantilever,
    "sliding block": lambda: sliding("triangle"),
    "sliding block in space": lambda: sliding("tetrahedron"),
    "sliding block at small strain": lambda: sliding("triangle", way=0.1, kinematics="small"),
    "sliding block that flows": lambda: sliding("hexahedron", RUBS, FLOWING, volumetric="mean"),
}

#: Bonds between plastic bodies.
FLOWS = {"grains that flow": grains}


def differences(folder: Path) -> list[tuple[str, int, float]]:
    """Scene, ranks, and largest difference of forces and works from those of one rank.

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
    """Largest one of the forces and works of two runs, relative to the largest, or infinite."""
    if run["unknowns"] != other["unknowns"] or len(run["forces"]) != len(other["forces"]):
        return float("inf")
    found = []
    for name in ("forces", "works"):
        values = np.array(run[name])
        found.append(float(np.abs(values - other[name]).max() / np.abs(values).max()))
    return max(found)


def solve(problem: vmdg.Problem, loads: NDArray) -> dict:
    """Unknowns at the end, iterations of all steps, reactions and works at the load factors."""
    forces, works = [], []

    def look(problem: vmdg.Problem) -> None:
        if problem.t not in loads:
            return
        # Facets that open renumber the dofs.
        reactions = problem.discretization.forces.x.array[problem.loading.owned_prescribed]
        forces.append(global_norm(problem.comm, reactions))
        energy = problem.energy()
        works.append([energy.external, energy.bulk + energy.interface, energy.dissipated])

    options = vmdg.SolveOptions(relative_tolerance=1e-11, energy=True)
    iterations = vmdg.solve(problem, loads, options, look).history["iterations"].tolist()
    size = problem.space.dofmap.index_map.size_global
    return {"unknowns": size, "iterations": iterations, "forces": forces, "works": works}


def main(names: list[str], folder: Path) -> None:
    """Run these scenes; writes ``folder``/ranks_N.json."""
    scenes = SCENES | APART | FLOWS
    found = {name: [solve(*run) for run in scenes[name]()] for name in names}
    ranks = MPI.COMM_WORLD.size
    if MPI.COMM_WORLD.rank == 0:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"ranks_{ranks}.json").write_text(json.dumps(found))
        if (folder / "ranks_1.json").is_file():
            for name, ranks, largest in differences(folder):
                print(f"{name:22} {ranks:3} ranks, forces and works differ by {largest:.1e}")


if __name__ == "__main__":
    main(sys.argv[2:] or list(SCENES), Path(sys.argv[1]))
