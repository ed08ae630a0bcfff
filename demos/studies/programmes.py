"""Random bars between a grip and an elastic machine, each judged by ten times as many load steps.

Every scene has a number that fixes the bars (brittle and ductile bonds, bonds that rub when they
are gone, surfaces that only rub, bodies that flow), the stiffness of the machine that pulls or
shears them, and the programme of its grip: one way, or there and back. At every given load factor
the force must be that of a run with ten times as many load steps; where this one and a still finer
run differ, bars fail in an order that steps decide, and the scene is left out as chaotic.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.random import Generator
from parts.options import run
from parts.stability.cases import log_uniform
from parts.stability.runner import BAD, Outcome, run_all, time_limit
from parts.stability.scenes import Array, Bond, Case, Cells, Support, box

import vmdg

#: Modulus of the bars [MPa], and what a bar is made of.
E = 1000.0
BARS = ("brittle", "ductile", "exponential", "gritty", "rubbing", "flowing")

#: Error of the force relative to the largest one, and that between finer runs.
WRONG, CHAOTIC = 0.02, 0.005

#: Load steps relative to the first run.
FINER = (10, 30)

#: Programmes take turns: one way, there and back.
FAMILIES = ("pulled", "pulled and pressed", "sheared", "sheared back")

#: Largest number of seconds of a scene.
PATIENCE = 600


@dataclass(frozen=True)
class Scene:
    """What is drawn."""

    family: str
    bars: tuple[str, ...]  # Of BARS
    strengths: Array  # Of the bars [MPa]
    shares: Array  # Critical gap relative to the elongation of a bar at its strength
    machine: float  # Modulus of the machine relative to that of the bars
    points: Array  # Displacement of the grip at t = 0, 1, .. [mm]
    pressure: float  # Pressing before it is sheared [mm]
    steps: int  # Of every leg

    @property
    def shears(self) -> bool:
        return self.family.startswith("sheared")

    def __str__(self) -> str:
        return f"{', '.join(self.bars)}; machine {self.machine:.2g} E, {self.steps} steps a leg"


def draw(number: int) -> Scene:
    """The scene of a number."""
    rng, family = np.random.default_rng(number), FAMILIES[number % len(FAMILIES)]
    count = int(rng.integers(2, 7))
    shears, back = family.startswith("sheared"), family.endswith(("back", "pressed"))
    bars = rng.choice(BARS if shears else [bar for bar in BARS if bar != "rubbing"], count)
    strengths = E * 1e-3 * log_uniform(rng, 1, 5) * rng.weibull(rng.uniform(2, 8), count)
    ductile = np.isin(bars, ("ductile", "flowing"))
    shares = np.where(ductile, rng.uniform(1.5, 5.0, count), rng.uniform(0.1, 0.8, count))
    machine = log_uniform(rng, 0.1, 10)
    last = 2 * strengths.max() / E * (1 + 2 / machine) * rng.uniform(0.8, 2.0)
    points = [0.0, last]
    if back:
        points += [last * rng.uniform(-0.5, 0.6), last * rng.uniform(0.8, 1.3)]
    pressure = strengths.mean() / E * rng.uniform(0.5, 3.0) if shears else 0.0
    steps = int(rng.integers(2, 12))
    return Scene(
        family, tuple(map(str, bars)), strengths, shares, machine, np.array(points), pressure, steps
    )


def law_of(bar: str, strength: float, gap: float, rng: Generator) -> vmdg.Law:
    """The bond in the middle of a bar."""
    friction = rng.uniform(0.1, 0.8)
    if bar == "rubbing":
        return vmdg.Contact(friction)
    if bar == "exponential":
        return vmdg.ExponentialDebonding(strength, strength * gap / 2)
    if bar == "flowing":
        return vmdg.Debonding(2 * strength, gap)
    return vmdg.Debonding(strength, gap, friction=friction if bar == "gritty" else 0.0)


def mesh_of(count: int) -> tuple[Cells, Array]:
    """Bars of two cells side by side, a machine of one column of cells, and their tags.

    Tags are 2 n and 2 n + 1 of the halves of bar n, and 2 count of the machine.
    """
    whole = box("quadrilateral", (np.arange(4.0), np.arange(2.0 * count)))
    x, y = whole.midpoints.T.astype(int)
    keep = (x == 2) | (y % 2 == 0)
    tags = np.where(x == 2, 2 * count, y + np.minimum(x, 1))[keep]
    used, cells = np.unique(whole.cells[keep], return_inverse=True)
    return Cells("quadrilateral", whole.nodes[used], cells.reshape(-1, 4), whole.lines), tags


def solved(number: int, finer: int) -> Array:
    """Forces on the grip [N] and work of friction and flow, relative to the product of the largest
    force and displacement, at the given load factors of a scene with more load steps (2, n)."""
    scene, rng = draw(number), np.random.default_rng((number, 1))
    count = len(scene.bars)
    cells, tags = mesh_of(count)
    elastic, materials, bonds = vmdg.NeoHookean(E=E, nu=0.0), {}, []
    for n, bar in enumerate(scene.bars):
        flows = vmdg.J2(E=E, nu=0.0, yield_stress=scene.strengths[n], hardening=E / 20)
        materials |= dict.fromkeys((2 * n, 2 * n + 1), flows if bar == "flowing" else elastic)
        gap = scene.shares[n] * 2 * scene.strengths[n] / E
        law = law_of(bar, scene.strengths[n], gap, rng)
        bonds.append(Bond(law, (2 * n, 2 * n + 1)))
    materials[2 * count] = vmdg.NeoHookean(E=scene.machine * E, nu=0.0)
    end = cells.side(0, -1)
    knots = np.arange(len(scene.points))

    def way(t: float) -> float:
        return float(np.interp(t, knots, scene.points))

    axis = int(scene.shears)

    def across(x: Array, t: float) -> Array:
        """The other component, everywhere: bars stay uniform."""
        return -scene.pressure * min(10 * t, 1.0) * x[0] / 3

    supports = (
        Support(cells.side(0, 0), 0.0, axis),
        Support(end, way, axis),
        Support(lambda x: x[0] > -1, across, 1 - axis),
    )
    case = Case(
        scene.family,
        str(scene),
        cells,
        tags,
        materials,
        tuple(bonds),
        supports,
        np.zeros(0),
        kinematics="small",
    )
    problem = case.problem()
    legs = len(scene.points) - 1
    given = np.arange(1, scene.steps * legs + 1) / scene.steps
    loads = np.arange(1, finer * scene.steps * legs + 1) / (finer * scene.steps)
    if scene.shears:
        loads = np.union1d([0.1], loads)

    def look(problem: vmdg.Problem) -> dict[str, float]:
        energy = problem.energy()
        spent = energy.friction + energy.plastic
        return {"force [N]": problem.reaction(end)[axis], "spent [N mm]": spent}

    history = vmdg.solve(problem, loads, monitor=look).history
    rows = [int(np.flatnonzero(np.isclose(history["load"], t, rtol=1e-9))[0]) for t in given]
    work = np.abs(history["force"]).max() * np.abs(scene.points).max()
    return np.array([history["force"], history["spent"] / work])[:, rows]


def off(one: Array, other: Array) -> float:
    """Largest difference of the forces relative to the largest one, and of the works."""
    force, spent = np.abs(one - other).max(axis=1)
    return max(force / np.abs(other[0]).max(), spent)


def judged(number: int) -> Outcome:
    """A scene with all that it is compared with."""
    start, scene = perf_counter(), draw(number)
    verdict, detail = "correct", ""
    try:
        with time_limit(PATIENCE), warnings.catch_warnings():
            # A bar is one cell wide, and fails at once.
            warnings.simplefilter("ignore", vmdg.ModelWarning)
            coarse, fine = solved(number, 1), solved(number, FINER[0])
            if off(coarse, fine) > WRONG:
                spread = off(fine, solved(number, FINER[1]))
                detail = f"off by {off(coarse, fine):.1e}, finer runs by {spread:.1e}"
                verdict = "wrong" if spread < CHAOTIC else "chaotic"
    except vmdg.StepFailure as error:
        verdict, detail = "stopped", str(error)
    return Outcome(
        number, scene.family, verdict, 0, 0, 0, perf_counter() - start, str(scene), detail
    )


def main(
    each: int = 20, only: int | None = None, first: int = 0, out: str = "results/programmes"
) -> list[Outcome]:
    """Run some scenes of every family, or one.

    Args:
        each: Scenes of every family.
        only: Number of the only scene.
        first: Number of the first scene, a multiple of 4.
        out: Folder for the table and the list of the scenes.
    """
    numbers, shown = range(first, first + each * len(FAMILIES)), (*BAD, "chaotic", "stopped")
    return run_all(numbers, judged, "programmes", out, only, shown)


if __name__ == "__main__":
    run(main)
