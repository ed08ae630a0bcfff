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
from parts.benchmark.common import BOTTOM, LOWER, TOP, UPPER, layers
from parts.topology import facet_cells, tags_of_cells

import vmdg

STRENGTH, CRITICAL_GAP = 20.0, 0.02  # MPa, mm


@dataclass(frozen=True)
class Scene:
    """One of the two problems."""

    name: str  # "P1" or "P2"
    cell: str  # Of the mesh
    divisions: tuple[int, ...]  # Cells in every direction, both bodies together
    sizes: tuple[float, ...]  # [mm]
    crack: float  # Length of the first direction that is cracked already [mm]
    end: float  # Last displacement of the top [mm]
    slope: float  # Bonded, on this mesh [N/mm]
    peak: float  # Largest force [N]

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
    """The problem, its load factor the displacement of the top [mm], and the facets of the top."""
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
    """
    D = STRENGTH * scene.area / scene.slope
    near = np.linspace(D / 2, 1.25 * D, steps * 5 // 8)
    after = np.linspace(near[-1], 1.5 * CRITICAL_GAP, steps - 1 - len(near))[1:]
    return np.concatenate([[D / 100], near, after, [scene.end]])


def run(
    scene: Scene,
    steps: int = 40,
    even: bool = False,
    kinematics: str = "small",
    repeats: int = 1,
) -> tuple[vmdg.Result, float]:
    """Run a scene, several times; the result, with "force" [N], and the least processor time [s].

    Args:
        even: Of equal size, as the peers were given.
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
    return result, least
