"""A push-out that is meant to be killed: ``python3 killed_run.py FOLDER LOG``.

It goes on from the checkpoint in FOLDER, if there is one, and adds a line to LOG after every step:
its load factor and the time.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pushout as scene

import vmdg

#: Over the snap at the peak, where a step takes many others.
LOADS = 1 + np.linspace(0, 0.12, 25)[1:]
EVERY = 3
OPTIONS = {"relative_tolerance": 1e-7, "checkpoint_every": EVERY}


def model(folder: Path) -> scene.Model:
    """The coarse section after the cure, gripped by the punch; one cure serves all runs."""
    model = scene.build(False, 10, 0.5, scene.LAW, scene.FIBRE_MODULUS)
    cure = folder.parent / "cure"
    if vmdg.read_checkpoint(model.problem, cure) is None:
        vmdg.solve(model.problem, [0.5, 1.0], vmdg.SolveOptions(relative_tolerance=1e-8))
        vmdg.write_checkpoint(model.problem, cure)
    model.problem.dirichlet(model.top, lambda t: 1 - t, model.axis, relative=True)
    return model


def main(folder: Path, log: Path) -> vmdg.History:
    """Run to the end from wherever the checkpoint is."""
    push = model(folder)
    problem = push.problem
    history = vmdg.read_checkpoint(problem, folder)
    with open(log, "a") as lines:

        def monitor(problem: vmdg.Problem) -> dict[str, float]:
            print(problem.t, time.time(), file=lines, flush=True)
            return push.measures(problem)

        loads = LOADS[LOADS > problem.t + 1e-12]
        options = vmdg.SolveOptions(checkpoint=folder, **OPTIONS)
        return vmdg.solve(problem, loads, options, monitor, history).history


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
