"""Films that peel by their mismatch, and pieces that shrink until they are loose."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

import vmdg
from parts.stability.cases import LINEAR, PLANE, SOLID, E, choose, described, dimension, log_uniform
from parts.stability.checks import Run
from parts.stability.scenes import Array, Bond, Case, Support, box

#: Error of the strain at which a film has a slip, and of the slip relative to the critical gap,
#: with some ten cells in the process zone.
STRAIN, SLIP = 0.03, 0.01


def films(rng: Generator) -> Case:
    """A thin film with a free end shrinks on a rigid substrate and peels from the end.

    With E h u'' = T, T = P_c (1 - u/z) in the process zone, k^2 = P_c/(z E h) and a strain e
    (shear lag): below e_c = k z the slip at the end is z (1 - sqrt(1 - (e/e_c)^2)), at e_c the
    zone comes loose (e_c^2 E h/2 = P_c z/2 is Griffith's criterion), beyond it the film holds to a
    length b from the middle with sin k b = e_c/e.
    """
    kind, degree = choose(rng, PLANE)
    h, cells = log_uniform(rng, 1e-3, 1e-2), int(rng.integers(20, 41))
    strength = E * log_uniform(rng, 1e-4, 1e-3)
    length = 1.0
    k = rng.uniform(2.0, 4.0)
    z = strength / (k * k * E * h)
    free = rng.choice([0.0, 0.1])
    nodes = np.append(np.linspace(0, length, cells + 1), length + free * np.array([0.5, 1.0]))
    nodes = nodes if free else nodes[: cells + 1]
    mesh = box(kind, (nodes, np.array([-1.0, 0.0, h])))
    tags = np.where(mesh.midpoints[:, 1] < 0, 1, 2)
    law = vmdg.Debonding(strength, z, unloading=str(rng.choice(["plastic", "secant"])))
    critical = k * z
    loads = np.append(rng.uniform(0.3, 0.9, 2), rng.uniform(1.1, 2.0, 2))
    loads = np.sort(loads)

    def slip(x: Array, t: float) -> Array:
        if t < 1:
            zone = np.arcsin(t) / k
            return z * (1 - np.cos(k * np.clip(x - length + zone, 0, None)))
        b = np.arcsin(1 / t) / k
        inside = z * (1 - np.cos(k * x) + np.sin(k * x) / np.tan(k * b))
        return np.where(x < b, inside, z + t * critical * (x - b))

    def judge(run: Run) -> list[str]:
        found, t = [], [record.t for record in run.records]
        x = run.problem.state[0].points[:, 0]
        bonded = x < length
        for load in loads[loads <= t[-1]]:
            gap = np.abs(run.records[t.index(load)].gap[0][:, 0])[bonded]
            low, high = (slip(x[bonded], load * (1 + sign * STRAIN)) for sign in (-1, 1))
            off = max((low - gap).max(), (gap - high).max()) / z / max(load, 1)
            if not off < SLIP:
                found.append(f"the slip at t = {load:.4g} is off by {off:.1e} z")
        return found[:1]

    def shrinks(t: float) -> Array:
        return -t * critical * np.diag([1.0, 0.0, 0.0])

    inputs = {
        "mesh": mesh,
        "tags": tags,
        "materials": {1: vmdg.NeoHookean(E=1e6 * E, nu=0.0), 2: vmdg.NeoHookean(E=E, nu=0.0)},
        "bonds": (Bond(law, (1, 2), initial_damage=lambda x: 1.0 * (x[0] > length)),),
        "supports": (
            Support(mesh.side(0, 0), 0.0, 0),
            Support(mesh.side(1, 0), 0.0),
            Support(mesh.side(1, -1), 0.0, 1),
        ),
        "loads": loads,
        "kinematics": "small",
        "eigenstrain": {2: shrinks},
        "judge": judge,
    }
    what = f"{cells} cells, 1/k = {1 / k:.2f}, free end {free}, {described(law)}"
    return Case("films", what, degree=degree, **inputs)


def loose(rng: Generator) -> Case:
    """A piece shrinks in a hole of a frame until all of its bonds are gone: free of stress."""
    kind, degree = choose(rng, {**LINEAR, ("triangle", 2): 0.5, **SOLID})
    d = dimension(kind)
    low, high = np.sort(rng.uniform([0.1, 0.6], [0.4, 0.9], (d, 2)), axis=1).T
    inner = int(rng.integers(1, 3)) + (d == 2)
    mesh = box(
        kind,
        tuple(np.r_[0, np.linspace(a, b, inner + 1), 1] for a, b in zip(low, high, strict=True)),
    )
    inside = ((mesh.midpoints > low) & (mesh.midpoints < high)).all(axis=1)
    tags = np.where(inside, 2, 1)
    small = bool(rng.random() < 0.5)
    strength = E * log_uniform(rng, 1e-4, 1e-3)
    gap = strength / E * log_uniform(rng, 0.3, 3)
    law = vmdg.Debonding(strength, gap, unloading=str(rng.choice(["plastic", "secant"])))
    most = 50 * (gap + strength / E)
    moves = rng.uniform(-1, 1, d) * (0.0 if rng.random() < 0.5 else 0.1)
    steps = int(rng.integers(3, 9))

    def judge(run: Run) -> list[str]:
        """The piece has its own size, whatever became of its place."""
        problem, record = run.problem, run.records[-1]
        if run.stopped:
            return []
        gone = record.softening[0] == law.strength
        found = [f"{(~gone).sum()} of {len(gone)} points hold"] * (not (~gone).sum() <= 1)
        original = problem.mesh.topology.original_cell_index
        cells = np.flatnonzero(tags[original] == 2)
        dofs = np.unique(problem.space.dofmap.list[cells])
        X = problem.space.tabulate_dof_coordinates()[dofs][:, :d]
        u = problem.u.x.array.reshape(-1, d)[dofs]
        X, x = X - X.mean(axis=0), X + u - (X + u).mean(axis=0)
        F = np.linalg.lstsq(X, x, rcond=None)[0].T
        size = F.T @ F if not small else F + F.T - np.eye(d)
        free = (1 - most) ** 2 if not small else 1 - 2 * most
        off = max(np.abs(size - free * np.eye(d)).max(), np.abs(x - X @ F.T).max()) / most
        return found + [f"the piece is off its own size by {off:.1e}"] * (not off < 1e-4)

    frame = tuple(
        Support(mesh.side(axis, end), lambda t: t * moves) for axis in range(d) for end in (0, -1)
    )
    inputs = {
        "mesh": mesh,
        "tags": tags,
        "materials": {
            1: vmdg.NeoHookean(E=E, nu=0.3),
            2: vmdg.NeoHookean(E=E, nu=rng.uniform(0, 0.4)),
        },
        "bonds": (Bond(law, (1, 2)),),
        "supports": frame,
        "loads": np.arange(1, steps + 1) / steps,
        "kinematics": "small" if small else "finite",
        "eigenstrain": {2: lambda t: -most * t * np.diag([1.0, 1.0, d - 2.0])},
        "judge": judge,
    }
    what = (
        f"{steps} steps to {most:.2g}, frame {'moves' if moves.any() else 'held'}, {described(law)}"
    )
    return Case("loose pieces", what, degree=degree, **inputs)
