"""Negative eigenvalues of tied tangents at random: safety="auto" against fixed factors.

Two cells and the facet between them, and patches all of whose facets are interfaces: heights of
1e-3 to 1e3 of the width, distorted and sheared, moduli up to 1e8 apart, Poisson's ratios up to
0.4999, deformed by F with |F - I| up to 0.5 where the moduli are positive. Counted are
configurations whose tangent has a negative eigenvalue: there the tied form is not coercive.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

from parts.coercivity.cells import CASES, Count, count, draw
from parts.options import run

SAFETIES = ("auto", 1.0, 2.0, 4.0)


def main(
    seed: int = 0,
    share: float = 1.0,
    out: str = "results/coercivity",
    plot: bool = True,
    verbose: bool = False,
) -> dict[str, list[Count]]:
    """Count and print the table, a row a class; counts by class, one for each safety.

    Args:
        seed: Of the random numbers.
        share: Share of the 2,076 configurations that are drawn [-].
        out: Folder for table and picture.
        plot: Draw the picture.
        verbose: Print the smallest eigenvalues of every class.
    """
    table: dict[str, list[Count]] = {}
    if MPI.COMM_WORLD.rank > 0:
        return table
    lines = [
        f"{'':>27}  count   negative with safety    factor of auto",
        f"{'':>36}  auto     1     2     4    median, largest",
    ]
    print("\n".join(lines))
    cases = [replace(case, count=max(round(share * case.count), 1)) for case in CASES]
    for case in cases:
        configurations = case.draw(seed)
        counts = [count(safety, configurations) for safety in SAFETIES]
        table[str(case)] = counts
        negative = " ".join(f"{c.negative:5d}" for c in counts)
        auto = counts[0]
        factors = f"{auto.median:.3g}, {auto.largest:.3g}"
        lines.append(f"{case!s:>27}: {case.count:5d}   {negative}   {factors}")
        print(lines[-1])
        if verbose:
            lowest = ", ".join(f"{c.lowest:.1e}" for c in counts)
            print(f"{'smallest eigenvalues':>27}: {lowest}")
    total = " ".join(f"{sum(row[i].negative for row in table.values()):5d}" for i in range(4))
    lines.append(f"{'all':>27}: {sum(case.count for case in cases):5d}   {total}")
    print(lines[-1])
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "coercivity.txt").write_text("\n".join(lines) + "\n")
    if plot:
        sizes = [case.count for case in cases]
        draw(table, sizes, SAFETIES).savefig(folder / "coercivity.png", dpi=130)
    return table


if __name__ == "__main__":
    run(main)
