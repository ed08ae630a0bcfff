"""Explicit steps: microseconds a cell and a step, and hours of a large run.

Two blocks on which waves run, as one body, tied, or with an interface at all points of which the
bond softens. The steps between two rows of a run are timed, without the set-up, the critical step
and tau_s, which are computed again in every ``renewal`` steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import process_time

from mpi4py import MPI

import numpy as np
from parts.benchmark.common import DIMENSION, layers

import vmdg
from vmdg.base.timers import timings

HEAD = ("cells", "kinematics", "interface", "number", "us a cell and step", "ms a step")
LAWS = {
    "none": None,
    "tied": vmdg.Bonded(),
    "softening": vmdg.Debonding(strength=1e-5, critical_gap=1.0, friction=0.3),
}


@dataclass(frozen=True)
class Cost:
    """Processor time of steps."""

    cell: str  # Type of the cells
    kinematics: str  # As for :class:`vmdg.Problem`
    law: str  # Name of the law
    cells: int  # Their number
    seconds: float  # Of a step
    softening: float  # Share of the points whose bond softens

    def row(self) -> tuple:
        """Of the table below ``HEAD``."""
        each = 1e6 * self.seconds / self.cells
        return (*(self.cell, self.kinematics, self.law, self.cells), each, 1e3 * self.seconds)


def measure(cell: str, n: int, kinematics: str, law: str, steps: int, repeats: int) -> Cost:
    """Time steps of a body of two cubes of ``n`` cells an edge."""
    d = DIMENSION[cell]
    mesh, tags, _ = layers(cell, (*(n,) * (d - 1), 2 * n), (*(1.0,) * (d - 1), 2.0), n)
    body, law_ = vmdg.NeoHookean(E=1.0, nu=0.3), LAWS[law]
    interfaces = [vmdg.Interface(between=(1, 2), law=law_)] if law_ else []
    problem = vmdg.Problem(
        mesh, tags, {1: body, 2: body}, interfaces, kinematics=kinematics, density={1: 1.0, 2: 1.0}
    )

    def apart(x: np.ndarray) -> np.ndarray:
        v = np.zeros((d, x.shape[1]))
        v[-1] = 1e-2 * (x[d - 1] - 1)
        return v

    stamps: list[tuple[float, int]] = []

    def stamp(problem: vmdg.Problem) -> dict[str, float]:
        residuals = timings()["assemble residual"].runs
        stamps.append((process_time(), residuals))
        return {}

    # Of waves of pressure; safety and cells that are tied or thin make it shorter.
    row = steps / n / np.sqrt(1.35)
    scheme = vmdg.CentralDifferences(renewal=10**6)
    times = row * np.arange(1, repeats + 2)
    vmdg.solve_dynamics(problem, times, scheme, apart, stamp)
    (seconds, counts) = np.diff(stamps, axis=0).T
    each = problem.comm.allreduce(float((seconds / counts).min()), MPI.MAX)
    softening = 0.0
    if law == "softening":
        modes, share = problem.state[0].mode == vmdg.Mode.TENSION, np.zeros(2)
        problem.comm.Allreduce(np.array([modes.sum(), modes.size], dtype=float), share)
        softening = share[0] / share[1]
    cells = mesh.topology.index_map(d).size_global
    return Cost(cell, kinematics, law, cells, each, softening)
