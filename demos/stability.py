"""Random stress runs: cells, materials, laws, steps and motions far from ordinary, all checked.

Every run has a number that fixes all that is drawn. It must end in a state that passes every check
of ``_stability_checks.py``, or in a clear error: at the door, or with the state of the last
converged step intact. The families are in ``_stability_cases.py``.
"""

from __future__ import annotations

import argparse
from itertools import chain
from pathlib import Path

from mpi4py import MPI

from _stability import BAD, Outcome, plot, stress, table, write_csv
from _stability_cases import numbers
from tqdm import tqdm


def main(each: int = 30, only: int | None = None, out: str = "results/stability") -> list[Outcome]:
    """``each`` runs of every family, or one run; table, list and picture go to the folder ``out``.

    Ranks take turns: every run is one of a single rank.
    """
    comm = MPI.COMM_WORLD
    chosen = numbers(each) if only is None else [only]
    bar = tqdm(chosen[comm.rank :: comm.size], unit="run", disable=comm.rank > 0)
    mine = []
    for number in bar:
        mine.append(outcome := stress(number))
        if outcome.verdict in BAD or only is not None:
            lines = (f"run {number}, {outcome.family}: {outcome.verdict}", outcome.case)
            bar.write("\n".join((*lines, outcome.detail)))
    outcomes = sorted(chain(*comm.allgather(mine)), key=lambda outcome: outcome.number)
    if comm.rank == 0 and only is None:
        Path(out).mkdir(parents=True, exist_ok=True)
        (Path(out) / "stability.md").write_text(table(outcomes) + "\n")
        write_csv(outcomes, Path(out) / "stability.csv")
        plot(outcomes).savefig(Path(out) / "stability.png", dpi=130)
        print(table(outcomes))
        print(f"table, list of the runs and picture are in {out}")
    return outcomes


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--each", type=int, default=30, help="runs of every family (30 at most)")
    parser.add_argument("--only", type=int, help="this run only, for example one that failed")
    parser.add_argument("--out", default="results/stability", help="folder for the results")
    main(**vars(parser.parse_args()))
