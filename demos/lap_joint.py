"""A strap glued to a plate, each with a mesh of its own, is pulled off along the plate.

Half of a double-lap joint in plane strain. The two parts come from two models of gmsh, with
triangles of other sizes, and share no nodes. The glue shears off from the end of the strap at the
force at which its energy release rate reaches the toughness.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import gmsh
import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg.meshes import TaggedMesh, apart, distribute, model

#: Plate [0, 90] x [-2, 0], strap [-20, 70] x [0, 1.5] [mm].
THICKNESS, ENDS = {"plate": 2.0, "strap": 1.5}, {"plate": (0.0, 90.0), "strap": (-20.0, 70.0)}
MATERIALS = {"plate": vmdg.NeoHookean(E=70e3, nu=0.3), "strap": vmdg.NeoHookean(E=200e3, nu=0.3)}
STRENGTH, TOUGHNESS = 30.0, 1.0  # MPa, N/mm


def part(name: str, tag: int, element_size: float) -> TaggedMesh:
    """One of the parts, as if from a file of its own."""
    (left, right), t = ENDS[name], THICKNESS[name]
    with model(name) as gmsh_model:
        occ = gmsh_model.occ
        face = occ.addRectangle(left, -t if name == "plate" else 0, 0, right - left, t)
        occ.synchronize()
        x = {line: occ.getCenterOfMass(1, line)[0] for _, line in gmsh_model.getEntities(1)}
        gmsh_model.addPhysicalGroup(2, [face], tag, name)
        gmsh_model.addPhysicalGroup(1, [min(x, key=x.get)], 10 * tag, f"{name} left")
        gmsh_model.addPhysicalGroup(1, [max(x, key=x.get)], 10 * tag + 1, f"{name} right")
        gmsh.option.setNumber("Mesh.MeshSizeMax", element_size)
        gmsh_model.mesh.generate(2)
        return distribute(gmsh_model, MPI.COMM_WORLD, gdim=2)


def critical_force() -> float:
    """Force per width at which the glue of a long joint shears off [N/mm].

    Behind the crack the plate carries the force F alone, ahead of it both parts: the energy release
    rate is F^2/2 (1/A_1 - 1/(A_1 + A_2)) with the stiffnesses A = E t/(1 - nu^2).
    """
    plate, strap = 70e3 * 2.0 / (1 - 0.3**2), 200e3 * 1.5 / (1 - 0.3**2)
    return np.sqrt(2 * TOUGHNESS / (1 / plate - 1 / (plate + strap)))


def main(element_size: float = 1.0, steps: int = 17, out: str = "results/lap_joint"):
    """Pull the strap until a part of it is off; the history of the run."""
    mesh, cells, sides = apart(
        [part("plate", 1, element_size), part("strap", 2, 0.7 * element_size)]
    )
    glue = vmdg.Debonding(strength=STRENGTH, critical_gap=2 * TOUGHNESS / STRENGTH)
    interface = vmdg.Interface(between=("plate", "strap"), law=glue, name="glue")
    problem = vmdg.Problem(mesh, cells, MATERIALS, [interface], degree=2)
    problem.dirichlet(sides.find("plate right"), 0.0, "x")
    problem.dirichlet(lambda x: np.isclose(x[1], -THICKNESS["plate"]), 0.0, "y")
    problem.dirichlet(sides.find("strap left"), lambda t: (-t, 0.0))

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        force = -problem.reaction(sides.find("strap left"))[0]
        return {
            "displacement [mm]": problem.t,
            "force [N/mm]": force,
            "off [-]": problem.debonded(),
        }

    shown = {"progress": True, "show": ("force", "off"), "csv": Path(out) / "history.csv"}
    loads = np.linspace(0.0, 0.34, steps + 1)[1:]
    history = vmdg.solve(problem, loads, vmdg.SolveOptions(**shown), monitor).history

    figure, (curve, joint) = plt.subplots(1, 2, figsize=(12, 3.6), layout="constrained")
    vmdg.plot.curve(history, "displacement", "force", ax=curve)
    curve.axhline(critical_force(), color="k", linestyle="--", label="energy release rate")
    curve.legend()
    vmdg.plot.stress(problem, "mises", magnify=5, ax=joint)
    joint.set(xlim=(35, 75), ylim=(-5, 5))
    if problem.comm.rank == 0:
        figure.savefig(Path(out) / "lap_joint.png")
        force = history["force"].max()
        print(f"largest force {force:.1f} N/mm, long joint {critical_force():.1f} N/mm")
        print(f"results are in {out}")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--element-size", type=float, default=1.0, help="of the plate [mm]")
    command.add_argument("--steps", type=int, default=17, help="load steps")
    command.add_argument("--out", default="results/lap_joint", help="folder for the results")
    main(**vars(command.parse_args()))
