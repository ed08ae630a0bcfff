"""Closed forms: bar, shrink fit, inclusion, partial slip, push-out, delamination of beams.

Prints one table, computed against exact, with the mesh and the seconds each scene took, and draws
load and crack length of the beams over opening and deflection. The formulas stand in
``parts/verification``.
"""

from __future__ import annotations

import matplotlib.pyplot as plt
from parts.delamination.beams import dcb, enf
from parts.options import run
from parts.tables import report
from parts.verification.checks import Check, bimaterial_bar, goodier, shrink_fit, table, timed
from parts.verification.partial_slip import partial_slip
from pushout_parameters import push_out

import vmdg


def draw(runs: dict[str, vmdg.History]) -> plt.Figure:
    """Load and crack length of the beams, a row for every scene."""
    scenes = (("DCB", "opening"), ("ENF", "deflection"))
    size = {"figsize": (9.5, 7.2), "layout": "constrained"}
    figure, axes = plt.subplots(len(scenes), 2, **size)
    columns = (("force", "load [N]"), ("crack", "crack length [mm]"))
    for row, (scene, motion) in zip(axes, scenes, strict=True):
        mine = {name: history for name, history in runs.items() if name.startswith(scene)}
        for ax, (column, label) in zip(row, columns, strict=True):
            for i, (name, history) in enumerate(mine.items()):
                ax.plot(
                    history["load"], history[column], f"C{i}", lw=2.4, label=name.replace("mu", "μ")
                )
            for i, history in enumerate(mine.values()):
                theory, said = history[f"{column}_exact"], "_" * i + "corrected beam theory"
                ax.plot(history["load"], theory, "k--", lw=1, label=said)
            ax.set(xlabel=f"{motion} [mm]", ylabel=label)
            ax.grid(lw=0.3)
        row[0].legend()
    figure.suptitle("Delamination of the laminate of Alfano and Crisfield")
    return figure


def main(
    coarse: bool = False,
    out: str = "results/verification",
    plot: bool = True,
    verbose: bool = False,
) -> list[Check]:
    """Run all scenes; what was compared.

    Args:
        coarse: Coarse meshes, and no beams.
        out: Folder for table and picture.
        plot: Draw the picture.
        verbose: Print the residuals of every step.
    """
    checks: list[Check] = []
    size = 0.1 if coarse else 0.025
    scenes = [
        lambda: bimaterial_bar(verbose=verbose),
        lambda: shrink_fit(size, verbose=verbose),
        lambda: goodier(size, verbose=verbose),
        lambda: partial_slip(0.2 if coarse else 0.05, verbose=verbose),
        lambda: push_out(20 if coarse else 80, verbose=verbose),
    ]
    for scene in scenes:
        with timed(checks):
            checks += scene()
    fine = {"element_size": 0.125, "end": 1.62, "rows": 3, "verbose": verbose}
    beams = {
        "DCB": lambda: dcb(verbose=verbose),
        "ENF, mu = 0": lambda: enf(0.0, **fine),
        "ENF, mu = 0.3": lambda: enf(0.3, **fine),
    }
    runs = {}
    for name, scene in ({} if coarse else beams).items():
        with timed(checks):
            beam = scene()
            checks += beam.checks
            runs[name] = beam.history
    report(out, "verification", table(checks), draw(runs) if plot and runs else None)
    return checks


if __name__ == "__main__":
    run(main)
