"""Tutorial: cycles and friction. A bed joint of masonry under pressure and cyclic shear.

Two bricks with a mortar joint between them carry a constant pressure. Sheared for the first time,
the joint carries its cohesion and then softens; from then on only friction is left, and every cycle
dissipates the same known energy. The tutorial shows loads that reverse, a rigid plate, friction
that grows with the damage, and the energies of a run. Run it with ``demos/run tutorial_friction``.
Units are N, mm and MPa; forces are per mm of width.
"""

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg import plot
from vmdg.meshes import blocks

# 1. Data. The joint is 100 mm long, each brick 50 mm high. It is sheared by WAY to either side.

E, NU, LENGTH, HEIGHT = 12e3, 0.15, 100.0, 50.0  # MPa, -, mm, mm
COHESION, G_C, FRICTION, PRESSURE = 0.6, 0.06, 0.75, 0.5  # MPa, N/mm, -, MPa
WAY, CYCLES = 0.4, 2  # mm, -

# 2. The closed form. A joint without bond slides at mu N, whatever the bricks do. When the load
# reverses, the joint sticks until the bricks have sprung back by 2 mu N/k, k their stiffness. So a
# cycle is a parallelogram between -mu N and mu N, with the area 4 mu N (WAY - mu N/k).

SLIDING = FRICTION * PRESSURE * LENGTH  # N/mm


def work_of_cycle(stiffness: float) -> float:
    """Energy that a cycle dissipates [N], by the stiffness of the bricks [MPa]."""
    return 4 * SLIDING * (WAY - SLIDING / stiffness)


def main(divisions: int = 12, out: str = "results/tutorial_friction"):
    """Press, break and cycle the joint; the history of the run."""
    # 3. Mesh and law. The joint stands upright in the mesh: x is the direction of the pressure.
    # With `gradual_friction` a point in contact carries R + D mu p, R the remaining strength and D
    # the damage. Without it the joint would carry the larger of R and mu p.
    mesh, cells, sides = blocks(
        cell="quadrilateral",
        divisions=(divisions // 2, divisions),
        length=2 * HEIGHT,
        height=LENGTH,
        interface=(HEIGHT, HEIGHT),
    )
    mortar = vmdg.Debonding(COHESION, 2 * G_C / COHESION, FRICTION, gradual_friction=True)
    joint = vmdg.Interface(between=("left", "right"), law=mortar, name="joint")
    brick = vmdg.NeoHookean(E=E, nu=NU)
    problem = vmdg.Problem(
        mesh, cells, {"left": brick, "right": brick}, [joint], degree=2, kinematics="small"
    )

    # 4. The load programme. Until t = 1 a plate that does not tilt presses on the right brick and
    # then keeps its force. From there on t counts quarters of a cycle; the displacement is linear
    # between reversals, and t never decreases.
    turns = np.arange(1, 4 * CYCLES + 3)
    ways = WAY * np.sin(np.pi / 2 * (turns - 1)).round()  # 0, WAY, 0, -WAY, 0, WAY, ...
    far = sides.find("right")
    problem.dirichlet(sides.find("left"), 0.0)
    problem.dirichlet(far, lambda t: np.interp(t, turns, ways), "y")
    plate = problem.rigid_face(far, "x", force=lambda t: -PRESSURE * LENGTH * min(t, 1.0))

    # 5. The run. With `energy=True` every row has the energies: what friction and damage have
    # dissipated, what the bricks store, and the work of the loads.
    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        return {
            "sliding displacement [mm]": float(np.interp(problem.t, turns, ways)),
            "shear force [N]": problem.reaction(far)[1],
            "closing [mm]": -plate.displacement(),
        }

    options = vmdg.SolveOptions(energy=True, progress=True, csv=Path(out) / "history.csv")
    loads = [1.0, 1.02, *np.linspace(1, turns[-1], 20 * (len(turns) - 1) + 1)[1:]]
    history = vmdg.solve(problem, loads, options, monitor).history

    # 6. The picture: the loops, and where the energy has gone.
    figure, (loop, energies) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    plot.curve(history, "sliding displacement", "shear force", loop)
    loop.axhline(SLIDING, color="k", ls="--", lw=0.8, label=r"sliding force $\pm\mu N$")
    loop.axhline(-SLIDING, color="k", ls="--", lw=0.8)
    loop.legend(loc="center")
    for name in ("external", "friction", "damage"):
        energies.plot(history["load"], history[name], label=name)
    energies.set(xlabel="quarters of a cycle", ylabel="energy [N]")
    energies.legend()
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(Path(out) / "tutorial_friction.png")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--divisions", type=int, default=12, help="cells along the joint")
    command.add_argument(
        "--out", default="results/tutorial_friction", help="folder for the results"
    )
    main(**vars(command.parse_args()))
