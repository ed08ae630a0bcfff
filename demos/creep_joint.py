"""A strap glued to a plate, both of a polymer that creeps, carries a force until it is off.

Half of a double-lap joint in plane strain, cracked at the end where the strap is pulled. Under a
force between that at which the glue fails at once and that which it carries indefinitely, the
energy release rate grows with the compliance of the polymer. The crack starts late, and creeps
along the joint: material that it passes is loaded quickly, and answers stiffly at first.
"""

from __future__ import annotations

import argparse

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx.mesh import CellType, GhostMode, create_rectangle

import vmdg

E, NU, HOUR = 3000.0, 0.35, 3600.0  # MPa, -, s
SERIES = [(0.25, 1 * HOUR), (0.25, 20 * HOUR)]
POLYMER = vmdg.Viscoelastic(E, NU, shear=SERIES, bulk=SERIES)
STRENGTH, TOUGHNESS = 10.0, 0.5  # MPa, N/mm
LENGTH, CRACK, PLATE, STRAP, RAMP = 70.0, 15.0, 2.0, 1.0, 0.02  # mm; h


def critical_force() -> float:
    """Force per width at which the glue fails at once [N/mm]: G_c = F^2/2 (1/A_1 - 1/(A_1 + A_2))
    with the stiffness A = E t/(1 - nu^2) of the strap behind the crack and of both ahead of it."""
    modulus = E / (1 - NU**2)
    return np.sqrt(2 * TOUGHNESS * modulus / (1 / STRAP - 1 / (STRAP + PLATE)))


def joint(force: float, facet: float) -> vmdg.Problem:
    """The joint under a force per width [N/mm], put on in RAMP; the load factor is the time [h]."""
    box, ghosts = [(0.0, -PLATE), (LENGTH, STRAP)], GhostMode.shared_facet
    cells = round(LENGTH / facet), 3
    mesh = create_rectangle(MPI.COMM_WORLD, box, cells, CellType.quadrilateral, ghost_mode=ghosts)
    parts = vmdg.split_cells(mesh, lambda x: -x[1], "strap")
    glue = vmdg.Interface(
        between=("strap", "outside"),
        law=vmdg.Debonding(STRENGTH, 2 * TOUGHNESS / STRENGTH),
        initial_damage=lambda x: np.where(x[0] < CRACK, 1.0, 0.0),
    )
    bodies = {"strap": POLYMER, "outside": POLYMER}
    problem = vmdg.Problem(mesh, parts, bodies, [glue], degree=2, kinematics="small")
    problem.dirichlet(lambda x: np.isclose(x[1], -PLATE), 0.0, "y")
    problem.dirichlet(lambda x: np.isclose(x[0], LENGTH) & (x[1] < 1e-9), 0.0, "x")
    end = lambda x: np.isclose(x[0], 0.0) & (x[1] > -1e-9)  # noqa: E731
    problem.spring(end, 1e-4)  # keeps the strap in place once it is off
    problem.traction(end, lambda t: (-force / STRAP * min(t / RAMP, 1.0), 0.0))
    return problem


def main(
    largest: float = 0.95,
    runs: int = 3,
    facet: float = 1.25,
    steps: int = 40,
    out: str = "results/creep_joint",
) -> dict[float, vmdg.History]:
    """Hang shares of the critical force on the joint; the history of each."""
    figure, (curve, strap) = plt.subplots(
        2, 1, figsize=(7, 5), height_ratios=(3, 1), layout="constrained"
    )
    times, found = np.geomspace(RAMP, 300.0, steps), {}
    shown = {"energy": True, "progress": True, "show": ("crack",)}
    for share in (round(largest - 0.05 * n, 4) for n in range(runs)):
        problem = joint(share * critical_force(), facet)
        crack = vmdg.CrackGrowth(problem, 0)
        found[share] = history = vmdg.solve(
            problem,
            times,
            vmdg.SolveOptions(duration=HOUR, csv=f"{out}/{share}.csv", **shown),
            lambda problem, crack=crack: {"time [h]": problem.t} | crack(),
            until=lambda problem, crack=crack: crack.length > LENGTH - 2 * CRACK,
        ).history
        curve.semilogx(history["time"], history["crack"], label=f"{share:.0%}")
    curve.set(xlabel="time [h]", ylabel="crack [mm]")
    curve.legend(title="of the force at once")
    vmdg.plot.stress(problem, "xx", 5.0, strap)
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(f"{out}/creep_joint.png")
        print(f"the picture is in {out}")
    return found


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    share = "largest force over that at which the glue fails at once [-]"
    command.add_argument("--largest", type=float, default=0.95, help=share)
    command.add_argument("--runs", type=int, default=3, help="forces, each smaller by 0.05")
    command.add_argument("--facet", type=float, default=1.25, help="length of facets [mm]")
    command.add_argument("--steps", type=int, default=40, help="steps of time")
    command.add_argument("--out", default="results/creep_joint", help="folder for the results")
    main(**vars(command.parse_args()))
