"""Tutorial: a delamination test past its peak. A double cantilever beam against beam theory.

Two steel arms, glued together ahead of a crack, are pulled apart at their ends. The load rises
until the crack starts and falls while it runs; both branches are known in closed form. The tutorial
shows how to choose the mesh for a process zone, and how to follow the path beyond a peak. Run it
with ``demos/run tutorial_dcb``. Units are N, mm and MPa; forces are per mm of width.
"""

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg import plot
from vmdg.meshes import beams

# 1. Data. The arms are h high, the crack is a_0 long. The bond carries STRENGTH before damage
# starts and dissipates G_C until it is broken.

E, NU, H, A_0 = 210e3, 0.3, 3.0, 30.0  # MPa, -, mm, mm
G_C, STRENGTH = 0.3, 60.0  # N/mm, MPa
E_STAR, SHEAR = E / (1 - NU**2), E / (2 * (1 + NU))  # of a wide beam

# 2. The closed form. Corrected beam theory (Williams 1989) lets each arm deform ahead of the tip as
# if the crack were longer by chi h. While the crack is stationary the opening is 8 P a^3/(E* h^3);
# while it runs 12 P^2 a^2/(E*^2 h^3) = G_c/E*, and a follows from the opening.

GAMMA = 1.18 * E_STAR / SHEAR
CHI = np.sqrt(E_STAR / (11 * SHEAR) * (3 - 2 * (GAMMA / (1 + GAMMA)) ** 2))


def theory(opening: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Load [N/mm] and length of the crack [mm] at an opening [mm]."""
    K = np.sqrt(G_C * E_STAR * H**3 / 12)  # P a while the crack runs [N]
    a = np.maximum(np.sqrt(opening * E_STAR * H**3 / (8 * K)), A_0 + CHI * H)
    return opening * E_STAR * H**3 / (8 * a**3), a - CHI * H


def main(facet: float = 0.25, end: float = 1.5, out: str = "results/tutorial_dcb"):
    """Open the beam; the history of the run."""
    # 3. The mesh. The bond softens over a zone ahead of the tip, at most E* G_c/STRENGTH^2 long in
    # a thick body and (E* h G_c)^(1/2)/STRENGTH next to a thin arm. Elements of degree 2 need about
    # two facets in it; vmdg warns where facets are too long.
    zone = min(E_STAR * G_C / STRENGTH**2, np.sqrt(E_STAR * H * G_C) / STRENGTH)
    print(f"process zone at most {zone:.1f} mm, facets {facet:.2f} mm")
    places = (0.0, A_0 - 2, A_0, 60.0, 100.0)
    counts = np.ceil(np.diff(places) / (facet * np.array([4, 1, 1, 4]))).astype(int).tolist()
    mesh, cells, sides = beams(stations=places, divisions=counts, height=H, rows=3, precrack=A_0)

    # 4. The problem. One law for the facets ahead of the crack. The ends are pulled at corners, so
    # that they can turn. The load factor is the opening: under a prescribed force the test would
    # end at the peak.
    bond = vmdg.Debonding(strength=STRENGTH, critical_gap=2 * G_C / STRENGTH)
    interface = vmdg.Interface(facets=sides.find("interface"), law=bond)
    steel = vmdg.NeoHookean(E=E, nu=NU)
    arms = {"lower arm": steel, "upper arm": steel}
    problem = vmdg.Problem(mesh, cells, arms, [interface], degree=2, kinematics="small")
    for side in (1, -1):
        problem.dirichlet_points(
            lambda x, y=side * H: np.isclose(x[0], 0.0) & np.isclose(x[1], y),
            lambda t, side=side: side * t / 2,
            "y",
        )
    problem.dirichlet(sides.find("right"), 0.0)

    # 5. The run. Past the peak points of the bond break one by one. The load factor may fall a
    # little at each, so vmdg controls steps by damage work and adds rows between the given
    # openings. `CrackGrowth` measures the crack.
    crack = vmdg.CrackGrowth(problem, interface, start=A_0)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        return {"force [N]": problem.reaction(sides.find("upper left"))[1]} | crack()

    options = vmdg.SolveOptions(progress=True, csv=Path(out) / "history.csv")
    history = vmdg.solve(problem, np.linspace(0, end, 31)[1:], options, monitor).history

    # 6. The picture: computed points on the closed form.
    figure, (loads, lengths) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    for axes, column, exact in zip((loads, lengths), ("force", "crack"), (0, 1), strict=True):
        plot.curve(history, "load", column, axes, origin=column == "force")
        opening = np.linspace(1e-3, end, 300)
        axes.plot(opening, theory(opening)[exact], "k--", lw=0.8, label="beam theory")
        axes.set(xlabel="opening [mm]")
        axes.legend()
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(Path(out) / "tutorial_dcb.png")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument(
        "--facet", type=float, default=0.25, help="length of facets where the crack runs [mm]"
    )
    command.add_argument("--end", type=float, default=1.5, help="opening at the end [mm]")
    command.add_argument("--out", default="results/tutorial_dcb", help="folder for the results")
    main(**vars(command.parse_args()))
