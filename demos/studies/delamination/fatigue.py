"""A cracked beam under cycles of the load: growth of the crack over its energy release rate."""

from __future__ import annotations

import math

import numpy as np

import vmdg
from studies.delamination.beams import Run, arms, at
from studies.verification.checks import compare, describe
from vmdg.meshes.beams import INTERFACE, RIGHT, UPPER_LEFT

#: IM7/8552 of the analyses of Davila (NASA/TP-2018-219838) [mm, MPa, N/mm], load ratio .1.
E, NU, G = (146671.0, 8703.0, 8703.0), (0.32, 0.32, 0.45), (5164.0, 5164.0, 3001.0)
BOND = vmdg.FatigueDebonding(80.1, 97.6, 0.24, 0.739, criterion="BK", exponent=2.1, ratio=0.1)
HEIGHT, A_0, OPENING, WIDTH = 2.25, 50.8, 1.92, 1.0


def fatigue(element_size: float = 0.1, far: float = 4.7, verbose: bool = False) -> Run:
    """A DCB held at its largest opening, G_I/G_c .9 at first, until the crack has run `far`.

    As the crack runs G falls, so that one run has the growth at all G below the first. In a process
    zone of length l in which the traction relative to what the bond bears is everywhere
    sqrt(G/G_c), damage grows from 0 to 1 while the crack runs over it:

        da/dN = l (G/(G_c E^2))^(beta/2)/(gamma (beta + 1)),

    see `vmdg.FatigueDebonding`. The slope of log(da/dN) over log G is compared with beta/2, and l,
    of its height, with the zone in which 0 < d < 1.

    Args:
        element_size: Of facets where the crack runs [mm].
        far: Way of the crack [mm].
        verbose: Print the residuals of every step.
    """
    stations = (0.0, A_0 - 2, A_0, math.ceil(A_0 + far + 1.5), A_0 + 30)
    tagged = arms(stations, element_size * np.array([8, 1, 1, 8]), HEIGHT, 3, A_0)
    body, facets = vmdg.Orthotropic(E=E, nu=NU, G=G), tagged.facet_tags
    bond = vmdg.Interface(facets.find(INTERFACE), law=BOND)
    problem = vmdg.Problem(
        tagged.mesh, tagged.cell_tags, {1: body, 2: body}, [bond], kinematics="small"
    )
    problem.dirichlet_points(at(0.0, -HEIGHT), lambda t: -min(t, 1.0) * OPENING / 2, "y")
    problem.dirichlet_points(at(0.0, HEIGHT), lambda t: min(t, 1.0) * OPENING / 2, "y")
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
        vmdg.SolveOptions(cycles=1.0, max_loss=0.1, **shown),
        monitor,
        history=first.history,
        until=lambda problem: crack.length > A_0 + far,
    )
    history, wear = result.history, BOND.wear(1.0, 0.0)
    share, speed = paris(history)
    slope, factor = np.polyfit(np.log(share), np.log(speed), 1)
    length = math.exp(factor - wear.log_rate(1.0, BOND.life))
    zone = history["zone"][history["crack"] > A_0 + 0.6].mean()
    case, mesh = "fatigue", describe(problem, 1)
    checks = [
        compare(case, "slope of the line of Paris, beta/2 [-]", slope, wear.exponent / 2, mesh),
        compare(case, "its l, the process zone [mm]", length, zone, mesh),
    ]
    return Run(result, checks, first.counts.factorizations)


def paris(history: vmdg.History, interval: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """G_I/G_c and da/dN [mm], once the crack has left its start.

    Args:
        history: Of the run.
        interval: Growth of the crack from one pair to the next [mm].
    """
    N, a, release = (history[name][2:] for name in ("cycles", "crack", "mode_1"))
    rows = np.searchsorted(a, np.arange(A_0 + 0.6, a[-1], interval))
    middle = np.interp((a[rows][1:] + a[rows][:-1]) / 2, a, release)
    return middle / BOND.normal_energy, np.diff(a[rows]) / np.diff(N[rows])
