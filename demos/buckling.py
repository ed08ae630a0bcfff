"""Delamination buckling: a debonded layer under compression buckles, then peels itself off.

Plane strain, right half. A layer h = .5 mm thick on a body of H = 4 mm is debonded over L = 20 mm;
the body lies on a smooth table, its ends are pushed together by a strain e. That the layer is not
quite plane, by 1/500 of its thickness, is the imperfection that lifts it. The closed forms
(``helpers/buckling.py``) clamp it at the ends of the crack. The body is no rigid clamp, L is longer
by less than h at each end: the layer buckles 7% earlier.
"""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from helpers.buckling import CRACK, WIDTH, at_ends, build, critical, growth
from helpers.options import run

import vmdg
from vmdg.base.parallel import global_max
from vmdg.meshes.plate import RIGHT


def draw(problem: vmdg.Problem, history: vmdg.History) -> plt.Figure:
    """Rise and crack beside the closed forms, and the stress along the deformed layer."""
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
    vmdg.plot.stress(problem, "xx", ax=axes["stress"], edges=0)
    return figure


def main(
    cells: int = 4,
    end: float = 0.0074,
    steps: int = 16,
    out: str = "results/buckling",
    plot: bool = True,
    verbose: bool = False,
) -> vmdg.History:
    """Compress the ends; the history of the run.

    Args:
        cells: Along a mm.
        end: Strain of the ends [-].
        steps: Load steps.
        out: Folder for picture and history.
        plot: Draw the picture.
        verbose: Print the residuals of every step.
    """
    problem, facets = build(cells)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        rise = problem.u.x.array.reshape(-1, 2)[:, 1].max(initial=0.0)
        return {
            "force [N]": -problem.reaction(facets.find(RIGHT))[0],
            "rise [mm]": global_max(problem.comm, rise),
            "crack [mm]": (WIDTH - CRACK) * problem.debonded(),
        }

    shown = {"progress": True, "verbose": verbose, "csv": f"{out}/history.csv"}
    options = vmdg.SolveOptions(energy=True, **shown)
    history = vmdg.solve(problem, np.linspace(0, end, steps + 1)[1:], options, monitor).history
    if plot and (figure := draw(problem, history)) and problem.comm.rank == 0:
        figure.savefig(f"{out}/buckling.png", dpi=130)
    if problem.comm.rank == 0:
        print(f"buckles at {critical(CRACK):.3%}, grows at {growth(CRACK):.3%} by the closed forms")
        print(f"results are in {out}")
    return history


if __name__ == "__main__":
    run(main)
