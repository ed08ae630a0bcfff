"""The scenes at a coarse size on these ranks, compared with what other numbers of ranks gave.

    demos/run -n 1 tests/support/ranks.py FOLDER [SCENE...]
    demos/run -n 4 tests/support/ranks.py FOLDER [SCENE...]

For every run of :func:`vmdg.solve` rank 0 writes the number of unknowns, the iterations of all
steps, and the norm of the reactions at the end of every step to the folder.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

import numpy as np

import vmdg
from vmdg.base.parallel import global_norm

sys.path.append(str(Path(__file__).resolve().parents[2] / "demos"))
import fibre_matrix
import load_cycle
import patch_shear
import patch_tension
import pushout
import tearing
import two_inclusions

SCENES = {
    "patch, tension": lambda out: patch_tension.main(steps=10, out=out),
    "patch, shear": lambda out: patch_shear.main(out=out),
    "load cycle": lambda out: load_cycle.main(steps=20, out=out),
    "fibre": lambda out: fibre_matrix.main(element_size=0.3, critical_gap=0.01, out=out),
    "fibres, on demand": lambda out: fibre_matrix.main(
        "triangle", 0.4, end=1e-3, fibres=4, activate="on-demand", out=out
    ),
    "tearing": lambda out: tearing.main(mesh="coarse", out=out),
    "push-out, section": lambda out: pushout.main(refine=0.5, steps=10, plot=False, out=out),
    "push-out": lambda out: pushout.main(True, 5, 0.4, steps=6, end=0.03, plot=False, out=out),
    "inclusions": lambda out: two_inclusions.main(element_size=0.1, out=out),
}


def differences(folder: Path) -> list[tuple[str, int, float]]:
    """Scene, ranks, and largest difference of the forces from those of one rank, relative.

    Infinite where unknowns or iterations differ.
    """
    alone = json.loads((folder / "ranks_1.json").read_text())
    found = []
    for file in sorted(folder.glob("ranks_*.json")):
        several, ranks = json.loads(file.read_text()), int(file.stem.split("_")[1])
        for name in alone.keys() & several.keys():
            pairs = zip(alone[name], several[name], strict=True)
            found.append((name, ranks, max(difference(*pair) for pair in pairs)))
    return sorted(found)


def difference(run: dict, other: dict) -> float:
    """Largest one of the forces of two runs, relative to the largest force."""
    if any(run[count] != other[count] for count in ("unknowns", "iterations")):
        return float("inf")
    forces = np.array(run["forces"])
    return float(np.abs(forces - other["forces"]).max() / forces.max())


def main(names: list[str], folder: str) -> None:
    """Run these scenes; writes ``folder``/ranks_N.json."""
    comm, solve, runs = MPI.COMM_WORLD, vmdg.solve, []

    def watched(problem, loads, options=None, monitor=None, history=None):
        # Condensed steps are for one rank.
        options = replace(options or vmdg.SolveOptions(), relative_tolerance=1e-11, condensed=False)
        forces = []

        def look(problem):
            # Facets that open renumber the dofs.
            reactions = problem.forces.x.array[problem.owned_prescribed]
            forces.append(global_norm(problem.comm, reactions))
            return monitor(problem) if monitor else None

        result = solve(problem, loads, options, look, history)
        iterations = result.history["iterations"][-len(forces) :].tolist()
        size = problem.space.dofmap.index_map.size_global
        runs.append({"unknowns": size, "iterations": iterations, "forces": forces})
        return result

    vmdg.solve = watched
    Path(folder).mkdir(parents=True, exist_ok=True)
    found = {}
    for name in names:
        runs.clear()
        SCENES[name](f"{folder}/{comm.size}")
        found[name] = list(runs)
    if comm.rank == 0:
        Path(folder, f"ranks_{comm.size}.json").write_text(json.dumps(found))
        if Path(folder, "ranks_1.json").is_file():
            for name, ranks, largest in differences(Path(folder)):
                print(f"{name:20} {ranks:3} ranks, forces differ by {largest:.1e}")


if __name__ == "__main__":
    main(sys.argv[2:] or list(SCENES), sys.argv[1])
