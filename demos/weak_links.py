"""Weak links: the equilibrium path of bars that break one after the other, jumped and traced.

Bars between rigid grips, each bonded in its middle by a bond of another strength, so brittle that
it cannot unload its bar in equilibrium while the grips move on: at its strength a bar snaps. A
machine jumps; the path turns back instead, until the bond is gone, and rises again along a softer
line.
"""

from __future__ import annotations

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from helpers.options import run
from helpers.weak_links import bundle, order_statistics

import vmdg


def draw(traced: vmdg.History, jumped: vmdg.History, strengths: np.ndarray) -> plt.Figure:
    """Force over the way of the grips: the path, what a machine records, and what happens on it."""
    figure, ax = plt.subplots(figsize=(8, 4.5), layout="constrained")
    way = np.linspace(0, 10 * max(traced["load"]), 1000)
    exact = np.array([order_statistics(strengths, stress) for stress in way])
    exact[np.append(np.diff(exact) < -0.5, False)] = np.nan
    ax.plot(way, exact, color="0.8", lw=6, label="order statistics")
    ax.plot(10 * traced["load"], traced["force"], "C0.-", lw=1, ms=4, label='unstable="trace"')
    ax.plot(10 * jumped["load"], jumped["force"], "C3--", lw=1, label='unstable="jump"')
    (jumps,) = np.nonzero(jumped["jump_steps"])
    ax.plot(10 * jumped["load"][jumps - 1], jumped["force"][jumps - 1], "kv", label="limit point")
    ax.plot(10 * jumped["load"][jumps], jumped["force"][jumps], "k^", label="end of a jump")
    ax.set(xlabel="stress of an unbroken bar [MPa]", ylabel="force by the width of a bar [MPa]")
    ax.set(xlim=(0, None), ylim=(0, None))
    ax.legend(loc="upper left")
    return figure


def main(
    bars: int = 4,
    critical_gap: float = 0.006,
    steps: int = 20,
    seed: int = 3,
    out: str = "results/weak_links",
    plot: bool = True,
    verbose: bool = False,
) -> dict[str, vmdg.History]:
    """Pull the grips apart twice; the histories, by what happens at a snap.

    Args:
        bars: Their number; strengths are drawn between 4 and 10 MPa.
        critical_gap: At which a bond is gone [mm]; below 2 L P_c/E = .008 mm every bar snaps.
        steps: Load steps.
        seed: Of the strengths.
        out: Folder for picture and histories.
        plot: Draw the picture.
        verbose: Print the residuals of every step.
    """
    strengths = np.sort(np.random.default_rng(seed).uniform(4.0, 10.0, bars))
    histories, comm = {}, MPI.COMM_WORLD
    for unstable in ("trace", "jump"):
        problem, monitor = bundle(comm, strengths, critical_gap)
        shown = {"progress": True, "verbose": verbose, "csv": f"{out}/{unstable}.csv"}
        options = vmdg.SolveOptions(unstable=unstable, energy=True, **shown)
        histories[unstable] = vmdg.solve(problem, steps, options, monitor).history
    if plot and comm.rank == 0:
        draw(histories["trace"], histories["jump"], strengths).savefig(
            f"{out}/weak_links.png", dpi=130
        )
        print(f"results are in {out}")
    return histories


if __name__ == "__main__":
    run(main)
