"""Motion in time: energy where a bond opens and closes, and steps that interfaces allow.

A bar that parts in its middle and beats for 50 periods, by vmdg and by extrinsic cohesive elements
with a penalty, which gain energy in steps close to the critical one. Critical steps of central
differences with interfaces, relative to those of plain elements on the same mesh. The cases are in
``parts/in_time``.
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
from parts.in_time import critical
from parts.in_time.extrinsic import FAILED, PERIOD, Beat, extrinsic, variational
from parts.options import run
from parts.tables import markdown

HEAD = ("bar in two by", "step c/h", "periods", "largest energy", "change of T in a step")


def draw(beats: list[Beat]) -> plt.Figure:
    """Energy over the first three periods."""
    figure, ax = plt.subplots(figsize=(9, 4), layout="constrained")
    for beat in beats:
        label, thick = f"{beat.name}, {beat.step:.2f}", beat.name == "vmdg"
        line = ax.semilogy(beat.times / PERIOD, beat.energy, lw=2 if thick else 0.8, label=label)
        line[0].set_color("k" if thick else line[0].get_color())
    ax.set(xlabel="periods", ylabel="energy, relative to that at the start", ylim=(0.8, FAILED))
    ax.set_xlim(0, 3)
    figure.legend(title="by, step c/h", fontsize=8, loc="outside right upper")
    return figure


def main(
    coarse: bool = False,
    out: str = "results/in_time",
    plot: bool = True,
) -> tuple[list[Beat], list[tuple]]:
    """Run all; the bars, and the rows of the table of critical steps.

    Args:
        coarse: Few periods, and cells of degree 1 only.
        out: Folder for tables and picture.
        plot: Draw the picture.
    """
    if MPI.COMM_WORLD.rank > 0:
        return [], []
    n, periods = (10, 5.0) if coarse else (20, 50.0)
    beats = [extrinsic(n, p, step, periods) for p in (1.0, 10.0) for step in (0.8, 0.5, 0.2)]
    beats.append(variational(n, periods))
    degrees = (1,) if coarse else (1, 2)
    cases = [(c, k, e) for c in critical.DIVISIONS for k in degrees for e in (1.0, 10.0)]
    rows = [critical.steps(*case) for case in cases]
    text = "\n\n".join(
        (markdown(HEAD, (beat.row() for beat in beats)), markdown(critical.HEAD, rows))
    )
    Path(out).mkdir(parents=True, exist_ok=True)
    (Path(out) / "in_time.md").write_text(text + "\n")
    if plot:
        draw(beats).savefig(Path(out) / "in_time.png", dpi=130)
    print(text)
    print(f"results are in {out}")
    return beats, rows


if __name__ == "__main__":
    run(main)
