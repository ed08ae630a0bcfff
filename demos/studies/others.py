"""Two scenes by vmdg and by other cohesive codes, fedoo and Akantu, one after the other.

P1, a cracked plate, and P2, two cubes, as in ``parts/benchmark/peers``: the same meshes, the same
equal load steps (40 and 20), one thread, each code with the solver that it recommends. vmdg also
takes 40 steps of its own, short where strength times area is reached. Intrinsic elements reach the
strength at an opening of 1e-4 mm, half a percent of the critical gap.

The other codes are installed from PyPI on the first call, in an environment of their own in the
user's cache folder. Seconds are processor time of the load steps in a warm process.
"""

from __future__ import annotations

from mpi4py import MPI

from parts.benchmark import peers
from parts.options import run
from parts.others.cases import COARSE, HEAD, Line, cases, prepare
from parts.tables import markdown, progress, report


def main(
    coarse: bool = False,
    repeats: int = 1,
    alone: bool = False,
    python: str | None = None,
    out: str = "results/others",
) -> list[Line]:
    """Run all codes; the lines of the table.

    Args:
        coarse: Small meshes, whose slopes are compared with those of the others all the same.
        repeats: Runs, of which the fastest counts.
        alone: Run vmdg only, which needs no other packages.
        python: That the environment of the other codes is made of; without it one is found.
        out: Folder for the table.

    Raises:
        RuntimeError: several ranks, or the other codes are not there and cannot be installed.
    """
    if MPI.COMM_WORLD.size > 1:
        raise RuntimeError("the other codes run on one rank: leave -n out")
    place = None if alone else prepare(python)
    scenes = COARSE.values() if coarse else (peers.P1, peers.P2)
    lines = [case() for case in progress(cases(list(scenes), repeats, place), "run")]
    text = markdown(HEAD, [line.cells() for line in lines])
    report(out, "others", text)
    return lines


if __name__ == "__main__":
    run(main)
