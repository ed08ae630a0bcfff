"""A ductile strip is peeled off its ground: the plastic share of the work against the thickness.

A moment bends the free end of a copper strip away from a rigid ground, so that a crack runs along
the bond at a constant moment. The work per new area, as the force per width of a peel test at 90
degrees, is the toughness of the bond, the elastic energy of the bent strip and what plastic flow
takes. A thick strip stays elastic and needs twice the toughness; the thinner a strip the more it is
bent, and the less of the work goes into the bond. (A force would get elastic energy back where it
straightens the strip, and make it flow once more.)
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx.mesh import CellType, GhostMode, create_rectangle

import vmdg

E, NU, YIELD, HARDENING = 110e3, 0.34, 150.0, 1000.0  # MPa, -, MPa, MPa
COPPER = vmdg.J2(E, NU, YIELD, hardening=HARDENING)
G_C, STRENGTH = 0.02, 30.0  # N/mm, MPa
SHARES = {"damage": "bond", "bulk": "elastic energy", "plastic": "plastic flow"}


def peel(
    thickness: float, facet: float, growth: float, out: str
) -> tuple[vmdg.Problem, vmdg.History]:
    """Peel a strip by a moment, the load factor [N], over ``growth`` lengths of its process zone.

    Args:
        thickness: Of the strip [mm].
        facet: Relative to the process zone [-].
        growth: Likewise [-].
        out: Folder for the table.
    """
    zone = (E / (1 - NU**2) * thickness**3 * G_C / STRENGTH**2) ** 0.25
    count = round((growth + 6) / facet)
    corners = ((0.0, -thickness / 2), (count * facet * zone, thickness))
    kind, ghosts = CellType.quadrilateral, GhostMode.shared_facet
    mesh = create_rectangle(MPI.COMM_WORLD, corners, (count, 3), kind, ghost_mode=ghosts)
    cells = vmdg.split_cells(mesh, lambda x: -x[1], "strip")
    bond = vmdg.Interface(
        between=("outside", "strip"),
        law=vmdg.Debonding(STRENGTH, 2 * G_C / STRENGTH),
        initial_damage=lambda x: np.where(x[0] < zone, 1.0, 0.0),
    )
    bodies = {"outside": vmdg.Rigid(), "strip": COPPER}
    problem = vmdg.Problem(mesh, cells, bodies, [bond], degree=2, kinematics="small")

    def moment(x: np.ndarray, t: float) -> np.ndarray:
        stress = 12 * t / thickness**3 * (x[1] - thickness / 2)
        return np.stack([stress, 0 * stress])

    problem.traction(lambda x: np.isclose(x[0], 0.0) & (x[1] > -1e-9), moment)
    problem.dirichlet(lambda x: np.isclose(x[0], corners[1][0]) & (x[1] > -1e-9), 0.0)
    crack = vmdg.CrackGrowth(problem, 0)
    end = np.sqrt(E / (1 - NU**2) * thickness**3 * G_C / 6)  # of an elastic strip
    options = vmdg.SolveOptions(
        unstable="trace",
        energy=True,
        progress=True,
        show=("moment", "crack"),
        csv=Path(out) / f"{thickness:g}.csv",
    )
    history = vmdg.solve(
        problem,
        end * np.array([0.3, 0.6, 2.0]),
        options,
        lambda problem: {"moment [N]": problem.t} | crack(),
        until=lambda problem: crack.length > (growth + 1) * zone,
    ).history
    return problem, history


def shares(history: vmdg.History) -> dict[str, float]:
    """Work per area of the crack, in the second half of its growth, relative to the toughness."""
    crack = history["crack"]
    half = int(np.searchsorted(crack, (crack[0] + crack[-1]) / 2))
    area = crack[-1] - crack[half]
    names = ("external", *SHARES)
    return {name: float(np.ptp(history[name][[half, -1]])) / area / G_C for name in names}


def main(
    thicknesses: tuple[float, ...] = (0.15, 0.2, 0.25, 0.3, 0.4, 0.5),
    facet: float = 0.34,
    growth: float = 1.5,
    out: str = "results/plastic_peel",
) -> dict[float, dict[str, float]]:
    """Peel strips of several thicknesses; the shares of the work of each."""
    figure, (strip, bars) = plt.subplots(2, 1, figsize=(7, 6), layout="constrained")
    found = {}
    for thickness in thicknesses:
        problem, history = peel(thickness, facet, growth, out)
        found[thickness] = shares(history)
        if thickness == thicknesses[0]:
            vmdg.plot.stress(problem, "xx", 3.0, strip, edges=0.2)
            strip.set_title(f"{1000 * thickness:g} µm, displacements x 3", size=10)
    below = np.zeros(len(found))
    for name, label in SHARES.items():
        height = np.array([shares[name] for shares in found.values()])
        bars.bar([f"{1000 * t:g}" for t in found], height, 0.6, below, label=label)
        below += height
    bars.axhline(2.0, color="k", ls="--", lw=1, label="elastic strip")
    bars.set(xlabel="thickness [µm]", ylabel="work per area / toughness")
    bars.legend()
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(Path(out) / "plastic_peel.png", dpi=110)
        print(f"the picture and the tables are in {out}")
    return found


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument(
        "--thicknesses",
        type=float,
        nargs="+",
        default=(0.15, 0.2, 0.25, 0.3, 0.4, 0.5),
        help="of the strips [mm]",
    )
    command.add_argument(
        "--facet", type=float, default=0.34, help="facets, relative to the process zone [-]"
    )
    command.add_argument(
        "--growth", type=float, default=1.5, help="of the crack, relative to the process zone [-]"
    )
    command.add_argument("--out", default="results/plastic_peel", help="folder for the results")
    main(**vars(command.parse_args()))
