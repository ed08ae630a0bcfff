"""Closed forms: bar, shrink fit, inclusion, partial slip, push-out, delamination of beams.

Prints one table, computed against exact, with the mesh and the seconds each scene took, and draws
load and crack length of the beam over its opening. The formulas stand in ``_verification.py``,
``_partial_slip.py``, ``_shear_lag.py`` and ``_beams.py``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
from _beams import dcb, enf
from _partial_slip import partial_slip
from _shear_lag import push_out
from _verification import Check, bimaterial_bar, goodier, shrink_fit, table, timed

import vmdg


def draw(history: vmdg.History) -> plt.Figure:
    """Load and crack length of the beam."""
    figure, axes = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    for ax, name, label in zip(
        axes, ("force", "crack"), ("load P [N]", "crack a [mm]"), strict=True
    ):
        ax.plot(history["load"], history[name], label="vmdg")
        ax.plot(history["load"], history[f"{name}_exact"], "--", label="corrected beam theory")
        ax.set(xlabel="opening [mm]", ylabel=label)
        ax.grid(lw=0.3)
    axes[0].legend()
    figure.suptitle("Double cantilever beam, data of Alfano and Crisfield")
    return figure


def main(coarse: bool = False, out: str = "results/verification") -> list[Check]:
    """Run all scenes; table and picture go to the folder ``out``. Coarse has no beams."""
    checks: list[Check] = []
    size = 0.1 if coarse else 0.025
    scenes = [
        bimaterial_bar,
        lambda: shrink_fit(size),
        lambda: goodier(size),
        lambda: partial_slip(0.2 if coarse else 0.05),
        lambda: push_out(40 if coarse else 80),
    ]
    for scene in scenes:
        with timed(checks):
            checks += scene()
    run = None
    if not coarse:
        with timed(checks):
            run = dcb()
            checks += run.checks
        with timed(checks):
            checks += enf(element_size=0.125, steps=54, end=1.62, rows=3).checks
        with timed(checks):
            checks += enf(friction=0.3, steps=27, end=1.62).checks
    if MPI.COMM_WORLD.rank == 0:
        Path(out).mkdir(parents=True, exist_ok=True)
        (Path(out) / "verification.md").write_text(table(checks) + "\n")
        if run is not None:
            draw(run.history).savefig(Path(out) / "verification.png", dpi=130)
        print(table(checks))
        print(f"results are in {out}")
    return checks


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--coarse", action="store_true", help="coarse meshes, without the beams")
    parser.add_argument("--out", default="results/verification", help="folder for the results")
    main(**vars(parser.parse_args()))
