"""A striker hits a laminate, which delaminates and stops it.

Two plies of carbon fibre and epoxy, 2 mm together, span 60 mm. A block of steel falls onto their
middle. The bond between the plies is damaged under the striker at once. After 17 us the wave of
bending arrives at the ends, where its shear parts the plies, and cracks run back to the middle. At
the end the bond has taken two thirds of the energy, and the striker stands still.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg.meshes import TaggedMesh, distribute, model

SPAN, PLY, WIDTH, HEIGHT = 60.0, 1.0, 4.0, 6.0  # mm: of the plies, of the striker
CARBON = vmdg.Orthotropic(E=(130e3, 9e3, 9e3), nu=(0.3, 0.3, 0.4), G=(5e3, 5e3, 3e3))  # MPa
STEEL = vmdg.NeoHookean(E=210e3, nu=0.3)
DENSITY = {"lower": 1.6e-9, "upper": 1.6e-9, "striker": 7.85e-9}  # t/mm3


def section(size: float) -> TaggedMesh:
    """Plies from y = 0 and -1 mm to 1 and 0 mm, and a striker on top of them."""
    x = np.array([-SPAN, -WIDTH, WIDTH, SPAN]) / 2
    with model("impact") as gmsh_model:
        if MPI.COMM_WORLD.rank == 0:
            occ = gmsh_model.occ
            add = lambda i, y, h: (2, occ.addRectangle(x[i], y, 0, x[i + 1] - x[i], h))  # noqa: E731
            parts = [add(i, y, PLY) for y in (-PLY, 0.0) for i in range(3)] + [add(1, PLY, HEIGHT)]
            found = [tag for _, tag in occ.fragment(parts, [])[0]]
            occ.synchronize()
            for name, tags in zip(DENSITY, (found[:3], found[3:6], found[6:]), strict=True):
                gmsh_model.addPhysicalGroup(2, tags, name=name)
            for _, curve in gmsh_model.getEntities(1):
                count = round(occ.getMass(1, curve) / size)
                gmsh_model.mesh.setTransfiniteCurve(curve, max(count, 1) + 1)
            for tag in found:
                gmsh_model.mesh.setTransfiniteSurface(tag)
                gmsh_model.mesh.setRecombine(2, tag)
            gmsh_model.mesh.generate(2)
        return distribute(gmsh_model, MPI.COMM_WORLD, gdim=2)


def build(size: float, bond: vmdg.Law) -> tuple[vmdg.Problem, np.ndarray]:
    """The problem, and the nodes of the striker."""
    mesh, cells, _ = section(size)
    plies = vmdg.Interface(between=("lower", "upper"), law=bond, name="plies")
    hit = vmdg.Interface(between=("upper", "striker"), law=vmdg.Contact(0.3), name="hit")
    bodies = {"lower": CARBON, "upper": CARBON, "striker": STEEL}
    problem = vmdg.Problem(mesh, cells, bodies, [plies, hit], kinematics="small", density=DENSITY)
    ends = lambda x: np.isclose(abs(x[0]), SPAN / 2) & np.isclose(x[1], -PLY)  # noqa: E731
    problem.dirichlet_points(ends, 0.0, "y")
    striker = problem.discretization.bodies.cells_of[cells.names["striker"]]
    return problem, np.unique(problem.space.dofmap.list[striker])


def draw(history: vmdg.History, x: np.ndarray, lost: np.ndarray) -> plt.Figure:
    """Share of the bond that is lost by place and time, and the motion of the striker."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    time = 1e6 * history["time"]
    shown = left.pcolormesh(x, time, lost, cmap="Reds", vmin=0, vmax=1)
    figure.colorbar(shown, ax=left, label="share of the bond that is lost")
    left.set(xlabel="x [mm]", ylabel="time [µs]")
    right.plot(time, 1e-3 * history["striker"], "C0", label="speed of the striker")
    right.set(xlabel="time [µs]", ylabel="speed of the striker [m/s]")
    twin = right.twinx()
    twin.plot(time, history["kinetic"], "C1--", label="kinetic energy")
    twin.plot(time, history["damage"], "C2--", label="taken by the bond")
    twin.set(ylabel="energy [N mm per mm]", ylim=(0, None))
    twin.spines["right"].set_visible(True)
    figure.legend(loc="outside upper right", ncols=3)
    return figure


def main(
    size: float = 0.5,
    speed: float = 2e4,
    strength: float = 40.0,
    energy: float = 0.5,
    end: float = 2.5e-4,
    out: str = "results/impact",
) -> vmdg.History:
    """Let the striker fall; the history."""
    bond = vmdg.Debonding(strength=strength, critical_gap=2 * energy / strength, friction=0.3)
    (problem, striker), lost, states = build(size, bond), [], []
    velocity, comm = problem.velocity.copy(), problem.comm
    velocity.x.array.reshape(-1, 2)[striker, 1] = -speed
    mine = striker[striker < problem.space.dofmap.index_map.size_local]

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        states.append(problem.snapshot())
        share = lambda state: state.softening / strength  # noqa: E731
        lost.append(vmdg.profile(problem, "plies", share, along="x")[0].T)
        v = problem.velocity.x.array.reshape(-1, 2)[mine, 1]
        mean = comm.allreduce(v.sum()) / comm.allreduce(len(v))
        return {"striker [mm/s]": mean, "debonded [-]": problem.debonded("plies")}

    options, scheme = vmdg.SolveOptions(energy=True, progress=True), vmdg.CentralDifferences()
    times = np.linspace(0.0, end, round(5e5 * end) + 1)[1:]
    history = vmdg.solve_dynamics(problem, times, scheme, velocity, monitor, options).history
    figure = draw(history, lost[0][0], np.array([share for _, share in lost]))
    shown = "time", "damage", "mises"
    vmdg.plot.animate(f"{out}/impact.gif", problem, states, history, *shown, magnify=3.0)
    if comm.rank == 0:
        Path(out).mkdir(parents=True, exist_ok=True)
        figure.savefig(f"{out}/impact.png")
        parted, taken = history["debonded"][-1] * SPAN, history["damage"][-1]
        print(f"{parted:.1f} mm have parted and took {taken:.1f} N mm; results are in {out}")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--size", type=float, default=0.5, help="of the cells [mm]")
    command.add_argument("--speed", type=float, default=2e4, help="of the striker [mm/s]")
    command.add_argument("--strength", type=float, default=40.0, help="of the bond [MPa]")
    command.add_argument("--energy", type=float, default=0.5, help="of the bond [N/mm]")
    command.add_argument("--end", type=float, default=2.5e-4, help="time at the end [s]")
    command.add_argument("--out", default="results/impact", help="folder for the results")
    main(**vars(command.parse_args()))
