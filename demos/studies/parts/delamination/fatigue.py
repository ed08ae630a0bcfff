"""A cracked beam under cycles of the load: growth of the crack over its energy release rate."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from parts.delamination.beams import Run, arms, at
from parts.delamination.laminate import Laminate
from parts.verification.checks import compare, describe

import vmdg
from vmdg.meshes.beams import INTERFACE, RIGHT, UPPER_LEFT

#: IM7/8552 of the analyses of Davila (NASA/TP-2018-219838), R = 0.1, and its fatigue
#: constants.
PLY = Laminate(146671.0, 8703.0, 5164.0, 0.32, 0.45, 2.25, 1.0, 0.24, 80.1, 0.739, 2.1)
WEAR = {"endurance": 0.2, "ratio": 0.1, "life": 1e7, "brittleness": 0.95}
BOND = vmdg.FatigueDebonding(
    PLY.strength, 97.6, PLY.G_I, PLY.G_II, criterion="BK", exponent=PLY.exponent, **WEAR
)
A_0, OPENING = 50.8, 1.92

#: The same beam without vmdg, one arm of rectangles in numpy and the law at its nodes, by
#: the study `delamination` of commit c6a02cc: slope of the line of Paris, da/dN [mm] at `SHARE`
#: on it, and cycles from 51.4 to 55.5 mm.
WITHOUT_SLOPE, WITHOUT_SPEED, WITHOUT_CYCLES = 7.4389, 2.28232e-5, 278255.0

#: G_I/G_c at which growth is compared, and growth before that is left out [mm].
SHARE, AFTER = 0.45, 0.6


class Growth(NamedTuple):
    """A row for every step of the cycles, (k,) each: N, the crack [mm] and J_I [N/mm]."""

    cycles: NDArray[np.float64]
    crack: NDArray[np.float64]
    release: NDArray[np.float64]


def fatigue(
    element_size: float = 0.1, far: float = 4.7, rows: int = 8, verbose: bool = False
) -> Run:
    """A DCB held at its largest opening, G_I/G_c 0.5 at first, until the crack has run `far`.

    As the crack runs G falls, so that one run has the growth at all G below the first. In a process
    zone of length l in which the traction relative to what the bond carries is everywhere
    sqrt(G/G_c), damage grows from 0 to 1 while the crack runs over it:

        da/dN = l (G/(G_c E^2))^(beta/2)/(gamma (beta + 1)),

    see `vmdg.FatigueDebonding`. The slope of log(da/dN) over log G is compared with beta/2, the
    growth at `SHARE` and the cycles of all of it with those without vmdg. Degree 2; the traction
    in a zone of 0.4 mm needs cells that are not much higher, and the damage rate has its power 15.
    """
    stations = (0.0, A_0 - 2, A_0, math.ceil(A_0 + far + 1.5), A_0 + 30)
    tagged = arms(stations, element_size * np.array([8, 1, 1, 8]), PLY.h, rows, A_0)
    body, facets = PLY.material, tagged.facet_tags
    bond = vmdg.Interface(facets.find(INTERFACE), law=BOND)
    problem = vmdg.Problem(
        tagged.mesh, tagged.cell_tags, {1: body, 2: body}, [bond], degree=2, kinematics="small"
    )
    problem.dirichlet_points(at(0.0, -PLY.h), lambda t: -min(t, 1.0) * OPENING / 2, "y")
    problem.dirichlet_points(at(0.0, PLY.h), lambda t: min(t, 1.0) * OPENING / 2, "y")
    problem.dirichlet(facets.find(RIGHT), 0.0)
    crack = vmdg.CrackGrowth(problem, bond, start=A_0)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        force = problem.reaction(facets.find(UPPER_LEFT))[1]
        return {"cycles": max(problem.t - 1.0, 0.0), "force [N]": force} | crack()

    shown = {"progress": True, "verbose": verbose}
    first = vmdg.solve(problem, [0.5, 1.0], vmdg.SolveOptions(**shown), monitor)
    result = vmdg.solve(
        problem,
        [1e9],
        vmdg.SolveOptions(cycles=1.0, max_loss=0.05, **shown),
        monitor,
        history=first.history,
        until=lambda problem: crack.length > A_0 + far,
    )
    computed = of_history(result.history)
    case, mesh = "fatigue", describe(problem, 2)
    slope, speed = line(computed)
    start, end = A_0 + AFTER, A_0 + far
    lasted = np.diff(np.interp([start, end], computed.crack, computed.cycles))[0]
    pairs = [
        ("slope of the line of Paris, beta/2 [-]", slope, BOND.wear(1.0, 0.0).exponent / 2),
        (f"da/dN at G = {SHARE:g} G_c [nm]", 1e6 * speed, 1e6 * WITHOUT_SPEED),
    ]
    if far == 4.7:
        pairs += [(f"cycles from a = {start:g} to {end:g} mm [-]", lasted, WITHOUT_CYCLES)]
    checks = [compare(case, what, *values, mesh) for what, *values in pairs]
    return Run(result, checks, first.counts.factorizations)


def of_history(history: vmdg.History) -> Growth:
    return Growth(*(history[name][2:] for name in ("cycles", "crack", "mode_1")))


def paris(growth: Growth, interval: float = 0.5) -> tuple[NDArray, NDArray]:
    """G_I/G_c and da/dN [mm], once the crack has left its start."""
    N, a, release = growth
    rows = np.searchsorted(a, np.arange(A_0 + AFTER, a[-1], interval))
    middle = np.interp((a[rows][1:] + a[rows][:-1]) / 2, a, release)
    return middle / PLY.G_I, np.diff(a[rows]) / np.diff(N[rows])


def line(growth: Growth) -> tuple[float, float]:
    """Slope of log(da/dN) over log G, and da/dN [mm] at `SHARE` on that line."""
    share, speed = paris(growth)
    slope, height = np.polyfit(np.log(share / SHARE), np.log(speed), 1)
    return float(slope), math.exp(height)
