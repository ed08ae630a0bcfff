"""Mixed-mode bending: one lever that opens and shears, at any ratio of the modes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from parts.delamination.beams import Run, arms, at, build, lift, node
from parts.delamination.laminate import MMB, Laminate
from parts.verification.checks import compare, describe
from scipy.optimize import brentq

import vmdg

#: Half the span, and the crack at the start [mm].
L, A_0 = 50.4, 25.4

#: Krueger 2012 by G_II/G_T: lever lengths [mm]; deflection [mm] and load [N] of first growth.
LEVERS = {0.2: 92.9, 0.5: 41.3, 0.8: 27.3}
CRITICAL = {0.2: (1.64, 128.5), 0.5: (1.34, 385.0), 0.8: (1.65, 751.0)}


class Theory(NamedTuple):
    """Corrected beam theory at one crack length."""

    load: float  # P while the crack runs [N]
    deflection: float  # w under the lever's load [mm]
    stiffness: float  # P/w [N/mm]
    ratio: float  # G_II/G_T


def theory(m: Laminate, c: float, a: float) -> Theory:
    """Corrected beam theory of the MMB test (Reeder and Crews 1990; ASTM D6671) with shear.

    With a_I = a + chi h and a_II = a + 0.42 chi h,

        G_I = 3 P^2 (3c - L)^2 a_I^2/(4 b^2 h^3 L^2 E),
        G_II = 9 P^2 (c + L)^2 a_II^2/(16 b^2 h^3 L^2 E),
        C = (3c - L)^2 a_I^3/(2 b h^3 L^2 E)
            + (c + L)^2/L^2 [(2 L^3 + 3 a_II^3)/(8 b h^3 E) + 3 L/(10 G_12 b h)],

    and G_I + G_II = G_c(G_II/G_T) by Benzeggagh and Kenane while the crack runs, a <= L.
    """
    opened, sheared = a + m.chi * m.h, a + 0.42 * m.chi * m.h
    lever, bend = (3 * c - L) ** 2 / L**2, (c + L) ** 2 / L**2
    G_I = 3 * lever * opened**2 / (4 * m.b * m.rigidity)
    G_II = 9 * bend * sheared**2 / (16 * m.b * m.rigidity)
    ratio = G_II / (G_I + G_II)
    P = math.sqrt(m.toughness(ratio) / (G_I + G_II))
    shear = 0.3 * L / (m.G12 * m.b * m.h)
    C = lever * opened**3 / (2 * m.rigidity)
    C += bend * ((2 * L**3 + 3 * sheared**3) / (8 * m.rigidity) + shear)
    return Theory(P, C * P, 1 / C, ratio)


def lever_length(m: Laminate, ratio: float) -> float:
    """c at which beam theory has this G_II/G_T at the start [mm]."""
    return brentq(lambda c: theory(m, c, A_0).ratio - ratio, L / 3 * 1.02, 100 * L)


def mmb(
    ratio: float = 0.2,
    end: float = 9.0,
    element_size: float = 0.5,
    rows: int = 2,
    m: Laminate = MMB,
    verbose: bool = False,
) -> Run:
    """An MMB test until the lever's load has gone down by ``end``.

    The lever is dead load: with P on it, P (c + L)/L acts down at midspan and P c/L up at the end
    of the upper arm; w = ((c + L) v_c + c v_e)/L by virtual work. The load grows, falls and grows
    again: the path is traced, and ends where w says so. Facets are a quarter as long at the tip
    of the crack, degree 2, small strain as in the reference.
    """
    c = LEVERS.get(ratio) or lever_length(m, ratio)
    start = theory(m, c, A_0)
    stations = (-5.0, 0.0, A_0 - 1, A_0, A_0 + 2, L, 1.75 * L, 2 * L, 2 * L + 5)
    sizes = element_size * np.array([4, 4, 0.25, 0.25, 1, 1, 4, 4])
    problem = build(m, arms(stations, sizes, m.h, rows, A_0), degree=2)
    problem.dirichlet_points(at(0.0, -m.h), 0.0, "y")
    problem.dirichlet_points(at(2 * L, -m.h), 0.0)
    problem.point_load(at(L, m.h), lambda t: -t * (c + L) / L, "y")
    problem.point_load(at(0.0, m.h), lambda t: t * c / L, "y")
    heights = [node(problem, x, m.h) for x in (L, 0.0)]

    def deflection(problem: vmdg.Problem) -> float:
        middle, arm = (lift(problem, height) for height in heights)
        return (-(c + L) * middle + c * arm) / L

    crack = vmdg.CrackGrowth(problem, 0, start=A_0)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        return {"deflection [mm]": deflection(problem)} | crack()

    shown = {"progress": True, "verbose": verbose, "show": ("deflection",)}
    options = vmdg.SolveOptions(unstable="trace", **shown)
    # Small steps over the peak, which is a row of the table, and then as they come.
    top = vmdg.solve(
        problem,
        start.load * np.array([0.3, 0.6, 20.0]),
        replace(options, max_share=0.3 * element_size / (2 * L - A_0)),
        monitor,
        until=lambda problem: crack.length > A_0 + 1,
    )
    result = vmdg.solve(
        problem,
        [20 * start.load],
        options,
        monitor,
        history=top.history,
        until=lambda problem: deflection(problem) > end,
    )
    history = result.history
    w, P = history["deflection"], history["load"]
    peak = int(np.argmax(P[w < 2 * start.deflection]))
    running = (history["crack"] > A_0 + 2) & (history["crack"] < L - 5)
    release = history["mode_1"] + history["mode_2"]
    tip = (history["mode_2"] / release)[history["crack"] > A_0 + 0.5]
    case, mesh = f"MMB {ratio:g}", describe(problem, 2)
    checks = [
        compare(case, "stiffness [N/mm]", P[0] / w[0], start.stiffness, mesh),
        compare(case, "critical load [N]", P[peak], start.load, mesh),
        compare(case, "G_II/G_T at the start of growth [-]", tip[0], start.ratio, mesh),
    ]
    exact = [theory(m, c, a).load for a in history["crack"][running]]
    if running.any():
        off = np.abs(P[running] / exact - 1).argmax()
        checks.append(
            compare(case, "load while the crack runs [N]", P[running][off], exact[off], mesh)
        )
    return Run(result, checks, top.counts.factorizations)
