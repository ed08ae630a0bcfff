"""Linear systems condensed to the interface against those of the assembled tangent.

Two scenes at small strain: a fibre that debonds in a cell (section 7.2 without cracks in the
matrix) and the fibre push-out (section 7.4), as a section and in 3D. Both ways take the same steps.
The assembled tangent is refactorized in 2D and in small problems; in 3D factors are lagged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from time import process_time

import numpy as np
from numpy.typing import NDArray

import vmdg
from parts import scenes
from parts.scenes import pushout
from vmdg.meshes import fibre_matrix

TOLERANCE = 1e-9
#: Punch of section 7.4 [mm].
PUNCH = 0.174


@dataclass(frozen=True)
class Scene:
    """A problem at small strain.

    Attributes:
        problem: Not solved yet.
        loads: Load factors to reach.
        force: What is compared [N].
        cure: Load factors before them.
        punch: Prescribes what moves after the cure.
    """

    problem: vmdg.Problem
    loads: NDArray[np.float64]
    force: Callable[[vmdg.Problem], float]
    cure: NDArray[np.float64] | None = None
    punch: Callable[[], None] | None = None


def cell(element_size: float) -> Scene:
    """A fibre that debonds from its matrix, pulled at both sides."""
    tagged = fibre_matrix(element_size=element_size)
    problem = scenes.fibre_matrix.build(tagged, 0.2, kinematics="small")
    right = tagged.facet_tags.find("right")
    return Scene(
        problem,
        scenes.fibre_matrix.pulls(1e-4, 0.005, 1.1),
        lambda problem: problem.reaction(right)[0],
    )


def push_out(solid: bool, refine: float, steps: int) -> Scene:
    """The cure and the punch of a fibre."""
    model = pushout.build(solid, 25, refine, pushout.LAW, pushout.FIBRE_MODULUS, small=True)
    problem, axis = model.problem, "xyz".index(model.axis)
    return Scene(
        problem,
        1 + PUNCH * np.arange(1, steps + 1) / steps,
        lambda problem: problem.reaction(model.top)[axis],
        np.linspace(0.25, 1, 4),
        lambda: problem.dirichlet(model.top, lambda t: 1 - t, model.axis, relative=True),
    )


SCENES: dict[str, Callable[[], Scene]] = {
    "fibre in a cell, h = 0.1": partial(cell, 0.1),
    "fibre in a cell, h = 0.03": partial(cell, 0.03),
    "fibre in a cell, h = 0.01": partial(cell, 0.01),
    "push-out, section": partial(push_out, False, 1.0, 100),
    "push-out, 3D, half of all counts": partial(push_out, True, 0.5, 100),
    "push-out, 3D": partial(push_out, True, 1.0, 100),
}
COARSE: dict[str, Callable[[], Scene]] = {
    "fibre in a cell, h = 0.1": SCENES["fibre in a cell, h = 0.1"],
    "push-out, section": partial(push_out, False, 0.5, 10),
}


@dataclass(frozen=True)
class Gain:
    """A scene in both ways.

    Attributes:
        name: Of the scene.
        unknowns: Of the displacement.
        gaps: Components of the gaps at the points of the interface.
        steps: Load factors given.
        seconds: Processor time of the steps, by way [s].
        difference: Of the forces, relative to the largest: the median and the most of all steps.
    """

    name: str
    unknowns: int
    gaps: int
    steps: int
    seconds: dict[str, float]
    difference: tuple[float, float]


ASSEMBLED, CONDENSED = "assembled", "condensed"


def run(scene: Scene, way: str) -> tuple[float, NDArray[np.float64]]:
    """Processor time of the steps [s] and the forces [N]."""
    problem = scene.problem
    options = vmdg.SolveOptions(relative_tolerance=TOLERANCE, condensed=way == CONDENSED)
    problem.discretization.compile()
    start = process_time()
    if scene.punch is not None:
        vmdg.solve(problem, scene.cure, options)
        scene.punch()
    history = vmdg.solve(problem, scene.loads, options, lambda p: {"force": scene.force(p)}).history
    rows = np.isin(history["load"], scene.loads)  # steps that were cut have rows of their own
    return process_time() - start, history["force"][rows]


def measure(name: str, make: Callable[[], Scene], repeats: int = 1) -> Gain:
    """Run both ways in turns, some times for the least processor time."""
    seconds = dict.fromkeys((ASSEMBLED, CONDENSED), np.inf)
    forces = {}
    for _ in range(repeats):
        for way in seconds:
            scene = make()
            took, forces[way] = run(scene, way)
            seconds[way] = min(seconds[way], took)
    problem = scene.problem
    return Gain(
        name,
        problem.space.dofmap.index_map.size_global * problem.space.dofmap.index_map_bs,
        problem.state[0].gap.size,
        len(scene.loads),
        seconds,
        _apart(forces[CONDENSED], forces[ASSEMBLED]),
    )


def _apart(first: NDArray[np.float64], second: NDArray[np.float64]) -> tuple[float, float]:
    """Median and most of the difference, relative to the largest of the first."""
    apart = np.abs(first - second) / np.abs(first).max()
    return float(np.median(apart)), float(apart.max())


HEAD = (
    "scene",
    "unknowns",
    "gaps",
    "steps",
    f"{ASSEMBLED} [s]",
    f"{CONDENSED} [s]",
    "gain",
    "difference of the forces",
)


def rows(gains: list[Gain]) -> Iterator[list[str | float]]:
    """Of the table below ``HEAD``."""
    for gain in gains:
        yield [
            gain.name,
            gain.unknowns,
            gain.gaps,
            gain.steps,
            *gain.seconds.values(),
            gain.seconds[ASSEMBLED] / gain.seconds[CONDENSED],
            "{:.1e}, most {:.1e}".format(*gain.difference),
        ]
