"""Error against seconds and unknowns: vmdg, plain finite elements, intrinsic cohesive springs.

The kinked finite-strain solution of ``parts.convergence.manufactured``, moduli 10 : 1, two bodies
tied along an upright interface. All three solve the same problem on the same meshes, with the same
quadrature, compiler flags and direct solver, in one step from rest. The springs tie the broken
space by T = K g as an intrinsic cohesive law does before damage; K is fixed, as it would be given.
From the interpolated exact solution, where one or two corrections are left, plain finite elements
and vmdg show what a step costs in addition to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import product
from time import process_time

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from parts.benchmark.common import DIMENSION
from parts.benchmark.continuous import Plain
from parts.convergence.rates import Study, field_errors, interpolate, tied

import vmdg
from vmdg.linear.ksp import LDLT

#: Stiffness of the springs [MPa/mm]: 250 soft moduli a mm, as the public one-fibre deck has a dummy
#: stiffness of 1e6 N/mm3 with a matrix of 4000 MPa.
SPRINGS = 2.5e5
CONTRAST, TOLERANCE = 10.0, 1e-9
METHODS = ("plain", "vmdg", "springs")

#: Cells along each mm, by dimension and degree.
LEVELS = {
    (2, 1): (8, 16, 32, 64),
    (2, 2): (4, 8, 16, 32),
    (3, 1): (4, 7, 12),
    (3, 2): (2, 4, 6),
}
COARSE = {(2, 1): (8,), (2, 2): (4,), (3, 1): (4,), (3, 2): (2,)}


@dataclass(frozen=True)
class Point:
    """One solution."""

    cell: str  # Of the mesh
    degree: int  # k
    method: str  # One of ``METHODS``
    n: int  # Cells along each mm
    size: int  # Number of unknowns
    l2: float  # Relative error of u in L2
    h1: float  # Of GRAD u
    seconds: float  # Processor time of the solution from rest [s]
    near: float  # The same from the interpolated exact solution [s]
    solves: int  # Linear systems; with vmdg the predictor is one of them


def measure(cell: str, degree: int, n: int, repeats: int) -> list[Point]:
    """The three methods on one mesh, taking turns; the least of some runs."""
    study = Study(cell, degree, contrast=CONTRAST)
    model = tied(study, n)
    materials = dict(enumerate(study.materials, start=1))
    plains = {
        name: Plain(model.tagged, materials, degree, K, model.forces)
        for name, K in (("plain", None), ("springs", SPRINGS))
    }
    exact = {"vmdg": model.problem.u.x.array.copy()}
    for name, plain in plains.items():
        interpolate(plain.u, model.tagged, model.exact)
        plain.prescribe(model.sides)
        exact[name] = plain.u.x.array.copy()
    model.problem.discretization.compile()
    options = vmdg.SolveOptions(relative_tolerance=TOLERANCE, petsc=LDLT)
    seconds, solves = np.full((2, len(METHODS)), np.inf), {}
    for _ in range(repeats):
        for (start, share), (i, name) in product(enumerate((1.0, 0.0)), enumerate(METHODS)):
            plain = plains.get(name)
            u = model.problem.u if plain is None else plain.u
            u.x.array[:] = share * exact[name]
            begin = process_time()
            if plain is None:
                model.problem.loading.move(0.0)
                solves[name] = vmdg.solve(model.problem, [1.0], options).counts.solves
            else:
                plain.solve(LDLT, TOLERANCE, exact[name][plain.prescribed])
                solves[name] = plain.iterations
            seconds[start, i] = min(seconds[start, i], process_time() - begin)
    points = []
    for (near, rest), name in zip(seconds.T, METHODS, strict=True):
        u = plains[name].u if name in plains else model.problem.u
        size = u.function_space.dofmap.index_map.size_global * DIMENSION[cell]
        found = field_errors(u, model.tagged, model.exact)
        points.append(Point(cell, degree, name, n, size, *found, rest, near, solves[name]))
    return points


def rows(points: Sequence[Point]) -> list[list]:
    """One row a mesh: vmdg and springs relative to plain finite elements."""
    result = []
    for plain in (p for p in points if p.method == "plain"):
        same = {p.method: p for p in points if (p.cell, p.degree, p.n) == key(plain)}
        ours, springs = same["vmdg"], same["springs"]
        result.append(
            [
                plain.cell,
                plain.degree,
                plain.n,
                f"{plain.size} / {ours.size}",
                plain.h1,
                f"{ours.l2 / plain.l2:.3f}",
                f"{ours.h1 / plain.h1:.3f}",
                f"{springs.l2 / plain.l2:.2f}",
                f"{springs.h1 / plain.h1:.2f}",
                f"{plain.solves} / {ours.solves}",
                f"{plain.seconds:.3g} / {ours.seconds:.3g}",
                f"{ours.seconds / plain.seconds:.2f}",
                f"{ours.near / plain.near:.2f}",
            ]
        )
    return result


HEAD = (
    "cell",
    "k",
    "cells/mm",
    "unknowns",
    "GRAD u error",
    "vmdg: u",
    "GRAD u",
    "springs: u",
    "GRAD u",
    "solves",
    "s",
    "ratio",
    "from the solution",
)


def key(point: Point) -> tuple[str, int, int]:
    return point.cell, point.degree, point.n


def records(points: Sequence[Point]) -> list[dict]:
    return [asdict(point) for point in points]


def plot(points: Sequence[Point]) -> Figure:
    """Error of u in L2 against unknowns (above) and processor time (below), by cell."""
    cells = list(dict.fromkeys(point.cell for point in points))
    figure, axes = plt.subplots(
        2, len(cells), figsize=(2.7 * len(cells), 6), layout="constrained", squeeze=False
    )
    styles = {"plain": "k-", "vmdg": "C0--", "springs": "C1:"}
    names = {
        "plain": "plain finite elements",
        "vmdg": "vmdg, tied",
        "springs": "intrinsic cohesive springs",
    }
    for column, cell in zip(axes.T, cells, strict=True):
        for method in METHODS:
            for degree, marker in ((1, "o"), (2, "s")):
                mine = [p for p in points if (p.cell, p.degree, p.method) == (cell, degree, method)]
                errors = [p.l2 for p in mine]
                for ax, x in zip(column, ("size", "seconds"), strict=True):
                    ax.loglog(
                        [getattr(p, x) for p in mine],
                        errors,
                        styles[method] + marker,
                        ms=4,
                        label=f"{names[method]}, degree {degree}",
                    )
        column[0].set(title=cell, xlabel="unknowns")
        column[1].set(xlabel="processor time [s]")
        for ax in column:
            ax.grid(lw=0.3)
            ax.xaxis.set_minor_formatter("")
    for ax in axes[:, 0]:
        ax.set_ylabel("error of u in L2")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure
