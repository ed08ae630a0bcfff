"""Random scenes of two bodies and an interface, each judged by the same scene told otherwise.

Every scene has a number that fixes kinematics, cells, degree, bodies, law, how the surfaces meet
and the load. It is turned, mirrored, put into other units, given by points, as two meshes, with its
sides swapped, and on finer meshes: forces and energies must be the same. All checks of the study of
stability hold as well. On several ranks every scene is solved by all of them together and by each
alone.
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

from parts.bars import progress
from parts.interfaces.judges import judged, numbers, ranks
from parts.options import run
from parts.stability.runner import BAD, Outcome, stress, table, write_csv

#: Seconds for a scene with all that it is compared with.
PATIENCE = 1800


def main(
    each: int = 40, only: int | None = None, first: int = 0, out: str = "results/interfaces"
) -> list[Outcome]:
    """Run some of every way in which the bodies meet, or one scene.

    Args:
        each: Scenes of every way.
        only: Number of the only scene.
        first: Number of the first scene, a multiple of 5.
        out: Folder for the table and the list of the scenes.
    """
    comm = MPI.COMM_WORLD
    bar = progress(numbers(each, first) if only is None else [only], "scene", comm.rank == 0)
    outcomes = []
    for number in bar:
        if comm.size > 1:
            outcome = ranks(number)
        else:
            outcome = stress(number, PATIENCE, draw=judged)
        outcomes.append(outcome)
        if comm.rank == 0 and (outcome.verdict in BAD or only is not None):
            lines = (f"scene {number}, {outcome.verdict}: {outcome.case}", outcome.detail)
            bar.write("\n".join(lines))
    if comm.rank == 0 and only is None:
        Path(out).mkdir(parents=True, exist_ok=True)
        (Path(out) / "interfaces.md").write_text(table(outcomes) + "\n")
        write_csv(outcomes, Path(out) / "interfaces.csv")
        print(table(outcomes))
        print(f"results are in {out}")
    return outcomes


if __name__ == "__main__":
    run(main)
