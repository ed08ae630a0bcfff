"""Tutorial: your own geometry, from gmsh to pictures. Seven glass fibres in epoxy debond.

A piece of a unidirectional ply, seen along its fibres, is pulled across them until the fibres
debond from the matrix, one after the other. Run it with ``demos/run tutorial``, then read it from
top to bottom, copy it and change it. Units are N, mm and MPa; forces are per mm of thickness.
"""

import argparse
from pathlib import Path

from mpi4py import MPI

import gmsh
import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg import plot
from vmdg.meshes import TaggedMesh, distribute, model

# 1. Geometry. Bodies and sides get physical groups, by whose names the rest of the script finds
# them. The fibres are cut out of the matrix with `fragment`, so that both share the nodes between
# them, which vmdg duplicates. gmsh works on one rank; `distribute` shares the mesh among all.

SIZE, RADIUS, SPACING, TURN = 0.064, 0.0068, 0.0185, np.radians(10)  # mm


def ply(element_size: float) -> TaggedMesh:
    """A square of matrix with one fibre in the middle and six around it."""
    around = [SPACING * np.exp(1j * (TURN + k * np.pi / 3)) for k in range(6)]  # x + iy
    with model("ply") as gmsh_model:
        if MPI.COMM_WORLD.rank == 0:
            occ = gmsh_model.occ
            square = occ.addRectangle(-SIZE / 2, -SIZE / 2, 0, SIZE, SIZE)
            discs = [(2, occ.addDisk(z.real, z.imag, 0, RADIUS, RADIUS)) for z in [0, *around]]
            _, (parts, *pieces) = occ.fragment([(2, square)], discs)
            occ.synchronize()
            fibres = [tag for piece in pieces for _, tag in piece]
            matrix = [tag for _, tag in parts if tag not in fibres]
            x = {tag: occ.getCenterOfMass(1, tag)[0] for _, tag in gmsh_model.getEntities(1)}
            gmsh_model.addPhysicalGroup(2, fibres, name="fibres")
            gmsh_model.addPhysicalGroup(2, matrix, name="matrix")
            gmsh_model.addPhysicalGroup(1, [min(x, key=x.get)], name="left")
            gmsh_model.addPhysicalGroup(1, [max(x, key=x.get)], name="right")
            gmsh.option.setNumber("Mesh.MeshSizeMax", element_size)
            gmsh_model.mesh.generate(2)
        return distribute(gmsh_model, MPI.COMM_WORLD, gdim=2)


def main(element_size: float = 1e-3, steps: int = 30, out: str = "results/tutorial"):
    """Pull the ply to a strain of 2.5 %; the history of the run."""
    mesh, cells, sides = ply(element_size)

    # 2. Interface and law. The bond between fibres and matrix carries 50 MPa and is gone after
    # 0.3 µm, which dissipates 50 * 3e-4 / 2 = 0.0075 N/mm (7.5 J/m2). Before 50 MPa it is rigid: no
    # stiffness has to be chosen. Debonded fibres touch the matrix, with friction.
    bond = vmdg.Debonding(strength=50.0, critical_gap=3e-4, friction=0.3)
    interface = vmdg.Interface(between=("fibres", "matrix"), law=bond)

    # 3. The problem: a material for every group of cells, and loads. Values that depend on the
    # load factor t are functions of it; here t is the mean strain.
    glass, epoxy = vmdg.NeoHookean(E=74e3, nu=0.2), vmdg.NeoHookean(E=3.5e3, nu=0.35)
    problem = vmdg.Problem(mesh, cells, {"fibres": glass, "matrix": epoxy}, [interface])
    problem.dirichlet(sides.find("left"), 0.0, "x")
    problem.dirichlet(sides.find("right"), lambda t: t * SIZE, "x")
    problem.dirichlet_points(lambda x: np.isclose(x[:2], -SIZE / 2).all(axis=0), 0.0, "y")

    # 4. Solve. The monitor is called after every converged step: what it returns becomes columns of
    # the history, with their units in brackets, and it is the place to write fields. Open bodies.bp
    # and interface_0.bp in ParaView and warp both by "displacement".
    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        fields.write(problem.t)
        return {
            "strain [%]": 100 * problem.t,
            "stress [MPa]": problem.reaction(sides.find("right"))[0] / SIZE,
            "debonded [-]": problem.debonded(),
            "fine_scales [mm]": vmdg.average(problem, 0, "fine_scale"),
        }

    loads = np.linspace(0, 0.025, steps + 1)[1:]
    options = vmdg.SolveOptions(progress=True, csv=Path(out) / "history.csv")
    with vmdg.FieldWriter(problem, Path(out) / "fields") as fields:
        history = vmdg.solve(problem, loads, options, monitor).history

    # 5. Pictures. The functions of `vmdg.plot` take and return matplotlib axes; on several ranks
    # all of them call these functions, and the first one draws.
    figure = plt.figure(figsize=(11, 5.6), layout="constrained")
    axes = figure.subplot_mosaic([["stress", "curve"], ["stress", "profile"]], width_ratios=(5, 4))
    plot.stress(problem, "xx", magnify=3, ax=axes["stress"], limits=(0, 110))
    plot.curve(history, "strain", "stress", axes["curve"], origin=True)
    plot.interface_profile(problem, 0, "opening", along="angle", ax=axes["profile"], lw=1)
    axes["profile"].set_title("each fibre at the end")
    if problem.comm.rank == 0:
        figure.savefig(Path(out) / "tutorial.png")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument(
        "--element-size", type=float, default=1e-3, help="size of the elements [mm]"
    )
    command.add_argument("--steps", type=int, default=30, help="load steps")
    command.add_argument("--out", default="results/tutorial", help="folder for the results")
    main(**vars(command.parse_args()))
