"""Negative eigenvalues of tied tangents at random: safety="auto" against fixed factors.

Two cells and the facet between them, and patches all of whose facets are interfaces: heights of
1e-3 to 1e3 of the width, distorted and sheared, moduli up to 1e8 apart, Poisson's ratios up to
.4999, deformed by F with |F - I| up to .5 where the moduli are positive. Counted are
configurations whose tangent has a negative eigenvalue: there the tied form is not coercive.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

from mpi4py import MPI

from _coercivity import CASES, Count, count

SAFETIES = ("auto", 1.0, 2.0, 4.0)


def main(seed: int = 0, share: float = 1.0) -> dict[str, list[Count]]:
    """Print the table, a row a class of configurations; counts by class, one for each safety.

    ``share`` of the 2,076 configurations are drawn.
    """
    table = {}
    if MPI.COMM_WORLD.rank > 0:
        return table
    print(f"{'':>27}  count   negative with safety    factor of auto")
    print(f"{'':>36}  auto     1     2     4    median, largest")
    cases = [replace(case, count=max(round(share * case.count), 1)) for case in CASES]
    for case in cases:
        configurations = case.draw(seed)
        counts = [count(safety, configurations) for safety in SAFETIES]
        table[str(case)] = counts
        negative = " ".join(f"{c.negative:5d}" for c in counts)
        auto = counts[0]
        print(f"{case!s:>27}: {case.count:5d}   {negative}   {auto.median:.3g}, {auto.largest:.3g}")
    total = " ".join(f"{sum(row[i].negative for row in table.values()):5d}" for i in range(4))
    print(f"{'all':>27}: {sum(case.count for case in cases):5d}   {total}")
    return table


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0, help="of the random numbers (default 0)")
    parser.add_argument("--share", type=float, default=1.0, help="of the configurations")
    main(**vars(parser.parse_args()))
