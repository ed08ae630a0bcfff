"""Programmes that turn, hold and change direction, judged row by row by points by hand.

Bars in confined tension and periodic laminates are uniform, whatever their cells are, so that every
interface point is one :class:`~parts.stability.points.Point` between springs, and a row follows
from the row before by one implicit step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.random import Generator

import vmdg
from parts.stability.cases import (
    FAILING,
    LINEAR,
    PLANE,
    TIED,
    E,
    Kinds,
    block_pair,
    choose,
    described,
    dimension,
    log_uniform,
    rollers,
)
from parts.stability.checks import EXACT, Run
from parts.stability.points import Point, rate_bounds
from parts.stability.scenes import Array, Bond, Case, Path, Support, box

Way = Callable[[float], float]

#: Steps by which the rows of a bond whose strength depends on the rate may be late, and the error
#: of their traction relative to the largest one.
LATE, RATE = 4, 0.02


def turning(rng: Generator, count: int, low: float) -> Array:
    """Points of a programme (count + 1,) between ``low`` and 1: it opens first, a quarter holds."""
    points = rng.uniform(low, 1.0, count + 1)
    points[:2] = 0.0, abs(points[1])
    for i in range(2, count + 1):
        if rng.random() < 0.25:
            points[i] = points[i - 1]
    return points


def piecewise(points: Array) -> Way:
    """Straight between whole load factors."""
    return lambda t: float(np.interp(t, np.arange(len(points)), points))


def few_steps(rng: Generator, count: int) -> Array:
    """Load factors up to ``count``, few a leg: programmes turn at them, or between two."""
    if rng.random() < 0.5:
        each = int(rng.integers(1, 5))
        return np.arange(1, each * count + 1) / each
    return np.sort(rng.uniform(0.0, count, int(rng.integers(count, 4 * count + 1))))


def stable_law(rng: Generator, K: float, secant: bool = True) -> vmdg.Law:
    """Softens stably between springs of stiffness ``K`` [MPa/mm] a mm long."""
    strength = K * log_uniform(rng, 1e-3, 2e-2)
    gap = strength / K * log_uniform(rng, 1.2, 10)
    if rng.random() < 0.3:
        return vmdg.ExponentialDebonding(strength, strength * gap)
    unloading = "secant" if secant and rng.random() < 0.5 else "plastic"
    return vmdg.Debonding(strength, gap, unloading=unloading)


def opening(law: vmdg.Law, K: float) -> float:
    """Way of the end at which a bond between springs is mostly gone [mm]."""
    return law.strength / K + (
        getattr(law, "critical_gap", 0) or 2 / law.strength * law.fracture_energy
    )


def compared(run: Run, tractions: list[Array], damages: list[float]) -> list[str]:
    """The first row with another traction at a point, or another damage."""
    strength = run.case.bonds[0].law.strength
    size = max([strength, *(float(np.abs(T).max()) for T in tractions)])
    for record, T, damage in zip(run.records[1:], tractions, damages, strict=True):
        off = np.abs(record.traction[0] - T).max() / size
        off = max(off, np.abs(record.softening[0] - damage * strength).max() / size)
        if not off < EXACT:
            return [f"the row at t = {record.t:.6g} is off by {off:.1e}"]
    return []


def bar_of(rng: Generator, kinds: Kinds) -> tuple[dict, float]:
    """Two blocks of one material in confined tension, without law and motion, and its K."""
    kind, degree = choose(rng, kinds)
    mesh, tags = block_pair(kind, rng, np.ones(dimension(kind)))
    body = vmdg.NeoHookean(E=E, nu=rng.uniform(0.0, 0.4))
    small = (kind, degree) in LINEAR and rng.random() < 0.5
    inputs = {
        "mesh": mesh,
        "tags": tags,
        "materials": {1: body, 2: body},
        "degree": degree,
        "kinematics": "small" if small else "finite",
    }
    return inputs, body.parameters["lmbda"] + 2 * body.parameters["mu"]


def moved(inputs: dict, law: vmdg.Law, way: Way, swells: Way | None = None) -> dict:
    """The bar whose end moves by ``way`` and whose bodies grow by ``swells`` along it.

    A row is that of a point by hand, one implicit step after the row before.
    """
    mesh, mu, lmbda = inputs["mesh"], *inputs["materials"][1].parameters.values()
    grown = swells or (lambda t: 0.0)

    def borne(t: float) -> Callable[[float], float]:
        if inputs["kinematics"] == "small":
            return lambda gap: (2 * mu + lmbda) * (way(t) - gap - grown(t))

        def stress(gap: float) -> float:
            e = (way(t) - gap - grown(t)) / (1 + grown(t))
            return mu * e * (2 + e) / (1 + e) + lmbda * e

        return stress

    def judge(run: Run) -> list[str]:
        point, tractions, damages = Point(law, mesh.d), [], []
        for before, after in pairwise(run.records):
            T = point.pull(borne(after.t), (after.t - before.t) or np.inf)
            tractions.append(T * np.eye(mesh.d)[0])
            damages.append(point.damage)
        found = compared(run, tractions, damages)
        if law.viscosity > 0:
            found += rated(run, borne)
        return found

    def eigenstrain(t: float) -> Array:
        return grown(t) * np.diag([1.0, 0.0, 0.0])

    ends = (Support(mesh.side(0, 0), 0.0, 0), Support(mesh.side(0, -1), way, 0))
    return {
        **inputs,
        "bonds": (Bond(law, (1, 2)),),
        "supports": (*ends, *rollers(mesh)),
        "eigenstrain": None if swells is None else {1: eigenstrain, 2: eigenstrain},
        "judge": judge,
    }


def rated(run: Run, borne: Callable[[float], Callable[[float], float]]) -> list[str]:
    """Rows that the rate equation of the bond does not pass within a few steps."""
    records = run.records[:-1]  # without the rest at the end
    t = np.array([record.t for record in records])
    T = np.array([record.traction[0][:, 0].mean() for record in records])
    low, high = rate_bounds(run.case.bonds[0].law, borne, t, LATE)
    off = float(np.maximum(low - T, T - high).max() / np.abs(T).max())
    return [f"off the rate equation by {off:.1e}"] * (off > RATE)


def programmes(rng: Generator) -> Case:
    """A bar whose end opens, closes, presses and holds in few steps."""
    inputs, K = bar_of(rng, FAILING)
    law, count = stable_law(rng, K), int(rng.integers(2, 7))
    way = piecewise(opening(law, K) * turning(rng, count, rng.choice([0.0, -0.3])))
    inputs = moved(inputs, law, way) | {"loads": few_steps(rng, count)}
    return Case("programmes", f"{count} legs, {law.unloading}, {described(law)}", **inputs)


def coatings(rng: Generator) -> Case:
    """Between fixed ends bodies shrink and grow across their bond."""
    inputs, K = bar_of(rng, TIED)
    law, count = stable_law(rng, K), int(rng.integers(1, 6))
    strains = opening(law, K) * turning(rng, count, rng.choice([0.0, -0.3]))
    inputs = moved(inputs, law, lambda t: 0.0, lambda t: -piecewise(strains)(t))
    inputs |= {"loads": few_steps(rng, count)}
    return Case("coatings", f"{count} legs, {law.unloading}, {described(law)}", **inputs)


def rates(rng: Generator) -> Case:
    """Overstress of a hundredth to a hundred times the strength, opening, holding, closing."""
    inputs, K = bar_of(rng, LINEAR)
    law, count = stable_law(rng, K, secant=False), int(rng.integers(1, 4))
    points = turning(rng, count, 0.0) * log_uniform(rng, 1, 3)
    points[1] = max(points[1], 0.3)
    way = opening(law, K)
    ratio = log_uniform(rng, 1e-2, 1e2)
    law = vmdg.Debonding(law.strength, way, viscosity=ratio * law.strength / way)
    inputs = moved(inputs, law, piecewise(way * points))
    # A step of zero length would last indefinitely.
    inputs |= {"loads": np.append(np.arange(1, 60 * count + 1) / 60, count)}
    return Case("rates", f"overstress {ratio:.2g}, {count} legs, {described(law)}", **inputs)


# Laminates


def laminate(
    rng: Generator,
    law_of: Callable[[float], vmdg.Law],
    ways: Callable[[vmdg.Law, Array], Callable[[float], Array]],
) -> dict:
    """A layer in a periodic cell under a mean strain; on one side of it the bond may fail.

    Bodies are springs in series: K = 1 / sum L/C of confined tension and of shear.
    """
    kind, degree = choose(rng, {**PLANE, ("hexahedron", 1): 1})
    left, right = np.sort(rng.uniform([0.1, 0.6], [0.4, 0.9]))
    lines = (np.array([0.0, left, right, 1.0]), *[np.linspace(0, 1, 3)] * (dimension(kind) - 1))
    mesh = box(kind, lines)
    x = mesh.midpoints[:, 0]
    tags = np.where((x > left) & (x < right), 2, 1)
    bodies = {
        i: vmdg.NeoHookean(E=E * log_uniform(rng, 1, 9), nu=rng.uniform(0, 0.4)) for i in (1, 2)
    }
    lengths = np.array([1 - right + left, right - left])
    mu = np.array([body.parameters["mu"] for body in bodies.values()])
    confined = 2 * mu + [body.parameters["lmbda"] for body in bodies.values()]
    K = np.full(mesh.d, 1 / (lengths / mu).sum())
    K[0] = 1 / (lengths / confined).sum()
    law = law_of(K.min())
    way = ways(law, K)

    def strain(t: float) -> Array:
        H = np.zeros((mesh.d, mesh.d))
        H[:, 0] = way(t)
        return (H + H.T) / 2

    def judge(run: Run) -> list[str]:
        point, tractions, damages = Point(law, mesh.d), [], []
        for record in run.records[1:]:
            tractions.append(point.move(way(record.t), K))
            damages.append(point.damage)
        found = compared(run, tractions, damages)
        took, (low, high) = run.records[-1].energy.friction, point.rubbed
        if not law.strength and not low - EXACT * high <= took <= high * (1 + EXACT):
            found.append(f"friction took {took:.6e}, by hand {low:.6e} to {high:.6e} N mm")
        return found

    return {
        "mesh": mesh,
        "tags": tags,
        "materials": bodies,
        "bonds": (Bond(law, facets=lambda x, tags: np.isclose(x[0], left)),),
        "supports": (),
        "degree": degree,
        "kinematics": "small",
        "periodic": vmdg.Periodic(strain=strain),
        "judge": judge,
    }


def directions(rng: Generator) -> Case:
    """Openings of a laminate that change direction in few steps."""
    count = int(rng.integers(2, 7))
    low = rng.choice([0.0, -0.3])

    def ways(law: vmdg.Law, K: Array) -> Callable[[float], Array]:
        across = [turning(rng, count, -1.0) for _ in K[1:]]
        legs = np.array([turning(rng, count, low), *across]).T
        return Path(opening(law, K.min()) * log_uniform(rng, 0.5, 1) * legs)

    inputs = laminate(rng, lambda K: stable_law(rng, K), ways)
    law = inputs["bonds"][0].law
    what = f"{count} legs, {law.unloading}, {described(law)}"
    return Case("changes of direction", what, loads=few_steps(rng, count), **inputs)


def friction(rng: Generator) -> Case:
    """Pressed layers that rub back and forth, never bonded or until the bond is gone."""
    count, mu = int(rng.integers(2, 9)), rng.uniform(0.1, 1.0)
    bonded = rng.random() < 0.5

    def law_of(K: float) -> vmdg.Law:
        law = stable_law(rng, K, secant=False)
        return replace(law, friction=mu) if bonded else vmdg.Contact(mu)

    def ways(law: vmdg.Law, K: Array) -> Callable[[float], Array]:
        reach = opening(law, K.min()) if bonded else log_uniform(rng, 1e-4, 1e-1)
        pressures = rng.uniform(-1.0, 0.2, count + 1) if rng.random() < 0.5 else -np.ones(count + 1)
        pressures[0] = 0.0
        across = [np.append(0.0, rng.uniform(-1.0, 1.0, count)) for _ in K[1:]]
        across[0][1:] = (-1.0) ** np.arange(count) * rng.uniform(0.3, 1.0, count)
        return Path(
            reach * np.array([pressures * rng.uniform(0.1, 1) / mu * K[1] / K[0], *across]).T
        )

    inputs = laminate(rng, law_of, ways)
    what = f"mu {mu:.2f}, {count} legs, {described(inputs['bonds'][0].law)}"
    return Case("cycles of friction", what, loads=few_steps(rng, count), **inputs)
