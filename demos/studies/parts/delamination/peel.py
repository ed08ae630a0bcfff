"""A film peeled from a stiff ground at any angle, at finite strain (Rivlin 1944, Kendall 1975)."""

from __future__ import annotations

import math

import numpy as np
from parts.delamination.beams import Run, arms, at
from parts.verification.checks import compare, describe
from scipy.optimize import brentq

import vmdg
from vmdg.meshes.beams import BOTTOM, INTERFACE

#: Film [mm, MPa], its bond [N/mm, MPa], and the part that is free at the start [mm].
T, E, NU, G_C, STRENGTH, FREE = 0.1, 4000.0, 0.3, 0.2, 1.5, 10.0


def theory(angle: float) -> float:
    """P/b of P/b (1 - cos th) + (P/b)^2/(2 E' t) = G, E' = E/(1 - nu^2) in plane strain [N/mm]."""
    stretch = 2 * E / (1 - NU**2) * T
    lever = 1 - math.cos(math.radians(angle))
    return brentq(lambda p: p * lever + p * p / stretch - G_C, 0.0, 100.0)


def peel(
    angle: float = 90.0,
    length: float = 3.0,
    element_size: float = 0.1,
    rows: int = 1,
    verbose: bool = False,
) -> Run:
    """Peel by a dead force at the free end until the crack has run over ``length``.

    A hundredth of the peel force first turns into its direction, from 45 degrees, so that the free
    part follows; then the force grows in its direction, reaches the load at which the film peels,
    and the path is traced. Neo-Hookean film, degree 2, one cell of it across.

    Args:
        angle: Between the force and the bonded film behind the crack [degrees].
        length: Of new crack [mm].
        element_size: Of facets [mm].
    """
    stations = (0.0, FREE, FREE + length + 3, FREE + length + 6)
    tagged = arms(stations, element_size * np.array([4, 1, 3]), T, rows, FREE)
    film, ground = vmdg.NeoHookean(E=E, nu=NU), vmdg.NeoHookean(E=100 * E, nu=NU)
    bond = vmdg.Interface(
        tagged.facet_tags.find(INTERFACE), law=vmdg.Debonding(STRENGTH, 2 * G_C / STRENGTH)
    )
    problem = vmdg.Problem(tagged.mesh, tagged.cell_tags, {1: ground, 2: film}, [bond], degree=2)
    problem.dirichlet(tagged.facet_tags.find(BOTTOM), 0.0)
    exact, first = theory(angle), 0.01

    def force(t: float) -> np.ndarray:
        """Turns until t = 1, then grows."""
        th = math.radians(45 + (angle - 45) * min(t, 1.0))
        size = first * min(4 * t, 1.0) if t < 1 else first + t - 1
        return exact * size * np.array([-math.cos(th), math.sin(th)])

    problem.point_load(at(0.0, T), force)
    crack = vmdg.CrackGrowth(problem, 0, start=FREE)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        t = problem.t
        return {"force [N/mm]": exact * (first + t - 1) if t > 1 else 0.0} | crack()

    options = vmdg.SolveOptions(
        unstable="trace", progress=True, verbose=verbose, show=("force", "crack"), max_cuts=10
    )
    turning = np.linspace(0, 1, 21)[1:]
    result = vmdg.solve(
        problem,
        [*turning, *np.linspace(1, 1.5, 6)[1:], 4.0],
        options,
        monitor,
        until=lambda problem: crack.length > FREE + length,
    )
    history, mesh = result.history, describe(problem, 2)
    steady = history["crack"] > FREE + length / 2
    peeling = float(np.mean(history["force"][steady]))
    return Run(result, [compare(f"peel {angle:g}", "force [N/mm]", peeling, exact, mesh)])
