"""Random cases of bodies whose meshes do not match: tied or bonded, and sliding over many facets.

Tied and bonded ones are drawn from other families, whose closed forms know no mesh; one of the two
bodies gets cells of its own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.random import Generator

import vmdg
from parts.stability import cases
from parts.stability.cases import E, Kinds, choose, dimension, legs, log_uniform, split_plane
from parts.stability.checks import Run
from parts.stability.scenes import Array, Bond, Case, Cells, Path, Support, box

#: Families of two blocks along the first axis.
BLOCKS = (
    cases.aspect_ratio,
    cases.contrast,
    cases.incompressible,
    cases.step_sizes,
    cases.load_cycles,
    cases.large_rotation,
    cases.large_strain,
)

SLIDING: Kinds = {
    ("triangle", 1): 3,
    ("quadrilateral", 1): 3,
    ("triangle", 2): 1,
    ("tetrahedron", 1): 1,
    ("hexahedron", 1): 1,
}

#: Way after a reversal from which all points slide [mm], and deviation of the friction from
#: mu N, and change of N, on a base that is nearly rigid, relative to N.
SLIDES, FRICTION, CONSTANT = 0.15, 2e-3, 2e-3


def joined(first: Cells, second: Cells) -> Cells:
    """Both, without common nodes."""
    lines = zip(first.lines, second.lines, strict=True)
    return Cells(
        first.kind,
        np.concatenate([first.nodes, second.nodes]),
        np.concatenate([first.cells, second.cells + len(first.nodes)]),
        tuple(np.unique(np.concatenate(pair)) for pair in lines),
    )


def bonded(rng: Generator) -> Case:
    """Two blocks, body 2 with another number of cells along the interface."""
    case = BLOCKS[rng.integers(len(BLOCKS))](rng)
    x, *across = case.mesh.lines
    split = split_plane(case.mesh, case.tags)
    count = len(across[0]) - 1
    other = int(rng.choice([n for n in range(1, 6) if n != count]))
    finer = [np.linspace(line[0], line[-1], other + 1) for line in across]
    kind, near = case.mesh.kind, np.isclose(x, split)
    low = box(kind, (np.append(x[(x < split) & ~near], split), *across))
    high = box(kind, (np.append(split, x[(x > split) & ~near]), *finer))
    tags = np.repeat([1, 2], [len(low.cells), len(high.cells)])
    what = f"{case.family}, facets {count}:{other}, {case.what}"
    return replace(
        case, family="meshes that do not match", what=what, mesh=joined(low, high), tags=tags
    )


def sliding(rng: Generator) -> Case:
    """A block is pressed on a longer, harder one and slides along it and back."""
    kind, degree = choose(rng, SLIDING)
    d = dimension(kind)
    cells, base = int(rng.integers(2, 6)), int(rng.integers(8, 24 if d == 2 else 12))
    height, start = rng.uniform(0.4, 1.0), rng.uniform(0.7, 1.5)
    wide = [[np.linspace(0.2, 1.2, cells)], [np.linspace(0.0, 1.4, 4)]] if d == 3 else [[], []]
    top = (np.linspace(start, start + 1.0, cells + 1), *wide[0], np.linspace(0.0, height, 3))
    floor = (np.linspace(0.0, 4.0, base + 1), *wide[1], np.linspace(-0.6, 0.0, 3))
    blocks = box(kind, top), box(kind, floor)
    mesh, tags = joined(*blocks), np.repeat([1, 2], [len(one.cells) for one in blocks])
    mu = float(rng.choice([0.0, rng.uniform(0.05, 0.5)]))
    hard = E * log_uniform(rng, 1e3, 1e5)
    nu = rng.uniform(0.0, 0.4, 2)
    down = height * rng.uniform(0.005, 0.03)
    ways = np.cumsum([0.0, rng.uniform(0.5, 1.3), -rng.uniform(0.5, 1.5)])
    points = np.zeros((4, d))
    points[1:, -1], points[1:, 0] = -down, ways
    steps = int(rng.integers(4, 12))

    def judge(run: Run) -> list[str]:
        return _friction(run, mesh, mu, points[:, 0])

    return Case(
        "sliding",
        f"mu {mu:.2f}, moduli 1:{hard / E:.0f}, {cells} on {base} facets, {steps} steps a way",
        mesh,
        tags,
        {1: vmdg.NeoHookean(E=E, nu=nu[0]), 2: vmdg.NeoHookean(E=hard, nu=nu[1])},
        (Bond(vmdg.Contact(friction=mu), (1, 2), slides=True),),
        (Support(mesh.side(d - 1, 0), 0.0), Support(mesh.side(d - 1, -1), Path(points))),
        legs(3, steps),
        degree=degree,
        judge=judge,
    )


def _friction(run: Run, mesh: Cells, mu: float, ways: Array) -> list[str]:
    """N is constant on a way and F = mu N against it, wherever the block slides as a whole.

    On the way back a block of triangles is no mirror image of that on the way there.
    """
    x = run.problem.space.tabulate_dof_coordinates().T
    above = mesh.side(mesh.d - 1, -1)(x)
    found, pressures = [], {leg: [] for leg in range(1, len(ways) - 1)}
    for record in run.records:
        leg = int(np.ceil(record.t)) - 1
        if leg < 1:
            continue
        way = (record.t - leg) * (ways[leg + 1] - ways[leg])
        if abs(way) < SLIDES:
            continue
        force = record.forces.reshape(-1, mesh.d)[above].sum(axis=0)
        N, F = -force[-1], force[0] * np.sign(way)
        pressures[leg].append(N)
        if abs(F - mu * N) > FRICTION * N:
            found.append(f"F = {F / N:.5f} N at t = {record.t:.4g}, mu {mu:.5f}")
    for values in filter(None, pressures.values()):
        if np.ptp(values) > CONSTANT * np.mean(values):
            found.append(f"N changes by {np.ptp(values) / np.mean(values):.1e}")
    return found[:2]
