"""Bodies in motion, free in space: bonds, contact and friction under random velocities."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.random import Generator

import vmdg
from parts.stability.cases import LINEAR, SOLID, E, choose, dimension, log_uniform, random_law
from parts.stability.checks import TURNED, Run
from parts.stability.execution import execute
from parts.stability.scenes import Array, Bond, Case, Cells, Motion, box, distorted, rotation
from parts.stability.units import in_units

#: What a run may change of momentum and its moment, relative, and gain or lose of the energy it had
#: at the start, with some twenty steps.
KEPT, MOMENT, SPENT = 1e-9, 1e-4, 0.02


def motion(rng: Generator) -> Case:
    """Two or three bodies in a row fly apart, together, or past each other.

    They are free, so momentum and moment of momentum stay, and energy, which is kinetic at first,
    but for what the steps miss. In other units every digit is the same, and a motion that was
    turned in space by implicit steps is the same motion.
    """
    kind, _ = choose(rng, {**LINEAR, **SOLID})
    d, bodies = dimension(kind), int(rng.integers(2, 4))
    lengths = rng.uniform(0.5, 1.5, bodies)
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    cells = int(rng.integers(1, 4))
    lines = np.unique(np.concatenate([np.linspace(*p, cells + 1) for p in pairwise(ends)]))
    across = [np.linspace(0, rng.uniform(0.3, 1.0), rng.integers(2, 4)) for _ in range(d - 1)]
    mesh = box(kind, (lines, *across))
    tags = 1 + np.searchsorted(ends[1:-1], mesh.midpoints[:, 0])
    if cells > 1 and rng.random() < 0.5:
        mesh = distorted(mesh, rng, rng.uniform(0.3, 0.8), ends[1:-1])
    small = bool(rng.random() < 0.5)
    moduli = E * 10 ** rng.uniform(0, 1, bodies)
    materials = {
        tag: vmdg.NeoHookean(E=modulus, nu=rng.uniform(0, 0.4))
        for tag, modulus in enumerate(moduli, 1)
    }
    density = {tag: log_uniform(rng, 0.1, 10.0) for tag in materials}
    laws = [_law(rng, float(lengths.mean())) for _ in range(bodies - 1)]
    speed = np.sqrt(moduli.min() / max(density.values()))
    strain = max([1e-3, *(law.strength / E for law in laws)]) * log_uniform(rng, 1, 30)
    size = min(strain, 0.1) * speed
    # Of every body, and of all of it a rate of strain and a spin.
    own, rate = rng.uniform(-size, size, (bodies, d)), rng.uniform(-size, size, (d, d))

    def velocity(x: Array) -> Array:
        body = np.clip(np.searchsorted(ends[1:-1], x[0] - 1e-9), 0, bodies - 1)
        return own[body].T + rate @ x[:d]

    if rng.random() < 0.5:
        scheme = vmdg.CentralDifferences(safety=rng.uniform(0.3, 0.9))
    else:
        scheme = vmdg.GeneralizedAlpha(rng.uniform(0.5, 1.0))
    steps = int(rng.integers(10, 30))
    slowest = np.sqrt(max(density.values()) / moduli.min())
    case = Case(
        "motion",
        f"{bodies} bodies, {[type(law).__name__ for law in laws]}, {scheme}, speed {size:.2g}",
        mesh=mesh,
        tags=tags,
        materials=materials,
        bonds=tuple(Bond(law, (tag, tag + 1)) for tag, law in enumerate(laws, 1)),
        supports=(),
        loads=np.arange(1, steps + 1) / 20 * slowest * lengths.mean() * rng.uniform(0.5, 2.0),
        kinematics="small" if small else "finite",
        motion=Motion(density, velocity, scheme),
    )
    factors = 2.0 ** np.array([rng.integers(-20, 21), rng.integers(-20, 21), rng.integers(-20, 21)])
    axis = rng.normal(size=3) if d == 3 else np.array([0.0, 0.0, 1.0])
    Q = rotation(axis / np.linalg.norm(axis), rng.uniform(0, 2 * np.pi))[:d, :d]

    def judge(run: Run) -> list[str]:
        found = [*kept(run), *same(run, execute(in_units(case, factors)), factors)]
        if isinstance(scheme, vmdg.GeneralizedAlpha):
            found += alike(run, execute(turned(case, Q)), Q)
        return found

    return replace(case, judge=judge)


def _law(rng: Generator, length: float) -> vmdg.Law:
    """A bond, with or without friction, contact, or a tie."""
    which = rng.random()
    if which < 0.2:
        return vmdg.Contact(float(rng.choice([0.0, rng.uniform(0.1, 0.8)])))
    if which < 0.3:
        return vmdg.Bonded()
    law = random_law(rng, E, length)
    secant = hasattr(law, "unloading") and rng.random() < 0.5
    return replace(law, unloading="secant") if secant else law


def momenta(run: Run, v: Array, u: Array) -> tuple[Array, Array, float]:
    """Momentum, its moment, and the sum of the sizes of all parts of the former.

    Args:
        run: The run.
        v: Velocity of its dofs.
        u: Their displacement.
    """
    problem, d = run.problem, run.case.mesh.d
    moving = problem.step.motion
    masses = moving.row_sums if moving.lumped is None else moving.lumped
    P = (moving.of(v) if moving.lumped is None else masses * v).reshape(-1, d)
    x = problem.space.tabulate_dof_coordinates()[:, :d]
    x = x + (0.0 if run.case.kinematics == "small" else u.reshape(-1, d))
    products = np.einsum("ni,nj->ij", x, P)
    return P.sum(axis=0), products - products.T, np.abs(masses * v).sum()


def kept(run: Run) -> list[str]:
    """What is wrong with momentum, its moment, and the energies."""
    problem = run.problem
    start = run.case.motion.velocity(problem.space.tabulate_dof_coordinates().T).T.ravel()
    P0, L0, size = momenta(run, start, 0 * start)
    P1, L1, _ = momenta(run, problem.velocity.x.array, problem.u.x.array)
    found = []
    if not (off := np.abs(P1 - P0).max() / size) < KEPT:
        found.append(f"momentum is off by {off:.1e}")
    if not (off := np.abs(L1 - L0).max() / (size * run.reach)) < MOMENT:
        found.append(f"the moment of momentum is off by {off:.1e}")
    first = run.records[1].energy.external
    lost = np.array([record.energy.imbalance for record in run.records[1:]]) / first
    if not np.abs(lost).max() < SPENT:
        found.append(f"energy grows by {-lost.min():.1e}, falls by {lost.max():.1e}")
    return found


def same(run: Run, other: Run, factors: Array) -> list[str]:
    """What differs in a run in units of ``factors``."""
    work = [(len(each.records), each.residuals, len(each.failures)) for each in (run, other)]
    if work[0] != work[1]:
        return [f"rows, residuals, cuts: {work[0]}, in other units {work[1]}"]
    for mine, theirs in zip(run.records, other.records, strict=True):
        if not np.array_equal(mine.u * factors[0], theirs.u):
            off = np.abs(mine.u - theirs.u / factors[0]).max() / np.abs(mine.u).max()
            return [f"in other units the row at {mine.t:.6g} differs by {off:.1e}"]
    return []


def turned(case: Case, Q: Array) -> Case:
    """The case turned in space by Q."""
    d, mesh, motion = case.mesh.d, case.mesh, case.motion

    def velocity(x: Array) -> Array:
        return Q @ motion.velocity(Q.T @ x[:d])

    return replace(
        case,
        mesh=Cells(mesh.kind, mesh.nodes @ Q.T, mesh.cells, mesh.lines),
        motion=replace(motion, velocity=velocity),
    )


def alike(run: Run, other: Run, Q: Array) -> list[str]:
    """What differs in a run that was turned by Q."""
    d = run.case.mesh.d
    for mine, theirs in zip(run.records, other.records, strict=True):
        moved = mine.u.reshape(-1, d) @ Q.T
        off = np.abs(moved - theirs.u.reshape(-1, d)).max() / max(np.abs(mine.u).max(), 1e-300)
        if not off < TURNED:
            return [f"turned in space, the row at {mine.t:.6g} differs by {off:.1e}"]
    return []
