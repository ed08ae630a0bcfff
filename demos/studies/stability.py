"""Random stress runs: cells, materials, laws, steps and motions far from ordinary, all checked.

Every run has a number that fixes all that is drawn. It must end in a state that passes every check
of ``parts/stability/checks.py``, or in a clear error: on input, or with the state of the last
converged step intact. The families are in ``parts/stability/cases.py``.
"""

from __future__ import annotations

from itertools import chain

from mpi4py import MPI

from parts.options import run
from parts.stability.runner import BAD, Outcome, numbers, report, stress
from parts.tables import progress


def main(
    each: int = 30,
    only: int | None = None,
    out: str = "results/stability",
    verbose: bool = False,
) -> list[Outcome]:
    """Run some of every family, or one run. Ranks take turns: every run is one of a single rank.

    Args:
        each: Runs of every family, 30 at most.
        only: Number of the only run, for example of one that failed.
        out: Folder for table and list of runs.
        verbose: Print the verdict on every run.
    """
    comm = MPI.COMM_WORLD
    chosen = numbers(each) if only is None else [only]
    bar = progress(chosen[comm.rank :: comm.size], "run", shown=comm.rank == 0)
    mine = []
    for number in bar:
        mine.append(outcome := stress(number))
        if verbose or outcome.verdict in BAD or only is not None:
            lines = (f"run {number}, {outcome.family}: {outcome.verdict}", outcome.case)
            bar.write("\n".join((*lines, outcome.detail)))
    outcomes = sorted(chain(*comm.allgather(mine)), key=lambda outcome: outcome.number)
    if comm.rank == 0 and only is None:
        report(outcomes, out, "stability")
    return outcomes


if __name__ == "__main__":
    run(main)
