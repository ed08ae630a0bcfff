"""Random stress runs: cells, materials, laws, steps and motions far from ordinary, all checked.

Every run has a number that fixes all that is drawn. It must end in a state that passes every check
of ``parts/stability/checks.py``, or in a clear error: on input, or with the state of the last
converged step intact. The families are in ``parts/stability/cases.py``.
"""

from __future__ import annotations

from parts.options import run
from parts.stability.runner import BAD, GOOD, Outcome, numbers, run_all, stress


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
    shown = (*GOOD, *BAD) if verbose else BAD
    return run_all(numbers(each), stress, "stability", out, only, shown)


if __name__ == "__main__":
    run(main)
