"""What a run is spared by the switches of :mod:`vmdg.linear.features`: P1 with and without it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

import vmdg
from parts.benchmark.peers import CRITICAL_GAP, P1, STRENGTH, Scene, build, loads
from vmdg.linear.ksp import LDLT, LU

BOND = vmdg.Debonding(strength=STRENGTH, critical_gap=CRITICAL_GAP)
TIE = vmdg.Bonded()
#: A bond that nothing here can damage.
STRONG = vmdg.Debonding(strength=1e3 * STRENGTH, critical_gap=1e3 * CRITICAL_GAP)


def bubbles(tau1: NDArray, tau2: NDArray, context: object) -> tuple[NDArray, NDArray]:
    """tau_s with the factor 4 and delta_1 of (24)-(25), as a callable: it might not be constant."""
    bonded = np.linalg.inv(tau1 + tau2)
    return 4 * bonded, bonded @ tau1


@dataclass(frozen=True)
class Way:
    """A way to run the plate.

    Attributes:
        law: Of the bond.
        kinematics: "small" or "finite".
        interface: Its further options.
        options: Of the solver.
        crack: Whether the plate has its crack.
    """

    law: vmdg.Law = BOND
    kinematics: str = "finite"
    interface: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    crack: bool = True


def solved_by(petsc: Mapping[str, Any]) -> Way:
    """The default with this linear solver."""
    return Way(options={"petsc": petsc})


def small(law: vmdg.Law = BOND, **interface: Any) -> Way:
    """At small strain."""
    return Way(law, "small", interface)


#: What can be spared: the run with it, and the run without.
CASES: dict[str, tuple[Way, Way]] = {
    "history, return map, damage tangent": (Way(STRONG, crack=False), Way(TIE, crack=False)),
    "unsymmetric factors": (solved_by(LU), solved_by(LDLT)),
    "turning frame": (Way(), Way(interface={"frame": "reference"})),
    "terms of finite strain": (Way(), small()),
    "tau_s in every step": (small(stabilization=bubbles), small(safety=4.0)),
}


@dataclass(frozen=True)
class Saving:
    """The plate with something and without.

    Attributes:
        name: What is spared.
        seconds: Processor time of the steps, with it and without [s].
        difference: Largest one of the forces, relative to the largest force.
    """

    name: str
    seconds: tuple[float, float]
    difference: float


def run(way: Way, scene: Scene, steps: int) -> tuple[float, NDArray[np.float64]]:
    """Processor time of the steps [s] and the forces at the given load factors [N]."""
    if not way.crack:
        scene = replace(scene, crack=0.0)
    problem, top = build(scene, way.law, way.kinematics, **way.interface)
    problem.discretization.compile()
    options = vmdg.SolveOptions(**way.options)
    given, start = loads(scene, steps), process_time()
    history = vmdg.solve(
        problem, given, options, lambda problem: {"force": problem.reaction(top)[-1]}
    ).history
    return process_time() - start, history["force"][np.isin(history["load"], given)]


def measure(name: str, scene: Scene = P1, steps: int = 40, repeats: int = 1) -> Saving:
    """Run both ways in turns, some times for the least processor time."""
    times, forces = [], []
    for _ in range(repeats):
        (*seconds,), forces = zip(*(run(way, scene, steps) for way in CASES[name]), strict=True)
        times.append(seconds)
    most = np.abs(forces[1]).max()
    difference = float(np.abs(forces[0] - forces[1]).max() / most)
    return Saving(name, tuple(np.min(times, axis=0)), difference)


#: A coarser plate.
COARSE = replace(P1, divisions=(16, 16))

HEAD = ("what is spared", "with it [s]", "without [s]", "ratio", "difference of the forces")


def rows(savings: Iterable[Saving]) -> list[list[str | float]]:
    """Of the table below ``HEAD``."""
    return [
        [s.name, *s.seconds, s.seconds[0] / s.seconds[1], f"{s.difference:.1e}"] for s in savings
    ]
