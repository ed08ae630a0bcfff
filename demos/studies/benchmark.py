"""Seconds, counts and memory of vmdg against plain finite elements and other cohesive codes.

Parts, one or several by name: "precision" draws error against unknowns and processor time, "intact"
lists errors of intact interfaces where they differ most from those of plain elements, "ratio"
compares one Newton iteration, "plastic" those of plastic and elastic bodies, "separate" those of
bodies meshed separately and together, "explicit" times steps in time, "small" rows of small
problems in and outside of compiled code, "derivatives" runs that carry derivatives by parameters,
"zone" counts Krylov iterations while a zone of failure grows, "step" tells what else a load step
does, "peers" runs two scenes that other codes were given, "switches" runs one of them with and
without what can be spared, "kernels" lists what is compiled, "memory" measures the push-out.
Seconds are processor time of warm runs on one core, the least of some; whatever is compared takes
turns in one process. On one rank, but "ratio" and "explicit", which on several tell the times of
the slowest.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from mpi4py import MPI

from parts.benchmark.common import table
from parts.benchmark.parts import PARTS
from parts.benchmark.precision import records
from parts.options import run

from vmdg.base.timers import timings, timings_since


def main(
    parts: list[str] | None = None,
    coarse: bool = False,
    repeats: int = 3,
    out: str = "results/benchmark",
    plot: bool = True,
    verbose: bool = False,
) -> dict[str, Any]:
    """Run parts; what each has found by name.

    Args:
        parts: Some of precision, intact, ratio, plastic, separate, explicit, small, derivatives,
            zone, step, peers, switches, kernels and memory; all without any.
        coarse: Small meshes.
        repeats: Runs, of which the fastest counts.
        out: Folder for tables and pictures.
        plot: Draw the pictures.
        verbose: Print what the timers of vmdg have measured in every part.

    Raises:
        ValueError: a part that does not exist.
    """
    if unknown := set(parts or ()) - set(PARTS):
        raise ValueError(f"no part is called {', '.join(unknown)}; they are {', '.join(PARTS)}")
    found, folder, writes = {}, Path(out), MPI.COMM_WORLD.rank == 0
    folder.mkdir(parents=True, exist_ok=True)
    for part in parts or PARTS:
        before = timings()
        found[part], text, draw = PARTS[part](coarse, repeats)
        if not writes:
            continue
        if verbose:
            print(table(("timer", "runs", "s"), timings_since(before)))
        print(f"\n{part}\n\n{text}\n")
        (folder / f"{part}.md").write_text(text + "\n")
        if plot and draw is not None:
            draw().savefig(folder / f"{part}.png", dpi=130)
    if "precision" in found:
        with open(folder / "precision.csv", "w", newline="") as file:
            lines = records(found["precision"])
            writer = csv.DictWriter(file, list(lines[0]))
            writer.writeheader()
            writer.writerows(lines)
    if writes:
        print(f"results are in {out}")
    return found


if __name__ == "__main__":
    run(main)
