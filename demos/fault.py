"""An earthquake: a fault ruptures, whose friction weakens with slip.

TPV205-2D of the SCEC/USGS code verification (Harris et al. 2009, Seismol. Res. Lett. 80): 30 km of
a fault under 120 MPa of pressure and 70 MPa of shear. Friction falls from 0.677 to 0.525 over 0.4 m
of slip. A patch of 3 km in the middle has 81.6 MPa, more than it can carry, and two others, 7.5 km
from it, 78 and 62 MPa. Where the shear is higher by d, friction that is lower by d/120 MPa gives
the same motion, so that all of the fault begins under one stress. Units are m, s and MPa.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import mesh as meshes

import vmdg

LENGTH, WIDTH, HEIGHT = 15.0, 18.0, 10.0  # km: half of the fault, of the sheet
PRESSURE, SHEAR = 120.0, 70.0  # MPa
RHO, C_D, C_S = 2670e-6, 6000.0, 3464.0  # MPa s2/m2, m/s
STATIONS = (-12.0, -7.5, -4.5, 4.5, 7.5, 12.0)  # km
#: By PyLith, from its time series for the benchmark: when the slip is D_c/2 [s], slip at 5 s [m].
PYLITH = (2.853, 1.981, 1.593, 1.593, 2.774, 4.463), (3.67, 5.81, 5.69, 3.96, 2.57, 1.56)


def more(x: np.ndarray) -> np.ndarray:
    """The shear stress of a place above that of the others [MPa]."""
    patches = ((0.0, 11.6), (-7.5e3, 8.0), (7.5e3, -8.0))
    return sum(d * (abs(x[0] - centre) < 1.5e3) for centre, d in patches)


def build(size: float) -> vmdg.Problem:
    """A sheet of rock of cells of ``size`` m: below the fault 1, above it 2, at its ends 3."""
    corner, count = 1e3 * np.array([WIDTH, HEIGHT]), np.array([WIDTH, HEIGHT]) * 2e3 / size
    mesh = meshes.create_rectangle(
        MPI.COMM_WORLD,
        [-corner, corner],
        np.rint(count).astype(int).tolist(),
        meshes.CellType.quadrilateral,
        ghost_mode=meshes.GhostMode.shared_facet,
    )
    local = mesh.topology.index_map(2).size_local + mesh.topology.index_map(2).num_ghosts
    number = np.arange(local, dtype=np.int32)
    x, y, _ = meshes.compute_midpoints(mesh, 2, number).T
    tags = np.where(abs(x) > 1e3 * LENGTH, 3, 1 + (y > 0)).astype(np.int32)
    mu, lmbda = RHO * C_S**2, RHO * (C_D**2 - 2 * C_S**2)
    nu = lmbda / (2 * (lmbda + mu))
    rock, every = vmdg.NeoHookean(E=2 * mu * (1 + nu), nu=nu), (1, 2, 3)
    law = vmdg.Contact(
        friction=lambda x: 0.677 - more(x) / PRESSURE,
        dynamic_friction=lambda x: 0.525 - more(x) / PRESSURE,
        slip_distance=0.4,
    )
    fault = vmdg.Interface(between=(1, 2), law=law, name="fault")
    problem = vmdg.Problem(
        mesh,
        meshes.meshtags(mesh, 2, number, tags),
        dict.fromkeys(every, rock),
        [fault],
        kinematics="small",
        density=dict.fromkeys(every, RHO),
    )
    stress = np.array([[-PRESSURE * lmbda / (lmbda + 2 * mu), SHEAR], [SHEAR, -PRESSURE]])
    for axis, side in ((0, -1), (0, 1), (1, -1), (1, 1)):
        edge = lambda x, i=axis, c=side * corner[axis]: np.isclose(x[i], c)  # noqa: E731
        problem.traction(edge, side * stress[axis])
        problem.spring(edge, viscosity="absorbing")
    strain = -PRESSURE / (lmbda + 2 * mu)
    problem.u.interpolate(lambda x: np.array([SHEAR / mu * x[1], strain * x[1]]))
    return problem


def draw(x: np.ndarray, times: np.ndarray, slip: np.ndarray) -> plt.Figure:
    """Rate of the slip over place and time, and the slip every half second."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    rate = np.diff(slip, axis=0, prepend=0.0) / times[0]
    shown = left.pcolormesh(1e-3 * x, times, rate, cmap="magma_r", vmin=0, vmax=6)
    figure.colorbar(shown, label="rate of the slip [m/s]")
    for speed, style, name in ((C_S, "C0--", "shear wave"), (C_D, "C0:", "pressure wave")):
        left.plot([-7.5, -7.5 - 3e-3 * speed], [1.98, 4.98], style, label=name)
    left.set(ylim=(0, times[-1]), ylabel="time [s]")
    right.plot(1e-3 * x, slip[24::25].T, "C0", lw=0.8)
    right.set(ylim=(0, None), ylabel="slip every 0.5 s, up to 5 s [m]")
    for ax, published in zip((left, right), PYLITH, strict=True):
        ax.plot(STATIONS, published, "ko", mfc="none", label="PyLith")
        ax.set(xlim=(-LENGTH, LENGTH), xlabel="x [km]")
        ax.legend(loc="upper right")
    return figure


def main(size: float = 75.0, end: float = 5.0, out: str = "results/fault") -> dict[str, np.ndarray]:
    """Run; history, and the slip of all times at the stations [m] with the arrivals there [s]."""
    times, problem, slips = np.linspace(0.0, end, round(50 * end) + 1)[1:], build(size), []
    fields: list[np.ndarray] = []

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        if len(slips) % 4 == 3:
            fields.append(np.linalg.norm(problem.velocity.x.array.reshape(-1, 2), axis=1))
        slips.append(vmdg.profile(problem, "fault", lambda state: state.gap[:, 0], along="x")[0].T)
        return {"slip [m]": slips[-1][1].max()}

    options, scheme = vmdg.SolveOptions(energy=True, progress=True), vmdg.CentralDifferences()
    history = vmdg.solve_dynamics(problem, times, scheme, None, monitor, options).history
    x, slip = slips[0][0], np.array([values for _, values in slips])
    stations = np.array([[np.interp(1e3 * s, x, row) for s in STATIONS] for row in slip])
    arrivals = np.array([np.interp(0.2, one, times, right=np.nan) for one in stations.T])
    titles = [f"{t:.2f} s" for t in times[3::4]]
    vmdg.plot.film(f"{out}/fault.gif", problem, fields, titles, "speed [m/s]", 2.0, "m")
    if problem.comm.rank == 0:
        Path(out).mkdir(parents=True, exist_ok=True)
        draw(x, times, slip).savefig(f"{out}/fault.png")
        for station, mine, other in zip(STATIONS, arrivals, PYLITH[0], strict=True):
            print(f"arrival at {station:5.1f} km: {mine:.3f} s, PyLith {other:.3f} s")
        print(f"results are in {out}")
    return {"history": history, "slip": stations, "arrivals": arrivals}


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--size", type=float, default=75.0, help="of the cells [m]")
    command.add_argument("--end", type=float, default=5.0, help="time at the end [s]")
    command.add_argument("--out", default="results/fault", help="folder for the results")
    main(**vars(command.parse_args()))
