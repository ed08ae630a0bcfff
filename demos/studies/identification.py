"""Strength and energy of a bond from a curve: vmdg.identify, and what needs no derivatives.

The double cantilever beam of ``demos/measured_beam.py``, from starts 30 % off to either side, with
two levels of noise: vmdg.identify; ``scipy.optimize.least_squares`` with the same residuals and its
own differences; and the simplices of Nelder and Mead. All work with logarithms of the parameters. A
search has succeeded if its cost is within 1 % of the least that any has found, and its parameters
within half a standard error of that one's.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import product
from time import process_time
from typing import NamedTuple

import numpy as np
from parts.bars import progress
from parts.options import run
from parts.scenes import measured_beam
from parts.tables import markdown, report
from scipy.optimize import least_squares, minimize

import vmdg

ENERGY, STRENGTH, TRUTH = measured_beam.ENERGY, measured_beam.STRENGTH, measured_beam.TRUTH
#: Start values relative to the truth.
FACTORS = ((1.3, 0.7), (0.7, 1.3))
HEAD = ("noise", "start", "method", "runs", "seconds", "strength [MPa]", "energy [N/mm]", "success")


class Search(NamedTuple):
    """How a search ended.

    Attributes:
        method: Its name.
        runs: Number of runs.
        seconds: Processor time.
        logs: Logarithms of strength and energy.
        cost: Half of the sum of squares of the weighted residuals.
        success: Whether it has found the least cost.
    """

    method: str
    runs: int
    seconds: float
    logs: np.ndarray
    cost: float
    success: bool = False


def forces(logs: np.ndarray, openings: np.ndarray, facet: float) -> np.ndarray:
    """Forces of a run at given openings [N/mm]."""
    problem, monitor = measured_beam.beam(dict(zip(TRUTH, np.exp(logs), strict=True)), facet)
    history = vmdg.solve(problem, openings, monitor=monitor).history
    return np.array([history["force"][np.isclose(history["load"], t)][0] for t in openings])


def searches(curve: vmdg.Curve, sigma: float, start: dict[str, float], facet: float) -> list:
    """The three searches, as functions."""
    first = np.log(list(start.values()))

    def residuals(logs: np.ndarray) -> np.ndarray:
        return (forces(logs, curve.x, facet) - curve.y) / sigma

    def by_vmdg() -> Search:
        begin = process_time()
        found = vmdg.identify(partial(measured_beam.beam, facet=facet), curve, start, sigma=sigma)
        logs = np.log(list(found.estimate.values()))
        cost = min(one.cost for one in found.runs)
        return Search("vmdg.identify", len(found.runs), process_time() - begin, logs, cost)

    def by_differences() -> Search:
        begin = process_time()
        found = least_squares(residuals, first, xtol=1e-4, ftol=1e-4)
        # scipy does not count the runs of its differences: one a parameter and Jacobian.
        runs = found.nfev + len(first) * found.njev
        return Search("scipy, differences", runs, process_time() - begin, found.x, found.cost)

    def by_simplices() -> Search:
        begin = process_time()
        options = {"xatol": 1e-4, "fatol": 1e-4, "maxfev": 200}
        found = minimize(
            lambda logs: float(np.sum(residuals(logs) ** 2)) / 2,
            first,
            method="Nelder-Mead",
            options=options,
        )
        return Search("Nelder-Mead", found.nfev, process_time() - begin, found.x, found.fun)

    return [by_vmdg, by_differences, by_simplices]


def judged(found: list[Search], error: np.ndarray) -> list[Search]:
    """Which of the searches of one measurement and start have succeeded.

    Args:
        found: The searches.
        error: Standard errors of the logarithms.
    """
    best = min(found, key=lambda one: one.cost)
    return [
        one._replace(
            success=bool(
                one.cost <= 1.01 * best.cost and (abs(one.logs - best.logs) <= error / 2).all()
            )
        )
        for one in found
    ]


def main(
    points: int = 16,
    facet: float = 0.5,
    alone: bool = False,
    out: str = "results/identification",
) -> list[Search]:
    """Search for the parameters in all ways; the lines of the table.

    Args:
        points: Number of measured points.
        facet: Size of the facets [mm].
        alone: One noise, one start and vmdg.identify only.
        out: Folder for the table.
    """
    openings = np.linspace(0, 1.5, points + 1)[1:]
    exact = forces(np.log(list(TRUTH.values())), openings, facet)
    lines, every = [], []
    noises, factors = ((0.01,), ((1.3, 0.7),)) if alone else ((0.001, 0.01), FACTORS)
    for noise, (one, other) in progress(list(product(noises, factors)), "start"):
        sigma = noise * exact.max()
        measured = exact + sigma * np.random.default_rng(1).standard_normal(points)
        curve = vmdg.Curve(openings, measured)
        start = {STRENGTH: one * TRUTH[STRENGTH], ENERGY: other * TRUTH[ENERGY]}
        ways: list[Callable[[], Search]] = searches(curve, sigma, start, facet)
        found = [way() for way in (ways[:1] if alone else ways)]
        # From the curve at the truth: 4 and 0.6 % at a noise of 1 %.
        found = judged(found, noise * np.array([4.0, 0.6]))
        every += found
        for search in found:
            name, runs, seconds, logs, _, success = search
            said = "yes" if success else "no"
            place = f"{one}, {other}"
            values = (f"{value:.4g}" for value in np.exp(logs))
            lines.append((noise, place, name, runs, f"{seconds:.0f}", *values, said))
    text = markdown(HEAD, lines)
    report(out, "identification", text)
    return every


if __name__ == "__main__":
    run(main)
