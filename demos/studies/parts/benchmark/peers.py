"""Two scenes that were run with other cohesive codes: P1, a cracked plate, and P2, two cubes.

P1: two plates of 1.0 x 0.5 mm, 48 x 24 quadrilaterals each, plane strain, one above the other with
a crack over the first quarter of their interface; bottom clamped, top u_x = 0 and u_y to 0.04 mm.
P2: two unit cubes of 10 x 10 x 10 hexahedra, ends clamped, u_z to 0.06 mm. Both: E = 4000 MPa,
nu = 0.3, small strain, a bond of 20 MPa that softens linearly to a gap of 0.02 mm.

The bonded slope is that of plain finite elements on the same mesh. Peak and forces are those of a
run with ten times as many steps; the work to separation is the energy of the bond, exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import process_time

import numpy as np
from dolfinx.mesh import compute_midpoints
from numpy.typing import NDArray

import vmdg
from parts.benchmark.common import BOTTOM, LOWER, TOP, UPPER, layers
from vmdg.domain.topology import facet_cells, tags_of_cells
from vmdg.solver.result import Counts

STRENGTH, CRITICAL_GAP = 20.0, 0.02  # MPa, mm


@dataclass(frozen=True)
class Scene:
    """One of the two problems.

    Attributes:
        name: "P1" or "P2".
        cell: Of the mesh.
        divisions: Cells in every direction, both bodies together.
        sizes: [mm].
        crack: Length of the first direction that is cracked already [mm].
        end: Last displacement of the top [mm].
        slope: Bonded, on this mesh [N/mm].
        peak: Largest force [N].
    """

    name: str
    cell: str
    divisions: tuple[int, ...]
    sizes: tuple[float, ...]
    crack: float
    end: float
    slope: float
    peak: float

    @property
    def area(self) -> float:
        """Of the bond [mm2; mm in plane strain]."""
        return (self.sizes[0] - self.crack) * float(np.prod(self.sizes[1:-1]))

    @property
    def work(self) -> float:
        """Energy of the bond [N mm]."""
        return self.area * STRENGTH * CRITICAL_GAP / 2


P1 = Scene("P1", "quadrilateral", (48, 48), (1.0, 1.0), 0.25, 0.04, 3935.065, 14.283)
P2 = Scene("P2", "hexahedron", (10, 10, 20), (1.0, 1.0, 2.0), 0.0, 0.06, 2067.547, 19.753)


def build(
    scene: Scene, law: vmdg.Law, kinematics: str = "small", **options
) -> tuple[vmdg.Problem, NDArray[np.int32]]:
    """The problem, its load factor the displacement of the top [mm], and the facets of the top.

    Args:
        scene: P1 or P2.
        law: Of the bond.
        kinematics: "small" or "finite".
        options: Of the interface.
    """
    below = scene.divisions[-1] // 2
    mesh, cell_tags, facet_tags = layers(scene.cell, scene.divisions, scene.sizes, below)
    d, pairs = mesh.geometry.dim, facet_cells(mesh)
    tags = tags_of_cells(mesh, cell_tags)
    between = np.flatnonzero((pairs >= 0).all(axis=1) & (tags[pairs].sum(axis=1) == LOWER + UPPER))
    between = between.astype(np.int32)
    cracked = compute_midpoints(mesh, d - 1, between)[:, 0] < scene.crack
    interfaces = [vmdg.Interface(facets=between[~cracked], law=law, **options)]
    if scene.crack > 0:
        interfaces.append(vmdg.Interface(facets=between[cracked], law=vmdg.Contact()))
    body = vmdg.NeoHookean(E=4000.0, nu=0.3)
    problem = vmdg.Problem(
        mesh, cell_tags, {LOWER: body, UPPER: body}, interfaces, kinematics=kinematics
    )
    top = facet_tags.find(TOP)
    problem.dirichlet(facet_tags.find(BOTTOM), 0.0)
    problem.dirichlet(top, lambda t: (0.0,) * (d - 1) + (t,))
    return problem, top


def loads(scene: Scene, steps: int) -> NDArray[np.float64]:
    """Load factors that look closely at the top of the curve, and at the end of the bond.

    No force is larger than the strength times the bonded area, which an undamaged body would carry
    at some displacement D. One step to D/100 gives the slope; most of the others lie evenly between
    D/2 and 5 D/4, where the force is largest, the others up to one and a half critical gaps. The
    last one goes to the end.

    Args:
        scene: P1 or P2.
        steps: How many.
    """
    D = STRENGTH * scene.area / scene.slope
    near = np.linspace(D / 2, 1.25 * D, steps * 5 // 8)
    after = np.linspace(near[-1], 1.5 * CRITICAL_GAP, steps - 1 - len(near))[1:]
    return np.concatenate([[D / 100], near, after, [scene.end]])


@dataclass(frozen=True)
class Run:
    """What a run gave.

    Attributes:
        scene: P1 or P2.
        history: With "force" [N] and the energies.
        seconds: Processor time of the load steps [s].
        counts: Work done in them.
        size: Number of unknowns.
    """

    scene: Scene
    history: vmdg.History
    seconds: float
    counts: Counts
    size: int

    @property
    def slope_error(self) -> float:
        """Of the first step, relative to plain finite elements."""
        first = self.history["force"][0] / self.history["load"][0]
        return float(first / self.scene.slope - 1)

    @property
    def peak_error(self) -> float:
        """Relative."""
        return float(self.history["force"].max() / self.scene.peak - 1)

    @property
    def work_error(self) -> float:
        """Of the area under the force, by the trapezoidal rule, to separation; relative."""
        return float(self.history["external"][-1] / self.scene.work - 1)

    @property
    def imbalance(self) -> float:
        """Largest share of the work that the energies of a step do not account for."""
        return float(np.abs(self.history["imbalance"]).max() / self.scene.work)


def run(
    scene: Scene,
    steps: int = 40,
    even: bool = False,
    kinematics: str = "small",
    repeats: int = 1,
) -> Run:
    """Run a scene, several times for its least processor time.

    Args:
        scene: P1 or P2.
        steps: Load steps.
        even: Of equal size, as the peers were given.
        kinematics: "small" or "finite".
        repeats: How often.
    """
    law = vmdg.Debonding(strength=STRENGTH, critical_gap=CRITICAL_GAP)
    least = np.inf
    for _ in range(repeats):
        problem, top = build(scene, law, kinematics)
        problem.discretization.compile()
        even_loads = np.linspace(0, scene.end, steps + 1)[1:]
        path = even_loads if even else loads(scene, steps)
        start = process_time()
        result = vmdg.solve(
            problem,
            path,
            vmdg.SolveOptions(energy=True),
            lambda problem, top=top: {"force": problem.reaction(top)[-1]},
        )
        least = min(least, process_time() - start)
    size = problem.space.dofmap.index_map.size_global * problem.mesh.geometry.dim
    return Run(scene, result.history, least, result.counts, size)


HEAD = (
    "scene",
    "steps",
    "unknowns",
    "s",
    "solves",
    "factorized",
    "Krylov",
    "residuals",
    "tangents",
    "corrections a step",
    "slope error",
    "peak [N]",
    "peak error",
    "work error",
    "imbalance",
)


def row(name: str, run: Run) -> list[str | int | float]:
    """Of the table below ``HEAD``."""
    counts, history = run.counts, run.history
    return [
        name,
        len(history),
        run.size,
        run.seconds,
        counts.solves,
        counts.factorizations + counts.preconditioners,
        counts.krylov,
        counts.residuals,
        counts.tangents,
        history["iterations"].mean(),
        f"{run.slope_error:.1e}",
        history["force"].max(),
        f"{100 * run.peak_error:.2f} %",
        f"{100 * run.work_error:.2f} %",
        f"{run.imbalance:.1e}",
    ]


def sliding_shear(friction: float = 0.3, pressure: float = 10.0) -> tuple[float, float]:
    """Shear [MPa] of two squares that slide without a bond under pressure, and mu N.

    The lower square is clamped at its bottom; the top of the upper one is pressed down, then moved
    sideways.

    Args:
        friction: mu.
        pressure: About [MPa].
    """
    mesh, cell_tags, facet_tags = layers("quadrilateral", (8, 16), (1.0, 2.0), 8)
    body = vmdg.NeoHookean(E=4000.0, nu=0.0)
    interface = vmdg.Interface(between=(LOWER, UPPER), law=vmdg.Contact(friction=friction))
    problem = vmdg.Problem(
        mesh, cell_tags, {LOWER: body, UPPER: body}, [interface], kinematics="small"
    )
    down, top = 2 * pressure / 4000.0, facet_tags.find(TOP)
    problem.dirichlet(facet_tags.find(BOTTOM), 0.0)
    problem.dirichlet(top, lambda t: (0.05 * max(t - 1, 0.0), -down * min(t, 1.0)))
    vmdg.solve(problem, [1.0, 1.5, 2.0])
    shear, normal = problem.reaction(top)
    return float(shear), float(-friction * normal)
