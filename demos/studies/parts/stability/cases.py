"""Random cases, family by family. A case depends on its number only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.random import Generator
from parts.stability.scenes import (
    Affine,
    Array,
    Bond,
    Case,
    Cells,
    Path,
    Support,
    box,
    distorted,
    legs,
    rotation,
)
from scipy.optimize import brentq

import vmdg

#: Young's modulus of the softest body [MPa].
E = 1000.0

#: Cells and degrees: few, since every one has kernels of its own; the weights favour cheap ones.
TIED = {
    ("triangle", 1): 4,
    ("quadrilateral", 1): 4,
    ("triangle", 2): 2,
    ("quadrilateral", 2): 2,
    ("tetrahedron", 1): 1,
    ("hexahedron", 1): 1,
}
FAILING = {**TIED, ("tetrahedron", 2): 0.7, ("hexahedron", 2): 0.3}
PLANE = {kind: weight for kind, weight in TIED.items() if kind[0] in ("triangle", "quadrilateral")}
LINEAR = {("triangle", 1): 1, ("quadrilateral", 1): 1}
SOLID = {("tetrahedron", 1): 1, ("hexahedron", 1): 1}

Kinds = dict[tuple[str, int], float]


def choose(rng: Generator, kinds: Kinds) -> tuple[str, int]:
    weights = np.array(list(kinds.values()), dtype=float)
    return list(kinds)[rng.choice(len(kinds), p=weights / weights.sum())]


def log_uniform(rng: Generator, low: float, high: float) -> float:
    return float(10 ** rng.uniform(np.log10(low), np.log10(high)))


def dimension(kind: str) -> int:
    return 2 if kind in ("triangle", "quadrilateral") else 3


def block_pair(
    kind: str, rng: Generator, size: Array, counts: tuple[int, int, int] = (2, 2, 1)
) -> tuple[Cells, Array]:
    """Two blocks along x that share a plane, and their tags."""
    d = dimension(kind)
    split = size[0] * rng.uniform(0.3, 0.7)
    n = counts[0]
    first = np.concatenate([np.linspace(0, split, n + 1), np.linspace(split, size[0], n + 1)[1:]])
    across = [np.linspace(0, size[a], counts[a] + 1) for a in range(1, d)]
    mesh = box(kind, (first, *across))
    return mesh, np.where(mesh.midpoints[:, 0] < split, 1, 2)


def unit_pair(rng: Generator, kinds: Kinds) -> tuple[int, Cells, Array]:
    """Degree, and two blocks that make a unit square or cube."""
    kind, degree = choose(rng, kinds)
    return degree, *block_pair(kind, rng, np.ones(dimension(kind)))


def split_plane(mesh: Cells, tags: Array) -> float:
    ends = [mesh.nodes[mesh.cells[tags == tag], 0] for tag in (1, 2)]
    return float(ends[0].max())


def random_law(rng: Generator, modulus: float, length: float, any_kind: bool = True) -> vmdg.Law:
    """A law under which a body of this modulus and length softens stably, or nearly."""
    strength = modulus * log_uniform(rng, 1e-3, 3e-2)
    gap = strength * length / modulus * log_uniform(rng, 0.5, 10)
    friction = float(rng.choice([0.0, rng.uniform(0.1, 0.8)]))
    kind = rng.choice(4) if any_kind else 0
    if kind == 1:
        return vmdg.ExponentialDebonding(strength, strength * gap / 2, friction)
    if kind == 2:
        shear = strength * log_uniform(rng, 0.5, 2)
        energies = (strength * gap / 2, strength * gap / 2 * log_uniform(rng, 0.7, 4))
        return vmdg.MixedModeDebonding(strength, shear, *energies, friction)
    if kind == 3:
        return vmdg.IntrinsicExponential(strength, 2 * strength * gap)
    return vmdg.Debonding(strength, gap, friction)


def opening_scale(law: vmdg.Law) -> float:
    """Opening by which a bond is mostly gone [mm]."""
    if isinstance(law, vmdg.Debonding):
        return law.critical_gap
    if isinstance(law, vmdg.MixedModeDebonding):
        return law.in_opening.critical_gap
    return 3 * law.fracture_energy / law.strength


def described(law: vmdg.Law) -> str:
    return f"{type(law).__name__} {law.strength:.2g} MPa, H {law.softening_modulus:.2g}"


# Closed forms


def rollers(mesh: Cells) -> list[Support]:
    """No displacement across the sides along the first axis."""
    return [
        Support(mesh.side(axis, end), 0.0, axis) for axis in range(1, mesh.d) for end in (0, -1)
    ]


def patch(rng: Generator, mesh: Cells, size: float, law: vmdg.Law, nu: float, **options) -> dict:
    """One material in an affine field: exact at all nodes, whatever the cells are.

    The boundary follows u = H.x with |H| = ``size``; det(I + H) stays positive.
    """
    d = mesh.d
    H = rng.uniform(-1, 1, (d, d))
    H *= size / np.linalg.norm(H)
    while np.linalg.det(np.eye(d) + H) < 0.3 or (np.diag(H) < -0.5).any():
        H += 0.1 * np.eye(d)
    sides = [Support(mesh.side(a, e), Affine(H)) for a in range(d) for e in (0, -1)]

    def deviation(problem: vmdg.Problem) -> float:
        X = problem.space.tabulate_dof_coordinates()[:, :d]
        off = problem.u.x.array.reshape(-1, d) - problem.t * X @ H.T
        return float(np.abs(off).max() / np.abs(problem.u.x.array).max())

    tags = options.pop("tags")
    material = options.pop("material", None) or vmdg.NeoHookean(E=E, nu=nu)
    return {
        "mesh": mesh,
        "tags": tags,
        "materials": dict.fromkeys(np.unique(tags).tolist(), material),
        "bonds": (Bond(law, (1, 2)),),
        "supports": tuple(sides),
        "loads": legs(1, max(2, round(size * 10))),
        "exact": deviation,
        **options,
    }


def bar(
    mesh: Cells,
    tags: Array,
    moduli: tuple[float, float],
    nu: float,
    law: vmdg.Law,
    loads: Array,
    kinematics: str = "finite",
) -> dict:
    """Two blocks in confined tension: uniform in each, so exact for any mesh and number of steps.

    t is the displacement of the end. With the uniaxial stress P(s) of the bodies and
    g = zeta_c (1 - T/P_c) the traction T fulfils sum L_i (s_i(T) - 1) + g(T) = t; until T first
    reaches P_c there is no gap. Where the softening branch snaps back, any T on it is right, and
    so is T = 0 from t = zeta_c on.
    """
    materials = {i: vmdg.NeoHookean(E=m, nu=nu) for i, m in enumerate(moduli, 1)}
    split = split_plane(mesh, tags)
    lengths = (split, mesh.size[0] - split)

    def stress(material: vmdg.NeoHookean, e: float) -> float:
        mu, lmbda = material.parameters.values()
        if kinematics == "small":
            return (2 * mu + lmbda) * e
        return mu * e * (2 + e) / (1 + e) + lmbda * e  # mu (s - 1/s) + lambda (s - 1)

    def stretch(material: vmdg.NeoHookean, T: float) -> float:
        if T == 0:
            return 0.0
        stiffness = sum(material.parameters.values()) + material.parameters["mu"]
        bound = 10 * abs(T) / stiffness + 1e-300
        return brentq(lambda e: stress(material, e) - T, max(-0.999, -bound), bound, xtol=1e-300)

    def stretched(T: float) -> float:
        return sum(L * stretch(m, T) for L, m in zip(lengths, materials.values(), strict=True))

    def deviation(problem: vmdg.Problem) -> float:
        mean, t = problem.mean(0), problem.t
        T = float(mean.traction[0])
        off = abs(stretched(T) + mean.gap[0] - t) / abs(t)
        if law.inelastic:
            peak = stretched(law.strength)
            gap = 0.0
            if t > peak:
                left = law.critical_gap * (1 - T / law.strength)
                gap = left if T > 1e-9 * law.strength else max(t, law.critical_gap)
            off = max(off, abs(mean.gap[0] - gap) / max(abs(t), law.critical_gap))
            if t > peak and T < -1e-9 * law.strength:
                off = np.inf
        return float(off)

    return {
        "mesh": mesh,
        "tags": tags,
        "materials": materials,
        "bonds": (Bond(law, (1, 2)),),
        "supports": (
            Support(mesh.side(0, 0), 0.0, 0),
            Support(mesh.side(0, -1), lambda t: t, 0),
            *rollers(mesh),
        ),
        "loads": loads,
        "exact": deviation,
        "kinematics": kinematics,
    }


def bar_loads(law: vmdg.Law, moduli: tuple, size: Array, nu: float, steps: int) -> Array:
    confined = min(moduli) * (1 - nu) / (1 + nu) / (1 - 2 * nu)
    last = 1.2 * (law.critical_gap + law.strength * size[0] / confined)
    return np.linspace(0, last, steps + 1)[1:]


def pulled(
    rng: Generator, mesh: Cells, tags: Array, materials: dict, bonds: tuple[Bond, ...], reach: float
) -> dict:
    """One end held, the other led to random places; opening first."""
    points = reach * rng.uniform(-1, 1, (rng.integers(2, 4), mesh.d))
    points[:, 0] = np.abs(points[:, 0])
    path = Path(np.vstack([np.zeros(mesh.d), points]))
    return {
        "mesh": mesh,
        "tags": tags,
        "materials": materials,
        "bonds": bonds,
        "supports": (
            Support(mesh.side(0, 0), 0.0),
            Support(mesh.side(0, -1), path),
        ),
        "loads": legs(len(points), int(rng.integers(3, 9))),
    }


def two_materials(rng: Generator, contrast: float = 1.0, nu: float | None = None) -> dict:
    """Bodies 1 and 2, either of them the softer."""
    moduli = [E, E * contrast][:: int(rng.choice([1, -1]))]
    ratios = [rng.uniform(0.0, 0.4) if nu is None else nu for _ in moduli]
    bodies = [vmdg.NeoHookean(E=m, nu=n) for m, n in zip(moduli, ratios, strict=True)]
    return dict(enumerate(bodies, 1))


def tied_or_failing(rng: Generator, mesh: Cells, tags: Array) -> tuple[dict, str]:
    """A patch test of a tie, a bar or a random path until a bond breaks, and which bond."""
    nu = rng.uniform(0.0, 0.4)
    scene = rng.choice(3)
    if scene == 0:
        return patch(rng, mesh, rng.uniform(0.01, 0.3), vmdg.Bonded(), nu, tags=tags), ""
    law = random_law(rng, E, 1.0, any_kind=False)
    if scene == 1:
        loads = bar_loads(law, (E, E), mesh.size, nu, int(rng.integers(2, 15)))
        inputs = bar(mesh, tags, (E, E), nu, law, loads)
    else:
        reach = 1.5 * opening_scale(law)
        inputs = pulled(rng, mesh, tags, two_materials(rng), (Bond(law, (1, 2)),), reach)
    return inputs, f", {described(law)}"


# Families


def aspect_ratio(rng: Generator) -> Case:
    """Cells 1e-3 to 1e3 times as long as wide."""
    ratio = log_uniform(rng, 1e-3, 1e3)
    kind, degree = choose(rng, TIED)
    size = np.array([1.0, 1.0 / ratio, 1.0 / ratio])[: dimension(kind)]
    mesh, tags = block_pair(kind, rng, size)
    inputs, what = tied_or_failing(rng, mesh, tags)
    return Case("aspect ratio", f"aspect {ratio:.2g}{what}", degree=degree, **inputs)


def contrast(rng: Generator) -> Case:
    """Moduli 1 to 1e8 apart."""
    ratio = log_uniform(rng, 1, 1e8)
    degree, mesh, tags = unit_pair(rng, FAILING)
    mesh = distorted(mesh, rng, 0.5, np.array([split_plane(mesh, tags)]))
    law = random_law(rng, E, 1.0, any_kind=False)
    what = f"contrast {ratio:.2g}, {described(law)}"
    if rng.random() < 0.5:
        moduli = tuple(float(m) for m in rng.permutation([E, E * ratio]))
        nu = rng.uniform(0, 0.4)
        loads = bar_loads(law, moduli, mesh.size, nu, int(rng.integers(2, 15)))
        inputs = bar(mesh, tags, moduli, nu, law, loads)
    else:
        bond = Bond(law, (1, 2))
        reach = 1.5 * opening_scale(law)
        inputs = pulled(rng, mesh, tags, two_materials(rng, ratio), (bond,), reach)
    return Case("contrast", what, degree=degree, **inputs)


def incompressible(rng: Generator) -> Case:
    """Poisson's ratio 0.4 to 0.4999."""
    nu = 0.5 - log_uniform(rng, 1e-4, 1e-1)
    degree, mesh, tags = unit_pair(rng, FAILING)
    law = random_law(rng, E, 1.0, any_kind=False)
    what = f"nu {nu:.5f}, {described(law)}"
    if rng.random() < 0.5:
        loads = bar_loads(law, (E, 3 * E), mesh.size, nu, int(rng.integers(2, 15)))
        inputs = bar(mesh, tags, (E, 3 * E), nu, law, loads)
    else:
        materials = two_materials(rng, log_uniform(rng, 1, 100), nu)
        reach = 1.5 * opening_scale(law)
        inputs = pulled(rng, mesh, tags, materials, (Bond(law, (1, 2)),), reach)
    return Case("nearly incompressible", what, degree=degree, **inputs)


def distortion(rng: Generator) -> Case:
    """Corners that keep 1e-3 to 0.5 of their Jacobian."""
    left = log_uniform(rng, 1e-3, 0.5)
    kind, degree = choose(rng, TIED)
    mesh, tags = block_pair(kind, rng, np.ones(dimension(kind)), (2, 3, 2))
    mesh = distorted(mesh, rng, left, np.array([split_plane(mesh, tags)]))
    inputs, what = tied_or_failing(rng, mesh, tags)
    return Case("distorted cells", f"least Jacobian {left:.1e}{what}", degree=degree, **inputs)


def inverted(rng: Generator) -> Case:
    left = -log_uniform(rng, 1e-3, 1)
    kind, degree = choose(rng, {**LINEAR, **SOLID})
    mesh, tags = block_pair(kind, rng, np.ones(dimension(kind)), (2, 2, 2))
    if rng.random() < 0.3:
        nodes = mesh.nodes.copy()
        a, b = mesh.cells[rng.integers(len(mesh.cells)), :2]
        nodes[a] = nodes[b]
        mesh = Cells(mesh.kind, nodes, mesh.cells, mesh.lines)
        what = "two nodes of a cell in one place"
    else:
        mesh = distorted(mesh, rng, left, np.array([split_plane(mesh, tags)]))
        what = f"least Jacobian {left:.1e}"
    inputs = patch(rng, mesh, 0.1, vmdg.Bonded(), 0.3, tags=tags)
    inputs |= {"refusal": "is inverted|is degenerate", "must_refuse": True}
    return Case("inverted cells", what, degree=degree, **inputs)


def steep_softening(rng: Generator) -> Case:
    """H from a tenth of r to ten times r: stable, or refused."""
    degree, mesh, tags = unit_pair(rng, TIED)
    nu = rng.uniform(0.0, 0.4)
    # r of such cells is about 10 E / mm.
    H = 10 * E * log_uniform(rng, 0.1, 30)
    strength = E * log_uniform(rng, 1e-3, 3e-2)
    law = vmdg.Debonding(strength, strength / H)
    loads = bar_loads(law, (E, E), mesh.size, nu, int(rng.integers(2, 15)))
    inputs = bar(mesh, tags, (E, E), nu, law, loads)
    return Case("steep softening", described(law), degree=degree, **inputs)


def step_sizes(rng: Generator) -> Case:
    """Steps of 1e-3 to 10 times the critical gap in one run."""
    degree, mesh, tags = unit_pair(rng, FAILING)
    law = random_law(rng, E, 1.0, any_kind=False)
    steps = law.critical_gap * 10 ** rng.uniform(-3, 1, rng.integers(5, 40))
    loads = np.cumsum(steps)
    end = 3 * law.critical_gap + 3 * law.strength / E
    loads = loads[: max(int(np.searchsorted(loads, end)) + 1, 3)]
    kinematics = str(rng.choice(["finite", "small"])) if (mesh.kind, degree) in LINEAR else "finite"
    inputs = bar(mesh, tags, (E, E), 0.3, law, loads, kinematics)
    return Case("step sizes", f"{len(loads)} steps, {described(law)}", degree=degree, **inputs)


def large_strain(rng: Generator) -> Case:
    """|H| up to 1: tied or strong, exact; or an end moved by as much, to any side, and back."""
    kind, degree = choose(rng, FAILING)
    mesh, tags = block_pair(kind, rng, np.ones(dimension(kind)), (2, 2, 1))
    size = rng.uniform(0.5, 1.0)
    strain = f"|H| = {size:.2f}"
    if rng.random() < 0.5:
        law = vmdg.Debonding(1e9, 1e9) if rng.random() < 0.5 or kind[0:2] == "te" else vmdg.Bonded()
        mesh = distorted(mesh, rng, 0.3, np.array([split_plane(mesh, tags)]))
        inputs = patch(rng, mesh, size, law, rng.uniform(0, 0.4), tags=tags)
        return Case("large strain", f"{strain}, patch", degree=degree, **inputs)
    law = random_law(rng, 10 * E, 1.0, any_kind=False)
    inputs = pulled(rng, mesh, tags, two_materials(rng), (Bond(law, (1, 2)),), 1.0)
    angle = rng.uniform(-np.pi, np.pi)
    move = size * rotation(np.array([0.0, 0.0, 1.0]), angle)[: mesh.d, 0]
    strain += f" at {np.degrees(angle):.0f} degrees"
    stretch = Path(np.array([np.zeros(mesh.d), move, np.zeros(mesh.d)]))
    inputs |= {
        "supports": (Support(mesh.side(0, 0), 0.0), Support(mesh.side(0, -1), stretch)),
        "loads": legs(2, int(rng.integers(5, 21))),
    }
    return Case("large strain", f"{strain}, {described(law)}", degree=degree, **inputs)


def weak_bond(rng: Generator) -> Case:
    """Strengths down to 1e-12 of the modulus."""
    degree, mesh, tags = unit_pair(rng, TIED)
    strength = E * log_uniform(rng, 1e-12, 1e-4)
    gap = strength / E * log_uniform(rng, 0.5, 1e3)
    law = vmdg.Debonding(strength, gap, float(rng.choice([0.0, 0.3])))
    what = described(law)
    if rng.random() < 0.5:
        loads = bar_loads(law, (E, E), mesh.size, 0.3, int(rng.integers(2, 15)))
        inputs = bar(mesh, tags, (E, E), 0.3, law, loads)
    else:
        bond = (Bond(law, (1, 2)),)
        inputs = pulled(rng, mesh, tags, two_materials(rng), bond, log_uniform(rng, gap, 0.1))
    return Case("near-zero strength", what, degree=degree, **inputs)


def different_tags(midpoints: Array, tags: Array) -> Array:
    return tags[:, 0] != tags[:, 1]


def grains(rng: Generator, mesh: Cells, count: int) -> Array:
    """Tags of cells by the nearest of random seeds, renumbered without holes."""
    low = np.array([line[0] for line in mesh.lines])
    seeds = low + mesh.size * rng.random((count, mesh.d))
    nearest = np.linalg.norm(mesh.midpoints[:, None] - seeds, axis=2).argmin(axis=1)
    return 1 + np.unique(nearest, return_inverse=True)[1]


def polycrystal(rng: Generator) -> Case:
    """Grains of random stiffness whose boundaries fail: triple points, edges at the surface."""
    kind, degree = choose(rng, {**LINEAR, ("triangle", 2): 1, ("tetrahedron", 1): 1})
    d = dimension(kind)
    n = 8 if d == 2 and degree == 1 else 5 if d == 2 else 3
    mesh = box(kind, tuple(np.linspace(0, 1, n + 1) for _ in range(d)))
    mesh = distorted(mesh, rng, rng.uniform(0.3, 0.8), np.zeros(0))
    count = int(rng.integers(3, 9))
    tags = grains(rng, mesh, count)
    stiffest = log_uniform(rng, 1, 1e6)
    materials = {
        int(tag): vmdg.NeoHookean(E=E * log_uniform(rng, 1, stiffest), nu=rng.uniform(0.1, 0.4))
        for tag in np.unique(tags)
    }
    law = random_law(rng, E, 1.0)
    bond = Bond(law, facets=different_tags)
    inputs = pulled(rng, mesh, tags, materials, (bond,), 2 * opening_scale(law))
    return Case("polycrystal", f"{count} grains, {described(law)}", degree=degree, **inputs)


def crack_tip(rng: Generator) -> Case:
    """An interface that ends inside a body, at one end or at both."""
    kind, degree = choose(rng, TIED)
    d = dimension(kind)
    n = 8 if d == 2 else 4
    mesh = box(kind, tuple(np.linspace(0, 1, (n if a < 2 else 1) + 1) for a in range(d)))
    tags = np.ones(len(mesh.cells), dtype=int)
    low, high = sorted(rng.choice(np.arange(n + 1) / n, 2, replace=False))
    if rng.random() < 0.5:
        low = 0.0
    if high - low == 1.0:
        high = 0.5

    def on_crack(midpoints: Array, tags: Array) -> Array:
        x, y = midpoints[:2]
        return (np.abs(x - 0.5) < 1e-9) & (y > low) & (y < high)

    law = random_law(rng, E, 1.0)
    materials = {1: vmdg.NeoHookean(E=E, nu=rng.uniform(0, 0.4))}
    bond = Bond(law, facets=on_crack)
    inputs = pulled(rng, mesh, tags, materials, (bond,), opening_scale(law))
    return Case(
        "crack tip", f"y from {low:g} to {high:g}, {described(law)}", degree=degree, **inputs
    )


def random_facets(rng: Generator) -> Case:
    """Facets at random: branches, lone facets, cells with several, ends at the surface."""
    kind, degree = choose(rng, {**LINEAR, ("triangle", 2): 1, ("quadrilateral", 2): 1})
    mesh = box(kind, tuple(np.linspace(0, 1, 6) for _ in range(2)))
    mesh = distorted(mesh, rng, rng.uniform(0.3, 0.8), np.zeros(0))
    tags = np.ones(len(mesh.cells), dtype=int)
    share, seed = rng.uniform(0.1, 0.9), int(rng.integers(2**31))

    def chosen(midpoints: Array, tags: Array) -> Array:
        # Independent of the order in which the facets are numbered.
        order = np.lexsort(np.round(midpoints[:2], 9))
        mark = np.zeros(len(order), dtype=bool)
        mark[order] = np.random.default_rng(seed).random(len(order)) < share
        mark[order[0]] = True
        return mark

    law = random_law(rng, E, 1.0)
    materials = {1: vmdg.NeoHookean(E=E, nu=rng.uniform(0, 0.4))}
    bond = Bond(law, facets=chosen)
    inputs = pulled(rng, mesh, tags, materials, (bond,), 1.5 * opening_scale(law))
    return Case(
        "random facets", f"{100 * share:.0f} % of all, {described(law)}", degree=degree, **inputs
    )


def inclined(rng: Generator) -> Case:
    """An interface that meets the surface at any angle, or runs into the held and the led end."""
    kind, degree = choose(rng, PLANE)
    n = 6
    mesh = box(kind, tuple(np.linspace(0, 1, n + 1) for _ in range(2)))
    angle = rng.uniform(-1.3, 1.3)
    centre = np.array([rng.uniform(0.2, 0.8), 0.5])
    side = (mesh.midpoints - centre) @ [np.cos(angle), np.sin(angle)]
    tags = np.where(side < 0, 1, 2)
    mesh = distorted(mesh, rng, 0.4, np.zeros(0))
    law = random_law(rng, E, 1.0)
    materials = two_materials(rng, log_uniform(rng, 1, 1e3))
    bond = (Bond(law, (1, 2)),)
    inputs = pulled(rng, mesh, tags, materials, bond, 1.5 * opening_scale(law))
    what = f"{np.degrees(angle):.0f} degrees, {described(law)}"
    return Case("interface at the boundary", what, degree=degree, **inputs)


def corner_cells(rng: Generator) -> Case:
    """A square inclusion in a corner or inside: cells with two interfaces of different laws."""
    kind, degree = choose(rng, LINEAR)
    n = int(rng.integers(3, 7))
    mesh = box(kind, tuple(np.linspace(0, 1, n + 1) for _ in range(2)))
    low, size = rng.integers(0, n - 1, 2) / n, rng.integers(1, max(n // 2, 2)) / n
    x, y = mesh.midpoints.T
    tags = np.where((x > low[0]) & (x < low[0] + size) & (y > low[1]) & (y < low[1] + size), 2, 1)
    mesh = distorted(mesh, rng, 0.6, np.zeros(0))
    corner = low + size / 2
    first = random_law(rng, E, 1.0)
    second = vmdg.Bonded() if rng.random() < 0.5 else random_law(rng, E, 1.0)

    def upright(midpoints: Array, tags: Array) -> Array:
        off = np.abs(midpoints[:2] - corner[:, None])
        return different_tags(midpoints, tags) & (off[0] > off[1])

    def level(midpoints: Array, tags: Array) -> Array:
        return different_tags(midpoints, tags) & ~upright(midpoints, tags)

    bonds = (Bond(first, facets=upright), Bond(second, facets=level))
    materials = two_materials(rng, log_uniform(rng, 1, 1e3))
    inputs = pulled(rng, mesh, tags, materials, bonds, opening_scale(first))
    what = f"{described(first)} and {type(second).__name__}"
    return Case("two interfaces in a cell", what, degree=degree, **inputs)


def on_demand(rng: Generator) -> Case:
    """Any facet between two cells may open: cracks find their way, in a body or between two."""
    kind, degree = choose(rng, {**LINEAR, ("triangle", 2): 1, ("quadrilateral", 2): 1})
    n = 5 if degree == 1 else 3
    mesh = box(kind, tuple(np.linspace(0, 1, n + 1) for _ in range(2)))
    mesh = distorted(mesh, rng, rng.uniform(0.3, 0.8), np.zeros(0))
    count = int(rng.integers(1, 4))
    tags = grains(rng, mesh, count)
    materials = {
        int(tag): vmdg.NeoHookean(E=E * log_uniform(rng, 1, 100), nu=rng.uniform(0, 0.4))
        for tag in np.unique(tags)
    }
    law = random_law(rng, E, 1.0)
    opens_at = rng.uniform(0.1, 0.9)

    def everywhere(midpoints: Array, tags: Array) -> Array:
        return np.ones(len(tags), dtype=bool)

    bond = Bond(law, facets=everywhere, opens_at=opens_at)
    reach = log_uniform(rng, 0.3, 2) * opening_scale(law)
    inputs = pulled(rng, mesh, tags, materials, (bond,), reach)
    what = f"at {opens_at:.2f}, {count} bodies, {described(law)}"
    return Case("on demand", what, degree=degree, **inputs)


def random_ogden(rng: Generator, modulus: float) -> vmdg.Ogden:
    """Three terms, all convex, of given Young's modulus [MPa]."""
    nu = rng.uniform(0.0, 0.45)
    shares = rng.dirichlet(np.ones(3))
    exponents = rng.uniform([1, 2, -4], [3, 6, -1])
    c = shares * modulus / (1 + nu)
    return vmdg.Ogden(c=c, m=exponents, kappa=modulus / (3 * (1 - 2 * nu)))


def viscous(rng: Generator) -> Case:
    """Overstress of 1e-3 to 1e3 times the softening in a step, then rest, where it is gone."""
    degree, mesh, tags = unit_pair(rng, TIED)
    ratio = log_uniform(rng, 1e-3, 1e3)
    if rng.random() < 0.5:
        law = random_law(rng, E, 1.0, any_kind=False)
        nu = rng.uniform(0.0, 0.4)
        loads = bar_loads(law, (E, E), mesh.size, nu, int(rng.integers(2, 15)))
        law = replace(law, viscosity=ratio * law.softening_modulus * loads[0])
        inputs = bar(mesh, tags, (E, E), nu, law, loads)
    else:
        law = random_law(rng, E, 1.0)
        law = replace(law, viscosity=ratio * law.softening_modulus / 5)
        reach = 1.5 * opening_scale(law)
        inputs = pulled(rng, mesh, tags, two_materials(rng), (Bond(law, (1, 2)),), reach)
    # A step of zero length would last indefinitely.
    inputs["loads"] = np.append(inputs["loads"], inputs["loads"][-1])
    what = f"viscosity {ratio:.2g} H dt, {described(law)}"
    return Case("viscous", what, degree=degree, **inputs)
