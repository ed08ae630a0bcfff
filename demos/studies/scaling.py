"""Strong and weak scaling on this machine or a cluster: seconds, messages and memory by ranks.

Every run appends a line to a file in the folder of results, prints the table so far and draws it.
The first line of a folder is what the others are compared with: run it on one rank.

Strong: the same mesh on more ranks,       demos/run -n 1 scaling, demos/run -n 2 scaling, ...
Weak: as many cells for every rank,        demos/run -n 1 scaling --weak, ...
Alone: every rank runs the scene of one by itself and waits for none: what the machine allows, for
the table of weak scaling,                 demos/run -n 2 scaling --alone, ...
"""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

from mpi4py import MPI

from parts.benchmark.common import table
from parts.options import run
from parts.scaling.measure import HEAD, Row, draw, measure


def main(
    cells: int = 18,
    load: float = 1.0,
    share: float = 0.01,
    apart: bool = False,
    weak: bool = False,
    alone: bool = False,
    out: str = "results/scaling",
    fresh: bool = False,
    plot: bool = True,
    verbose: bool = False,
) -> list[Row]:
    """Run, and the rows so far; collective.

    Args:
        cells: Cells along an edge of one of the two cubes, on one rank.
        load: Share of the load, which takes all of the bond through its law [-].
        share: Of the bond that breaks in a step at most [-].
        apart: Pull the cubes apart by the work on their bond, which nothing holds in the end.
        weak: Multiply the cells with the number of ranks.
        alone: Run the scene of one rank on every rank; the row is that of the slowest.
        out: Folder of the results.
        fresh: Forget what it has.
        plot: Draw the picture.
        verbose: Print the residuals of every step.
    """
    comm = MPI.COMM_WORLD
    n = round(cells * comm.size ** (1 / 3)) if weak else cells
    row = measure(n, MPI.COMM_SELF if alone else comm, load, share, apart, verbose)
    if alone:
        slowest = max(comm.allgather(row), key=lambda row: row.seconds)
        row = replace(slowest, ranks=comm.size, unknowns=comm.size * row.unknowns)
    rows: list[Row] = []
    if comm.rank == 0:
        file = Path(out) / ("weak.jsonl" if weak or alone else "strong.jsonl")
        file.parent.mkdir(parents=True, exist_ok=True)
        with open(file, "w" if fresh else "a") as lines:
            lines.write(json.dumps(asdict(row)) + "\n")
        rows = [Row(**json.loads(line)) for line in file.read_text().splitlines()]
        text = table(HEAD, [row.line(rows[0]) for row in rows])
        file.with_suffix(".md").write_text(text + "\n")
        if plot:
            draw(rows).savefig(file.with_suffix(".png"), dpi=130)
        print(f"{text}\n\nresults are in {out}")
    return comm.bcast(rows)


if __name__ == "__main__":
    run(main)
