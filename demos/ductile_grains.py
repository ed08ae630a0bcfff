"""Grains of a ductile metal part along their boundaries, or flow instead.

A square of metal grains in plane strain is stretched along x. Every grain boundary can fail, and
grains differ in their yield stress, as crystals do that are turned differently. The same grains are
elastic, hard or soft. Elastic grains part along one chain of boundaries. Hard ones flow at its end
where stress concentrates, and the stress falls more slowly. Soft ones flow before any boundary has
reached its strength: none fails before hardening has made up for the difference.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg import meshes

SIZE, E, NU = 0.1, 120e3, 0.34  # mm, MPa, -
HARDENING, SCATTER = 1500.0, 0.15  # MPa; of the yield stress, relative
SHOWN = 0.004  # strain of the pictures
YIELDS = {"elastic": None, "hard": 300.0, "soft": 160.0}  # MPa, means of the grains


def build(
    grains: int, cells: float, seed: int, yield_stress: float | None, strength: float
) -> tuple[vmdg.Problem, np.ndarray]:
    """The grains, stretched by the load factor [-], and the facets of their right side."""
    mesh, tags, sides = meshes.polycrystal(
        grains, seed, periodic=False, size=SIZE, element_size=SIZE / (cells * np.sqrt(grains))
    )
    scatter = np.random.default_rng(seed).uniform(-1, 1, grains)

    def metal(grain: int) -> vmdg.Material:
        if yield_stress is None:
            return vmdg.NeoHookean(E=E, nu=NU)
        return vmdg.J2(E, NU, yield_stress * (1 + SCATTER * scatter[grain]), hardening=HARDENING)

    bodies = {grain + 1: metal(grain) for grain in range(grains)}
    law = vmdg.Debonding(strength=strength, critical_gap=4e-4)
    boundaries = vmdg.Interface(between="all", law=law, name="boundaries")
    problem = vmdg.Problem(mesh, tags, bodies, [boundaries], degree=2, kinematics="small")
    problem.dirichlet(sides.find("left"), 0.0, "x")
    problem.dirichlet(sides.find("right"), lambda strain: strain * SIZE, "x")
    problem.dirichlet(sides.find("bottom"), 0.0, "y")
    return problem, sides.find("right")


def main(
    grains: int = 12,
    cells: float = 6.0,
    seed: int = 1,
    strength: float = 300.0,
    end: float = 0.01,
    steps: int = 10,
    out: str = "results/ductile_grains",
) -> dict[str, vmdg.History]:
    """Stretch the grains of each kind; the histories by kind."""
    figure = plt.figure(figsize=(10, 6.4), layout="constrained")
    axes = figure.subplot_mosaic([[*YIELDS], ["curve"] * 3])
    histories = {}
    for name, yield_stress in YIELDS.items():
        problem, right = build(grains, cells, seed, yield_stress, strength)

        def monitor(
            problem: vmdg.Problem, right: np.ndarray = right, ax: plt.Axes = axes[name]
        ) -> dict[str, float]:
            if np.isclose(problem.t, SHOWN) and not ax.get_xlabel():
                style = {"limits": (0, 1.2 * strength), "colorbar": ax is axes["soft"]}
                vmdg.plot.stress(problem, "xx", 15.0, ax, **style)
            energy = problem.energy()
            return {
                "stress [MPa]": problem.reaction(right)[0] / SIZE,
                "plastic work [N mm]": energy.plastic,
                "damage work [N mm]": energy.damage,
            }

        shown = {"progress": True, "show": ("stress", "plastic work")}
        options = vmdg.SolveOptions(csv=Path(out) / f"{name}.csv", **shown)
        loads = np.linspace(0.0, end, steps + 1)[1:]
        histories[name] = history = vmdg.solve(problem, loads, options, monitor).history
        side = (-0.05 * SIZE, 1.1 * SIZE)
        axes[name].set(title=f"{name} grains at {100 * SHOWN:g} %", xlim=side, ylim=side)
        strain = 100 * np.append(0.0, history["load"])
        axes["curve"].plot(strain, np.append(0.0, history["stress"]), ".-", label=name)
    axes["curve"].axvline(100 * SHOWN, color="0.7", ls="--", lw=1, label="pictures")
    axes["curve"].set(xlabel="strain [%]", ylabel="stress [MPa]")
    axes["curve"].legend()
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(Path(out) / "ductile_grains.png")
        print(f"the picture and the tables are in {out}")
    return histories


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--grains", type=int, default=12, help="number of grains")
    command.add_argument("--cells", type=float, default=6.0, help="elements per grain [-]")
    command.add_argument("--seed", type=int, default=1, help="seed of the grains")
    command.add_argument("--strength", type=float, default=300.0, help="of boundaries [MPa]")
    command.add_argument("--end", type=float, default=0.01, help="strain at the end [-]")
    command.add_argument("--steps", type=int, default=10, help="number of given strains")
    command.add_argument("--out", default="results/ductile_grains", help="folder for the results")
    main(**vars(command.parse_args()))
