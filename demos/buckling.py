"""Delamination buckling: a debonded layer under compression buckles, then peels itself off.

Plane strain, right half. A layer h = 0.5 mm thick on a body of H = 4 mm is debonded over L = 20 mm;
the body lies on a smooth table, its ends are pushed together by a strain e. The layer is not quite
plane: this imperfection of 1/500 of its thickness makes it rise. The body is a softer clamp than
that of the closed forms, as if L were longer by less than h at each end: it buckles 7 % earlier.

Clamped at the ends of a crack of length L the layer of thickness h buckles when the strain e' of
the body of height H below it is

    e_c = pi^2/3 (h/L)^2,    and rises by    w = 2 L/pi sqrt(e' - e_c).

The crack grows when (Chai, Babcock and Knauss 1981, for a body that yields as the layer buckles)

    G = E' h/2 (e' - e_c) (k (e' - e_c) + 4 e_c) = G_c,    E' = E/(1 - nu^2),  k = H/(H + h).
"""

from __future__ import annotations

import argparse

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx.mesh import MeshTags

import vmdg
from vmdg.meshes.beams import BOTTOM, LOWER_LEFT, RIGHT, UPPER_LEFT, beams

BODY, LAYER, CRACK, WIDTH = 4.0, 0.5, 10.0, 30.0  # mm; half of the crack, of the width
WAVE = LAYER / 500  # mm
E, NU, STRENGTH, ENERGY = 70e3, 0.3, 100.0, 1.2  # MPa, MPa, N/mm
BOND = vmdg.Debonding(strength=STRENGTH, critical_gap=2 * ENERGY / STRENGTH)


def build(cells: int) -> tuple[vmdg.Problem, MeshTags]:
    """The problem, with the strain of the ends as load factor, and its facets; ``cells`` per mm."""
    stations = 0.0, CRACK, WIDTH
    divisions = int(cells * CRACK), int(cells * WIDTH) - int(cells * CRACK)
    mesh, tags, facets = beams(
        stations=stations, divisions=divisions, height=(BODY, LAYER), rows=(4, 1), precrack=CRACK
    )
    x, y, _ = mesh.geometry.x.T
    y += WAVE * np.cos(np.pi / 2 * x / CRACK) ** 2 * (x < CRACK) * (y > -1e-9)
    bodies = dict.fromkeys((1, 2), vmdg.NeoHookean(E=E, nu=NU))
    problem = vmdg.Problem(mesh, tags, bodies, [vmdg.Interface(between=(1, 2), law=BOND)], degree=2)
    for end in (LOWER_LEFT, UPPER_LEFT):
        problem.dirichlet(facets.find(end), 0.0, "x")
    problem.dirichlet(facets.find(BOTTOM), 0.0, "y")
    problem.dirichlet(facets.find(RIGHT), lambda e: -WIDTH * e, "x")
    return problem, facets


def critical(crack: float) -> float:
    """e_c of a layer that is debonded over 2 ``crack`` [mm]."""
    return np.pi**2 / 12 * (LAYER / crack) ** 2


def at_ends(below: float, crack: float) -> float:
    """e of the ends when the body below the layer has the strain e'; the force is constant in x."""
    bonded = (BODY * below + LAYER * critical(crack)) / (BODY + LAYER)
    return (crack * below + (WIDTH - crack) * bonded) / WIDTH


def growth(crack: float) -> float:
    """e at which G = G_c."""
    e_c, k = critical(crack), BODY / (BODY + LAYER)
    root = np.sqrt(4 * e_c**2 + 2 * k * ENERGY * (1 - NU**2) / (E * LAYER))
    return at_ends(e_c + (root - 2 * e_c) / k, crack)


def draw(problem: vmdg.Problem, history: vmdg.History) -> plt.Figure:
    """Rise and crack length against the closed forms, and the stress along the deformed layer."""
    layout = [["rise", "crack"], ["stress", "stress"]]
    figure, axes = plt.subplot_mosaic(layout, figsize=(10, 6.5), layout="constrained")
    length, below = CRACK + history["crack"], np.linspace(critical(CRACK), 0.0075, 100)
    rise = 4 * CRACK / np.pi * np.sqrt(below - below[0])
    for name, strain, closed in (
        ("rise", at_ends(below, CRACK), rise),
        ("crack", np.array([growth(a) for a in length]), length - CRACK),
    ):
        axes[name].plot(100 * history["load"], history[name], label="computed")
        axes[name].plot(100 * strain, closed, "k--", label="closed form")
        axes[name].set(xlabel="strain of the ends [%]", ylabel=f"{name} [mm]", xlim=(0, None))
    axes["rise"].legend()
    vmdg.plot.stress(problem, "xx", ax=axes["stress"])
    return figure


def main(
    cells: int = 4, end: float = 0.0074, steps: int = 16, out: str = "results/buckling"
) -> vmdg.History:
    """Compress the ends; the history of the run."""
    problem, facets = build(cells)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        rise = problem.u.x.array.reshape(-1, 2)[:, 1].max(initial=0.0)
        return {
            "force [N]": -problem.reaction(facets.find(RIGHT))[0],
            "rise [mm]": problem.comm.allreduce(rise, MPI.MAX),
            "crack [mm]": (WIDTH - CRACK) * problem.debonded(),
        }

    options = vmdg.SolveOptions(energy=True, progress=True, csv=f"{out}/history.csv")
    history = vmdg.solve(problem, np.linspace(0, end, steps + 1)[1:], options, monitor).history
    figure = draw(problem, history)
    if problem.comm.rank == 0:
        figure.savefig(f"{out}/buckling.png")
        strains = 100 * critical(CRACK), 100 * growth(CRACK)
        print("closed forms: buckles at {:.3f} %, grows at {:.3f} %".format(*strains))
        print(f"results are in {out}")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--cells", type=int, default=4, help="cells per mm")
    command.add_argument("--end", type=float, default=0.0074, help="strain of the ends [-]")
    command.add_argument("--steps", type=int, default=16, help="load steps")
    command.add_argument("--out", default="results/buckling", help="folder for the results")
    main(**vars(command.parse_args()))
