"""Fibres debond from their matrix on a mesh that is fine around the fronts of their cracks.

Glass fibres in epoxy, pulled across. Every crack along a fibre has two fronts, and each of them a
window of small cells; the mesh is made again by gmsh, with the size of cells as a function of
position, when one of them comes near the end of its window.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from mpi4py import MPI

import gmsh
import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg.meshes import TaggedMesh, distribute, model

SIZE, RADIUS, COARSE = 0.1, 0.013, 4e-3  # mm
CENTRES = 0.025 + 0.05j, 0.06 + 0.028j, 0.067 + 0.075j  # x + iy
STRAIN = 0.02


def fibres(size: Callable[[np.ndarray], np.ndarray]) -> TaggedMesh:
    """Fibres in a square of matrix, with curved triangles of a given size."""
    with model("fibres") as gmsh_model:
        if MPI.COMM_WORLD.rank == 0:
            occ = gmsh_model.occ
            square = occ.addRectangle(0, 0, 0, SIZE, SIZE)
            discs = [(2, occ.addDisk(z.real, z.imag, 0, RADIUS, RADIUS)) for z in CENTRES]
            _, (parts, *pieces) = occ.fragment([(2, square)], discs)
            occ.synchronize()
            inside = [tag for piece in pieces for _, tag in piece]
            outside = [tag for _, tag in parts if tag not in inside]
            x = {tag: occ.getCenterOfMass(1, tag)[0] for _, tag in gmsh_model.getEntities(1)}
            gmsh_model.addPhysicalGroup(2, inside, name="fibres")
            gmsh_model.addPhysicalGroup(2, outside, name="matrix")
            gmsh_model.addPhysicalGroup(1, [min(x, key=x.get)], name="left")
            gmsh_model.addPhysicalGroup(1, [max(x, key=x.get)], name="right")
            gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
            gmsh_model.mesh.setSizeCallback(
                lambda dim, tag, *x: min(COARSE, size(np.reshape(x[:3], (3, 1)))[0])
            )
            gmsh_model.mesh.generate(2)
            gmsh_model.mesh.setOrder(2)
        return distribute(gmsh_model, MPI.COMM_WORLD, gdim=2)


def make_problem(size: Callable[[np.ndarray], np.ndarray]) -> vmdg.Problem:
    mesh, cells, sides = fibres(size)
    bond = vmdg.Debonding(strength=50.0, critical_gap=6e-4, friction=0.3)
    interface = vmdg.Interface(between=("fibres", "matrix"), law=bond)
    glass, epoxy = vmdg.NeoHookean(E=74e3, nu=0.2), vmdg.NeoHookean(E=3.5e3, nu=0.35)
    problem = vmdg.Problem(mesh, cells, {"fibres": glass, "matrix": epoxy}, [interface], degree=2)
    problem.dirichlet(sides.find("left"), 0.0, "x")
    problem.dirichlet(sides.find("right"), lambda t: t * SIZE, "x")
    problem.dirichlet_points(lambda x: np.isclose(x[:2], 0.0).all(axis=0), 0.0, "y")
    return problem


def main(fine: float = 8e-4, out: str = "results/fibre_windows") -> vmdg.History:
    """Pull the square; the history of all meshes."""

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        stress = problem.reaction(lambda x: np.isclose(x[0], SIZE))[0] / SIZE
        return {
            "strain [%]": 100 * problem.t,
            "stress [MPa]": stress,
            "debonded [-]": problem.debonded(),
        }

    loads = np.linspace(0, STRAIN, 17)[1:]
    path = vmdg.PathOptions(aim=12)
    options = vmdg.SolveOptions(energy=True, progress=True, path=path)
    run = vmdg.solve_adaptively(make_problem, loads, fine, 5 * fine, options, monitor)
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
    vmdg.plot.stress(run.problem, "xx", 3.0, axes[0], edges=0.3)
    vmdg.plot.curve(run.history, "strain", "stress", axes[1], origin=True)
    if MPI.COMM_WORLD.rank == 0:
        Path(out).mkdir(parents=True, exist_ok=True)
        figure.savefig(Path(out) / "fibre_windows.png")
        print(f"{len(run.results)} meshes, largest {run.history['unknowns'].max()} unknowns")
    return run.history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--fine", type=float, default=8e-4, help="cells at the fronts [mm]")
    command.add_argument("--out", default="results/fibre_windows", help="folder for the picture")
    main(**vars(command.parse_args()))
