"""Open, close, press, shear, reopen: one interface through all branches of its law.

Two bonded squares of 1 mm in plane strain. The far end of the right one follows a path that opens
the bond to half of zeta_c, closes it, presses, slides it under pressure and reopens it. The law
softens, unloads without healing, closes at zero traction, resists by friction and opens again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg.meshes import blocks

LAW = vmdg.Debonding(strength=100.0, critical_gap=0.2, friction=0.3)
LEGS = ("open", "close and press", "shear", "reopen")
PATH = np.array([(0, 0), (0.12, 0), (-0.02, 0), (-0.02, 0.15), (0.15, 0.15)])  # mm


def end_of_path(t: float) -> tuple[float, float]:
    """Displacement of the right end [mm] at t; leg i ends at t = i."""
    return tuple(np.interp(t, np.arange(len(PATH)), column) for column in PATH.T)


def draw(history: vmdg.History) -> plt.Figure:
    """Tractions over openings, and where the energy has gone."""
    figure, (normal, shear, energy) = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
    for i, leg in enumerate(LEGS):
        now = (history["load"] >= i - 1e-9) & (history["load"] <= i + 1 + 1e-9)
        normal.plot(history["opening"][now], history["normal"][now], label=leg)
        shear.plot(history["slide"][now], history["shear"][now], label=leg)
    normal.set(xlabel="opening $g_N$ [mm]", ylabel="normal traction $T_N$ [MPa]")
    shear.set(xlabel="sliding $g_T$ [mm]", ylabel="shear traction $T_T$ [MPa]")
    shear.legend()
    spent = np.zeros(len(history))
    for name in ("damage", "friction", "bulk"):
        energy.fill_between(history["load"], spent, spent + history[name], label=name)
        spent = spent + history[name]
    energy.plot(history["load"], history["external"], "k--", label="external work")
    energy.set(xlabel="load factor, one per leg", ylabel="energy [N mm per mm]")
    energy.legend(loc="lower right")
    return figure


def main(steps: int = 200, out: str = "results/load_cycle") -> vmdg.History:
    """Follow the path; the history of the run."""
    mesh, cells, facets = blocks(MPI.COMM_WORLD, "quadrilateral")
    material = vmdg.NeoHookean(E=5000.0, nu=0.25)
    interface = vmdg.Interface(between=(1, 2), law=LAW)
    problem = vmdg.Problem(mesh, cells, {1: material, 2: material}, [interface])
    problem.dirichlet(facets.find(1), 0.0)
    problem.dirichlet(facets.find(2), end_of_path)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        mean = problem.mean(0)
        return {
            "opening [mm]": mean.opening[0],
            "slide [mm]": mean.opening[1],
            "normal [MPa]": mean.traction[0],
            "shear [MPa]": mean.traction[1],
            "softening [MPa]": mean.softening,
        }

    loads = np.linspace(0, len(LEGS), steps + 1)[1:]
    shown = {"progress": True, "show": ("normal", "shear"), "csv": Path(out) / "history.csv"}
    options = vmdg.SolveOptions(relative_tolerance=1e-11, energy=True, **shown)
    history = vmdg.solve(problem, loads, options, monitor).history

    if problem.comm.rank == 0:
        draw(history).savefig(Path(out) / "load_cycle.png")
        share = np.abs(history["imbalance"]).max() / np.abs(history["external"]).max()
        print(f"{len(history)} steps; the energies balance to {share:.1e} of the external work")
        print(f"results are in {out}")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--steps", type=int, default=200, help="load steps")
    command.add_argument("--out", default="results/load_cycle", help="folder for the results")
    main(**vars(command.parse_args()))
