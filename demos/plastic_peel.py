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

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx.mesh import CellType, GhostMode, create_rectangle

import vmdg

E, NU = 110e3, 0.34  # MPa, -
COPPER = vmdg.J2(E, NU, yield_stress=150.0, hardening=1000.0)
G_C, STRENGTH, GROWTH = 0.02, 15.0, 1.5  # N/mm; MPa; of the crack, in lengths of its process zone
SHARES = {"damage": "bond", "bulk": "elastic energy", "plastic": "plastic flow"}


def build(thickness: float, facet: float) -> tuple[vmdg.Problem, float]:
    """A strip, bent by the load factor [N], and the length of its process zone [mm].

    Args:
        thickness: Of the strip [mm].
        facet: Length of facets, relative to the process zone [-].
    """
    zone = (E / (1 - NU**2) * thickness**3 * G_C / STRENGTH**2) ** 0.25
    count = round((GROWTH + 6) / facet)
    length = count * facet * zone
    box, ghosts = ((0.0, -thickness / 2), (length, thickness)), GhostMode.shared_facet
    kind = CellType.quadrilateral
    mesh = create_rectangle(MPI.COMM_WORLD, box, (count, 3), kind, ghost_mode=ghosts)
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
    problem.dirichlet(lambda x: np.isclose(x[0], length) & (x[1] > -1e-9), 0.0)
    return problem, zone


def peel(problem: vmdg.Problem, zone: float, thickness: float, out: str) -> dict[str, float]:
    """Work per area of the crack, in the second half of its growth, relative to the toughness."""
    crack = vmdg.CrackGrowth(problem, 0)
    elastic = np.sqrt(E / (1 - NU**2) * thickness**3 * G_C / 6)  # moment [N]
    shown = {"progress": True, "show": ("crack",), "csv": f"{out}/{thickness:.3f}.csv"}
    history = vmdg.solve(
        problem,
        elastic * np.array([0.3, 0.6, 2.0]),
        vmdg.SolveOptions(unstable="trace", energy=True, **shown),
        lambda problem: {"moment [N]": problem.t} | crack(),
        until=lambda problem: crack.length > (GROWTH + 1) * zone,
    ).history
    grown = history["crack"]
    half = int(np.searchsorted(grown, (grown[0] + grown[-1]) / 2))
    works = {name: history[name][-1] - history[name][half] for name in ("external", *SHARES)}
    return {name: work / (grown[-1] - grown[half]) / G_C for name, work in works.items()}


def main(
    thinnest: float = 0.15,
    thickest: float = 0.5,
    count: int = 6,
    facet: float = 0.34,
    out: str = "results/plastic_peel",
) -> dict[float, dict[str, float]]:
    """Peel strips of several thicknesses; the shares of the work of each."""
    figure, (strip, bars) = plt.subplots(2, 1, figsize=(7, 6), layout="constrained")
    found, below = {}, np.zeros(count)
    for thickness in np.geomspace(thinnest, thickest, count):
        problem, zone = build(thickness, facet)
        found[thickness] = peel(problem, zone, thickness, out)
        if thickness == thinnest:
            vmdg.plot.stress(problem, "xx", 3.0, strip)
            strip.set_title(f"{1000 * thickness:g} µm thick")
    for name, label in SHARES.items():
        height = np.array([shares[name] for shares in found.values()])
        bars.bar([f"{1000 * t:.0f}" for t in found], height, 0.6, below, label=label)
        below += height
    bars.axhline(2.0, color="k", ls="--", lw=1, label="elastic strip")
    bars.set(xlabel="thickness [µm]", ylabel="work per area / toughness")
    bars.legend()
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(f"{out}/plastic_peel.png")
        print(f"the picture and the tables are in {out}")
    return found


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--thinnest", type=float, default=0.15, help="thickness [mm]")
    command.add_argument("--thickest", type=float, default=0.5, help="thickness [mm]")
    command.add_argument("--count", type=int, default=6, help="strips")
    command.add_argument(
        "--facet", type=float, default=0.34, help="facets, relative to the process zone [-]"
    )
    command.add_argument("--out", default="results/plastic_peel", help="folder for the results")
    main(**vars(command.parse_args()))
