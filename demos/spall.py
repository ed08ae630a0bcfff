"""Spall: a flyer hits a bonded plate, and the reflected wave tears off its rear layer.

A flyer of thickness 2 mm hits a plate of 6 mm at a speed V. The impact sends a pressure
rho c V/2 through both; it ends when the wave returns from the rear of the flyer. Reflected at the
free face of the plate it becomes tension, which is complete for the first time 2 mm below that
face, where a layer is bonded. The bond holds if it is stronger than rho c V/2. Otherwise the free
face shows it: its speed falls from V until the bond begins to fail, by

    dV = 2 P_c/(rho c),

the pull-back from which spall strengths are measured, and rises again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import mesh as meshes

import vmdg

FLYER, PLATE, LAYER = 2.0, 6.0, 2.0  # mm
E, RHO = 70e3, 2.7e-9  # MPa, t/mm3: aluminium
C = np.sqrt(E / RHO)  # mm/s


def build(cells: int, law: vmdg.Law) -> vmdg.Problem:
    """A row of cells, ``cells`` per mm: flyer 1, plate 2, its rear layer 3 bonded by a law."""
    length, count = FLYER + PLATE, int(cells * (FLYER + PLATE))
    mesh = meshes.create_rectangle(
        MPI.COMM_WORLD,
        [[0.0, 0.0], [length, 1 / cells]],
        [count, 1],
        meshes.CellType.quadrilateral,
        ghost_mode=meshes.GhostMode.shared_facet,
    )
    local = mesh.topology.index_map(2).size_local + mesh.topology.index_map(2).num_ghosts
    x = meshes.compute_midpoints(mesh, 2, np.arange(local, dtype=np.int32))[:, 0]
    tags = 1 + (x > FLYER) + (x > length - LAYER)
    tags = meshes.meshtags(mesh, 2, np.arange(local, dtype=np.int32), tags.astype(np.int32))
    aluminium = vmdg.NeoHookean(E=E, nu=0.0)
    bodies, density = dict.fromkeys((1, 2, 3), aluminium), dict.fromkeys((1, 2, 3), RHO)
    impact = vmdg.Interface(between=(1, 2), law=vmdg.Contact())
    bond = vmdg.Interface(between=(2, 3), law=law, name="bond")
    return vmdg.Problem(mesh, tags, bodies, [impact, bond], kinematics="small", density=density)


def run(
    cells: int, law: vmdg.Law, speed: float, times: np.ndarray
) -> tuple[vmdg.History, np.ndarray, np.ndarray]:
    """The history, positions of the cells [mm], and their stress at all times [MPa]."""
    problem = build(cells, law)
    cells_here, X = problem.space.dofmap.list, problem.space.tabulate_dof_coordinates()[:, 0]
    velocity = problem.velocity.copy()
    flyer = cells_here[X[cells_here].mean(axis=1) < FLYER]
    velocity.x.array.reshape(-1, 2)[flyer, 0] = speed
    owned = cells_here[: problem.mesh.topology.index_map(2).size_local]
    order = np.argsort(X[owned], axis=1)[:, [0, -1]]
    left, right = np.take_along_axis(owned, order, axis=1).T
    stresses = []

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        u = problem.u.x.array.reshape(-1, 2)[:, 0]
        stresses.append(E * (u[right] - u[left]) / (X[right] - X[left]))
        moved = problem.velocity.x.array.reshape(-1, 2)[X > FLYER + PLATE - 1e-9, 0]
        return {
            "face [mm/s]": problem.comm.allreduce(moved.max(initial=-np.inf), MPI.MAX),
            "opening [mm]": problem.mean("bond").gap[0],
        }

    options = vmdg.SolveOptions(energy=True, progress=True)
    scheme = vmdg.CentralDifferences()
    history = vmdg.solve_dynamics(problem, times, scheme, velocity, monitor, options).history
    parts = problem.comm.allgather(((X[left] + X[right]) / 2, np.array(stresses)))
    x, sigma = np.concatenate([p[0] for p in parts]), np.hstack([p[1] for p in parts])
    return history, np.sort(x), sigma[:, np.argsort(x)]


def draw(times: np.ndarray, found: dict) -> plt.Figure:
    """Stress over place and time without and with failure, and the speed of the free face."""
    figure, axes = plt.subplots(1, 3, figsize=(11, 4.4), layout="constrained")
    for ax, (name, (history, x, sigma)) in zip(axes, found.items(), strict=False):
        most = 0.6 * RHO * C * history["face"].max()
        shown = ax.pcolormesh(x, 1e6 * times, sigma, cmap="RdBu_r", vmin=-most, vmax=most)
        ax.axvline(FLYER + PLATE - LAYER, color="k", lw=0.8, ls=":", label="bond")
        ax.set(title=name, xlabel="x [mm]", ylabel="time [µs]")
        axes[2].plot(1e6 * times, 1e-3 * history["face"], label=name)
    figure.colorbar(shown, ax=axes[:2], label="stress [MPa]", location="bottom", shrink=0.6)
    axes[2].set(title="free face", xlabel="time [µs]", ylabel="speed [m/s]", ylim=(-25, 175))
    axes[0].legend(loc="lower right")
    axes[2].legend(loc="upper left")
    return figure


def main(
    cells: int = 30,
    speed: float = 1e5,
    strength: float = 300.0,
    energy: float = 0.5,
    out: str = "results/spall",
) -> dict[str, vmdg.History]:
    """Hit the plate with a bond that holds and with one that fails; both histories."""
    times = np.linspace(0.0, 2.2 * (FLYER + PLATE) / C, 161)[1:]
    bond = vmdg.Debonding(strength=strength, critical_gap=2 * energy / strength)
    laws = {"bond that holds": vmdg.Bonded(), "bond that fails": bond}
    found = {name: run(cells, law, speed, times) for name, law in laws.items()}
    figure = draw(times, found)
    if MPI.COMM_WORLD.rank == 0:
        Path(out).mkdir(parents=True, exist_ok=True)
        figure.savefig(f"{out}/spall.png")
        print(f"pull-back of a bond of {strength} MPa: {2e-3 * strength / (RHO * C):.1f} m/s")
        print(f"results are in {out}")
    return {name: history for name, (history, *_) in found.items()}


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--cells", type=int, default=30, help="cells per mm")
    command.add_argument("--speed", type=float, default=1e5, help="of the flyer [mm/s]")
    command.add_argument("--strength", type=float, default=300.0, help="of the bond [MPa]")
    command.add_argument("--energy", type=float, default=0.5, help="of the bond [N/mm]")
    command.add_argument("--out", default="results/spall", help="folder for the results")
    main(**vars(command.parse_args()))
