"""Tutorial: a thermal problem. A polymer film delaminates from its substrate as it cools.

A film that shrinks more than the stiff substrate below it is under tension. The stored energy is
released where the film delaminates, so a crack from its edge runs as soon as the energy per area
reaches the toughness of the bond: at a temperature that is known in closed form. Run it with
``demos/run tutorial_film``. Units are N, mm and MPa; the film is long in the third direction.
"""

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx.mesh import CellType, GhostMode, create_rectangle

import vmdg
from vmdg import plot

# 1. Data: a film of 20 µm on silicon, cracked at its edge over three times its thickness. MISMATCH
# is the difference of the coefficients of thermal expansion.

E, NU, H, CRACK, LENGTH = 3500.0, 0.35, 0.02, 0.06, 0.24  # MPa, -, mm, mm, mm
MISMATCH, G_C, STRENGTH = 50e-6, 0.005, 30.0  # 1/K, N/mm, MPa

# 2. The closed form. The bonded film has the stress E e/(1 - nu) in its plane, e the mismatch
# strain; the detached film has no stress normal to the crack front. The energy released per area is
# G = (1 + nu) E e^2 h/(2 (1 - nu)), independent of the crack length and of the substrate
# (Hutchinson and Suo 1992). G = G_c gives the drop of temperature.

CRITICAL = np.sqrt(2 * (1 - NU) * G_C / ((1 + NU) * E * H)) / MISMATCH  # K


def main(facet: float = 0.004, out: str = "results/tutorial_film"):
    """Cool the film until most of it is detached; the history of the run."""
    # 3. The mesh: film above, substrate below y = 0, made in DOLFINx. `split_cells` marks the film
    # by a function that is negative inside. Meshes on several ranks need facet ghosts.
    counts = (round(LENGTH / facet), 8)
    corners = ((0.0, -H), (LENGTH, H))
    ghosts = GhostMode.shared_facet
    mesh = create_rectangle(
        MPI.COMM_WORLD, corners, counts, CellType.quadrilateral, ghost_mode=ghosts
    )
    cells = vmdg.split_cells(mesh, lambda x: -x[1], "film")

    # 4. The problem. The crack is a part of the interface that is broken from the start. The
    # eigenstrain is the strain that the film would have without substrate; t is the drop of
    # temperature. The right side is a plane of symmetry.
    bond = vmdg.Debonding(strength=STRENGTH, critical_gap=2 * G_C / STRENGTH)
    interface = vmdg.Interface(
        between=("outside", "film"),
        law=bond,
        initial_damage=lambda x: np.where(x[0] < CRACK, 1.0, 0.0),
    )
    silicon, polymer = vmdg.NeoHookean(E=160e3, nu=0.22), vmdg.NeoHookean(E=E, nu=NU)
    problem = vmdg.Problem(
        mesh,
        cells,
        {"outside": silicon, "film": polymer},
        [interface],
        degree=2,
        kinematics="small",
        eigenstrain={"film": lambda t: -MISMATCH * t},
    )
    problem.dirichlet(lambda x: np.isclose(x[1], -H), 0.0)
    problem.dirichlet(lambda x: np.isclose(x[0], LENGTH), 0.0, "x")

    # 5. The run. At the critical temperature nothing stops the crack: a film that is cooled further
    # delaminates at once (`unstable="jump"`, the default). Here the equilibrium path is traced
    # instead: the crack grows at constant temperature until three quarters have debonded.
    crack = vmdg.CrackGrowth(problem, interface)
    options = vmdg.SolveOptions(unstable="trace", progress=True, csv=Path(out) / "history.csv")
    history = vmdg.solve(
        problem,
        np.linspace(0, 1.5 * CRITICAL, 7)[1:],
        options,
        monitor=lambda problem: {"cooling [K]": problem.t} | crack(),
        until=lambda problem: problem.debonded(interface) > 0.75,
    ).history

    # 6. Pictures: stress in the film, and temperature while the crack grows.
    figure, (film, curve) = plt.subplots(
        2, 1, figsize=(7, 5.5), height_ratios=(1, 2), layout="constrained"
    )
    plot.stress(problem, "xx", magnify=3, ax=film)
    plot.curve(history, "crack", "cooling", curve)
    curve.axhline(CRITICAL, color="k", ls="--", lw=0.8, label="Hutchinson and Suo 1992")
    curve.legend()
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(Path(out) / "tutorial_film.png")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument(
        "--facet", type=float, default=0.004, help="length of the facets of the interface [mm]"
    )
    command.add_argument("--out", default="results/tutorial_film", help="folder for the results")
    main(**vars(command.parse_args()))
