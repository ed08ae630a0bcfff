"""Run time against error of scenes that fail: vmdg of degree 1 and 2, and a plain penalty law.

The double cantilever beam of Alfano and Crisfield, opened by 6 mm, on facets of several sizes with
vmdg, which meets 30 given load factors, and with a penalty law of K = 1e5 MPa/mm, which meets none,
on the same meshes, bodies, and direct solver, and with vmdg and the last load factor alone; the
push-out of section 7.4 in section and the bond around the fibre of section 7.2 on several meshes.
Seconds are processor time of a warm run on one core, all runs in turns in one process. Errors are
those of the force relative to its peak, against the finest mesh of ``REFERENCES`` with steps that
break at most 0.5 % of the bonds; ``--reference`` makes them again (some minutes).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Annotated

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from parts.benchmark.penalty import Penalty
from parts.delamination.beams import open_beam
from parts.delamination.laminate import ALFANO_CRISFIELD
from parts.options import run
from parts.scenes import fibre_matrix, pushout
from parts.tables import markdown, progress, report

import vmdg
from vmdg import meshes
from vmdg.meshes.beams import UPPER_LEFT

REFERENCES = Path(__file__).parent / "parts" / "benchmark" / "curves.json"
CRACK, LENGTH, FINE, END = 30.0, 100.0, 59.0, 6.0  # of the beam, mm
GAP = 0.01  # critical one of the bond of the fibre, mm
#: Where forces are compared, by scene: opening, punch and displacement of a side [mm].
GRIDS = {
    "beam": np.linspace(2.6, END, 35),
    "push-out": np.linspace(0.01, 0.174, 60),
    "fibre": np.linspace(0.0005, 0.02, 40),
}
#: Degree and size (facets [mm], refinement of the mesh, cells [mm]) of the runs and the reference.
BEAMS = ((1, 0.5), (1, 0.25), (1, 0.125), (2, 1.0), (2, 0.5), (2, 0.25))
PUSHOUTS = ((1, 0.5), (1, 1.0), (1, 2.0))
FIBRES = ((1, 0.1), (1, 0.05), (1, 0.025))
FINEST = {"beam": (2, 0.125), "push-out": (1, 3.0), "fibre": (1, 0.0125)}
STIFFNESS, SHARE = 1e5, 0.005  # MPa/mm, -

Curve = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class Line:
    """A run."""

    scene: str
    method: str
    degree: int
    size: float  # As in BEAMS, PUSHOUTS, FIBRES
    unknowns: int
    seconds: float
    systems: int  # Factorizations
    peak: float  # Error of the largest force, relative to it
    mean: float  # Mean error of the force, relative to its largest value
    most: float  # Largest one

    def cells(self) -> list[object]:
        """In a table, errors in percent."""
        errors = (f"{100 * x:.2f}" for x in (self.peak, self.mean, self.most))
        work = (self.unknowns, self.systems, f"{self.seconds:.2f}")
        return [self.scene, self.method, self.degree, self.size, *work, *errors]


HEAD = ("scene", "method", "k", "size", "unknowns", "systems", "s", "peak %", "mean %", "most %")


def timed(
    problem: vmdg.Problem,
    loads: Sequence[float],
    share: float,
    monitor: Callable[[vmdg.Problem], dict[str, float]],
) -> tuple[vmdg.Result, float]:
    """A run and its processor time [s]; kernels are compiled before."""
    problem.discretization.compile()
    begin = process_time()
    result = vmdg.solve(problem, loads, vmdg.SolveOptions(max_share=share), monitor)
    return result, process_time() - begin


def beam(
    degree: int, size: float, share: float = 0.1, rows: int = 30
) -> tuple[Curve, int, float, int]:
    """Opening and force, unknowns, seconds, systems, with so many given load factors."""
    layers = 4 if degree == 1 or share < 0.1 else 2
    problem, facets = open_beam(size, layers, degree, ALFANO_CRISFIELD, LENGTH, CRACK, FINE)
    upper = facets.find(UPPER_LEFT)
    monitor = lambda p: {"force": p.reaction(upper)[1]}  # noqa: E731
    result, seconds = timed(problem, np.linspace(0, END, rows + 1)[1:], share, monitor)
    return found(result, "load", seconds, problem)


def beam_alone(degree: int, size: float, share: float = 0.1) -> tuple[Curve, int, float, int]:
    """The same with the last load factor alone, as the penalty law, which meets no others."""
    return beam(degree, size, share, rows=1)


def penalty(degree: int, size: float, share: float = 0.1) -> tuple[Curve, int, float, int]:
    """The same with the penalty law."""
    layers = 4 if degree == 1 else 2
    problem, _ = open_beam(size, layers, degree, ALFANO_CRISFIELD, LENGTH, CRACK, FINE)
    plain = Penalty(problem, ALFANO_CRISFIELD, CRACK, degree, STIFFNESS)
    begin = process_time()
    work = plain.run([END / 1000, *np.linspace(END / 40, END, 40)], share)
    seconds = process_time() - begin
    x, force = np.array(work.curve).T
    return (x, force), plain.size, seconds, work.factorizations


def push(degree: int, size: float, share: float = 0.1) -> tuple[Curve, int, float, int]:
    """Punch and force after the cure, of which the seconds are not counted."""
    model = pushout.build(False, 25, size, pushout.LAW, pushout.FIBRE_MODULUS)
    vmdg.solve(model.problem, np.linspace(0.25, 1, 4))
    model.problem.dirichlet(model.top, lambda t: 1 - t, model.axis, relative=True)
    loads = 1 + np.linspace(0, 0.174, 101)[1:]
    result, seconds = timed(model.problem, loads, share, model.measures)
    return found(result, "punch", seconds, model.problem)


def fibre(degree: int, size: float, share: float = 0.1) -> tuple[Curve, int, float, int]:
    """Displacement of a side and force, without cracks in the matrix."""
    tagged = meshes.fibre_matrix(
        MPI.COMM_WORLD, "quadrilateral", fibre_matrix.SIZE, fibre_matrix.RADIUS,
        np.array([[fibre_matrix.SIZE / 2 - 0.01, fibre_matrix.SIZE / 2]]), size,
    )  # fmt: skip
    problem = fibre_matrix.build(tagged, GAP)
    right = tagged.facet_tags.find("right")
    monitor = lambda p: {"force": p.reaction(right)[0]}  # noqa: E731
    result, seconds = timed(problem, np.linspace(0, 0.02, 41)[1:], share, monitor)
    return found(result, "load", seconds, problem)


def found(
    result: vmdg.Result, column: str, seconds: float, problem: vmdg.Problem
) -> tuple[Curve, int, float, int]:
    dofmap, history = problem.space.dofmap, result.history
    unknowns = dofmap.index_map.size_global * dofmap.index_map_bs
    curve = np.asarray(history[column]), np.asarray(history["force"])
    return curve, unknowns, seconds, result.counts.factorizations


RUNS = {
    "beam": (
        ("vmdg", beam, BEAMS),
        ("vmdg, last load alone", beam_alone, BEAMS),
        ("penalty law", penalty, BEAMS),
    ),
    "push-out": (("vmdg", push, PUSHOUTS),),
    "fibre": (("vmdg", fibre, FIBRES),),
}


def sampled(scene: str, curve: Curve) -> tuple[float, NDArray[np.float64]]:
    """Largest force, and the force at the values of ``GRIDS``, on the way forward."""
    x, force = curve
    ahead = x > np.maximum.accumulate(np.append(-np.inf, x[:-1]))
    return float(force.max()), np.interp(GRIDS[scene], x[ahead], force[ahead])


def compared(scene: str, method: str, degree: int, size: float, run_one: Callable) -> Line:
    """A run against the reference of its scene."""
    reference = json.loads(REFERENCES.read_text())[scene]
    largest, force = np.array(reference["peak"]), np.array(reference["force"])
    curve, unknowns, seconds, systems = run_one(degree, size)
    peak, here = sampled(scene, curve)
    off = np.abs(here - force) / largest
    errors = abs(peak / largest - 1), off.mean(), off.max()
    return Line(scene, method, degree, size, unknowns, seconds, systems, *map(float, errors))


def make_references(scenes: Sequence[str]) -> None:
    """Run the finest meshes and write their curves."""
    known = json.loads(REFERENCES.read_text()) if REFERENCES.is_file() else {}
    for scene in progress(scenes, "scene"):
        curve, *_ = RUNS[scene][0][1](*FINEST[scene], SHARE)
        peak, force = sampled(scene, curve)
        known[scene] = {"peak": peak, "force": [float(f"{x:.7g}") for x in force]}
        REFERENCES.write_text(json.dumps(known, indent=1) + "\n")


def draw(lines: Sequence[Line]) -> Figure:
    """Mean error against processor time, a panel a scene."""
    scenes = list(dict.fromkeys(line.scene for line in lines))
    size = (4.2 * len(scenes), 4)
    figure, axes = plt.subplots(1, len(scenes), figsize=size, layout="constrained", squeeze=False)
    for ax, scene in zip(axes[0], scenes, strict=True):
        mine = [line for line in lines if line.scene == scene]
        for method, degree in dict.fromkeys((line.method, line.degree) for line in mine):
            same = [one for one in mine if (one.method, one.degree) == (method, degree)]
            line = {"vmdg": "-", "penalty law": ":"}.get(method, "--")
            style = ("o", "s")[degree - 1] + line
            color = "C1" if method == "penalty law" else "C0"
            x, y = [one.seconds for one in same], [100 * one.mean for one in same]
            label = f"{method}, degree {degree}"
            ax.loglog(x, y, style, color=color, label=label, mfc="w" if degree == 2 else None)
        ax.set(
            title=scene, xlabel="processor time [s]", ylabel="mean error of the force [% of peak]"
        )
        ax.grid(lw=0.3, which="both")
        ax.legend()
    return figure


def main(
    scene: Annotated[str | None, RUNS] = None,
    coarse: bool = False,
    reference: bool = False,
    out: str = "results/curves",
) -> list[Line]:
    """Run the scenes on all meshes; a line each.

    Args:
        scene: Only this one.
        coarse: The two coarsest meshes only.
        reference: Make the reference curves again.
        out: Folder for the table and the picture.
    """
    scenes = [scene] if scene else list(RUNS)
    if reference:
        make_references(scenes)
    cases = [
        (name, method, *size, run_one)
        for name in scenes
        for method, run_one, sizes in RUNS[name]
        for size in (sizes[:2] if coarse else sizes)
    ]
    lines = [compared(*case) for case in progress(cases, "run")]
    report(out, "curves", markdown(HEAD, [line.cells() for line in lines]), draw(lines))
    return lines


if __name__ == "__main__":
    run(main)
