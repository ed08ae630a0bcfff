"""A crack runs along an interface, ever closer to the speed of Rayleigh waves.

A sheet under a stress sigma is cut along half of a weak interface at t = 0. The stress that the new
faces lose drives the crack: at rest its energy release rate grows with time until the first waves
return from the edges (Freund 1990, Dynamic Fracture Mechanics, sections 2.5 and 7.4),

    G_0 = 4 sigma^2 (1 + nu)(1 - 2 nu)/(pi (1 - nu) E) c_d t,

and it starts at the time tau at which G_0 = G_c. A crack of speed v takes about G_0 (1 - v/c_R), so

    v = c_R (1 - tau/t),   l = c_R (t - tau - tau ln(t/tau)).
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import mesh as meshes

import vmdg

E, NU, RHO = 3240.0, 0.35, 1.19e-9  # MPa, t/mm3: PMMA
C_D = np.sqrt(E * (1 - NU) / ((1 + NU) * (1 - 2 * NU) * RHO))  # mm/s
C_S = np.sqrt(E / (2 * (1 + NU) * RHO))
C_R = C_S * (0.862 + 1.14 * NU) / (1 + NU)  # within 0.2 % (Viktorov 1967)


def build(cells: int, height: float, stress: float, bond: vmdg.Law) -> vmdg.Problem:
    """A sheet of half height ``height`` and twice the length, cut to its middle."""
    mesh = meshes.create_rectangle(
        MPI.COMM_WORLD,
        [[-height, -height], [height, height]],
        [2 * cells, 2 * cells],
        meshes.CellType.quadrilateral,
        ghost_mode=meshes.GhostMode.shared_facet,
    )
    local = mesh.topology.index_map(2).size_local + mesh.topology.index_map(2).num_ghosts
    number = np.arange(local, dtype=np.int32)
    upper = meshes.compute_midpoints(mesh, 2, number)[:, 1] > 0
    tags = meshes.meshtags(mesh, 2, number, (1 + upper).astype(np.int32))
    cut = vmdg.Interface(between=(1, 2), law=bond, initial_damage=lambda x: 1.0 * (x[0] < 0))
    bodies = dict.fromkeys((1, 2), vmdg.NeoHookean(E=E, nu=NU))
    problem = vmdg.Problem(
        mesh, tags, bodies, [cut], kinematics="small", density=dict.fromkeys((1, 2), RHO)
    )
    strain = stress / (RHO * C_D**2)
    for level in (-height, height):
        problem.dirichlet(lambda x, y=level: np.isclose(x[1], y), strain * level, "y")
    problem.dirichlet(lambda x: np.isclose(abs(x[0]), height), 0.0, "x")
    problem.u.interpolate(lambda x: np.array([0 * x[0], strain * x[1]]))
    return problem


def main(
    cells: int = 140,
    height: float = 20.0,
    stress: float = 4.0,
    strength: float = 16.0,
    energy: float = 0.04,
    out: str = "results/crack_speed",
) -> dict[str, np.ndarray]:
    """Run until waves return; times, length and speed of the crack, and Freund's, with tau, c_R."""
    rate = 4 * stress**2 * (1 + NU) * (1 - 2 * NU) / (np.pi * (1 - NU) * E) * C_D
    tau, times = energy / rate, np.linspace(0.0, 2 * height / C_D, 49)[1:]
    bond = vmdg.Debonding(strength=strength, critical_gap=2 * energy / strength)
    problem, fields = build(cells, height, stress, bond), []

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        fields.append(1e-3 * np.linalg.norm(problem.velocity.x.array.reshape(-1, 2), axis=1))
        return {"length [mm]": problem.energy().damage / energy}

    options, scheme = vmdg.SolveOptions(progress=True), vmdg.CentralDifferences()
    history = vmdg.solve_dynamics(problem, times, scheme, None, monitor, options).history
    length, t = history["length"], np.maximum(times, tau)
    freund = C_R * (t - tau - tau * np.log(t / tau))
    Path(out).mkdir(parents=True, exist_ok=True)
    titles = [f"{1e6 * t:.1f} µs" for t in times]
    vmdg.plot.film(f"{out}/crack_speed.gif", problem, fields, titles, "speed [m/s]")
    speed = np.gradient(length, times)
    if problem.comm.rank == 0:
        figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
        for ax, mine, exact in ((axes[0], length, freund), (axes[1], speed / C_R, 1 - tau / t)):
            ax.plot(1e6 * times, mine, label="vmdg")
            ax.plot(1e6 * times, exact, "k--", label="Freund 1990")
            ax.set(xlabel="time [µs]")
        axes[0].set(ylabel="length [mm]")
        axes[1].set(ylabel="speed / Rayleigh speed", ylim=(0, 1))
        axes[0].legend()
        figure.savefig(f"{out}/crack_speed.png")
        print(f"at the end {length[-1]:.2f} mm, Freund {freund[-1]:.2f} mm; results are in {out}")
    return {"times": times, "length": length, "freund": freund, "speed": speed, "tau": tau}


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--cells", type=int, default=140, help="over the half height")
    command.add_argument("--height", type=float, default=20.0, help="half of the sheet's [mm]")
    command.add_argument("--stress", type=float, default=4.0, help="in the sheet [MPa]")
    command.add_argument("--strength", type=float, default=16.0, help="of the bond [MPa]")
    command.add_argument("--energy", type=float, default=0.04, help="of the bond [N/mm]")
    command.add_argument("--out", default="results/crack_speed", help="folder for the results")
    main(**vars(command.parse_args()))
