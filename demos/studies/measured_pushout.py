"""Friction, strength and critical gap of the push-out of section 7.4, from forces over the punch.

Of its curve the report prints the largest force, 412.2 N, and the last one, 105.5 N. (That at which
debonding begins, 98.6 N, depends on the mesh: ``pushout_parameters --study mesh``.) Two forces do
not determine three parameters: the strength is the one of the report with an error of 30 %, a
prior. A whole curve says more: forces of a run with the values of the report, with noise, stand for
one, without points near the snap, where a run jumps before or after them. All forces have an error
of 1 %.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import matplotlib.pyplot as plt
import numpy as np
from parts.options import run
from parts.scenes import pushout
from parts.tables import markdown, report

import vmdg

FRICTION, STRENGTH, GAP = "bond.friction", "bond.strength", "bond.critical_gap"
#: Values of the report, its friction as in ``demos/pushout.py``.
REPORT = {FRICTION: pushout.FRICTION, STRENGTH: pushout.STRENGTH, GAP: pushout.CRITICAL_GAP}
#: The largest and the last force of the report [N], and the punch at the last one [mm].
FORCES, END = np.array([412.21, 105.52]), 0.174
OPTIONS = vmdg.SolveOptions(unstable="trace", relative_tolerance=1e-8)


def pushed(values: dict[str, float], refine: float = 1.0) -> tuple[vmdg.Problem, Callable]:
    """The model after the cure, which depends on the bond too, and what it measures."""
    law = vmdg.Debonding(values[STRENGTH], values[GAP], friction=values[FRICTION])
    model = pushout.build(False, 25, refine, law, pushout.FIBRE_MODULUS)
    vmdg.solve(model.problem, np.linspace(0.25, 1, 4), OPTIONS, derivatives=list(values))
    model.problem.dirichlet(model.top, lambda t: 1 - t, model.axis, relative=True)
    return model.problem, model.measures


def main(
    refine: float = 1.0,
    steps: int = 40,
    points: int = 16,
    error: float = 0.01,
    seed: int = 1,
    whole: bool = True,
    out: str = "results/measured_pushout",
) -> dict[str, vmdg.Identified]:
    """Fit two forces, then a whole curve; what was identified.

    Args:
        refine: Factor on all counts of cells [-].
        steps: Load steps of the punch.
        points: Points of the whole curve before the snap; a quarter as many are behind it.
        error: Standard deviation of forces, relative, of the curve to the largest one [-].
        seed: Of its noise.
        whole: Fit the whole curve too.
        out: Folder for the results.
    """
    loads, make = 1 + np.linspace(0, END, steps + 1)[1:], partial(pushed, refine=refine)
    fit = partial(vmdg.identify, make, loads=loads, options=OPTIONS)
    sigma, start = error * FORCES, {FRICTION: 0.4, STRENGTH: REPORT[STRENGTH], GAP: REPORT[GAP]}
    curves = {"two forces": vmdg.Curve([np.inf, END], FORCES, along="punch", sigma=sigma)}
    prior = {STRENGTH: (REPORT[STRENGTH], 0.3)}
    found = {"two forces": fit(curves["two forces"], start, priors=prior)}
    if whole:
        problem, monitor = make(REPORT)
        path = vmdg.solve(problem, loads, OPTIONS, monitor).history.envelope("punch")
        snap = path["punch"][path["force"].argmax()]
        x = np.append(
            np.linspace(0, 0.9 * snap, points + 1)[1:], np.linspace(1.15 * snap, END, points // 4)
        )
        sigma = error * path["force"].max()
        noise = sigma * np.random.default_rng(seed).standard_normal(len(x))
        y = np.interp(x, np.append(0, path["punch"]), np.append(0, path["force"])) + noise
        curves["whole curve"] = vmdg.Curve(x, y, along="punch", sigma=sigma)
        # The friction that the last force tells, else 20 % off.
        friction = found["two forces"].estimate[FRICTION]
        start = {FRICTION: friction, STRENGTH: 1.2 * REPORT[STRENGTH], GAP: 0.8 * REPORT[GAP]}
        found["whole curve"] = fit(curves["whole curve"], start)

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    circle, lines = np.exp(2j * np.pi * np.linspace(0, 1, 200)), []
    for i, (name, one) in enumerate(found.items()):
        problem, monitor = make(one.estimate)
        path = vmdg.solve(problem, loads, OPTIONS, monitor).history
        left.plot(np.append(0, path["punch"]), np.append(0, path["force"]), f"C{i}", lw=1)
        x = np.where(
            np.isinf(curves[name].x), path["punch"][path["force"].argmax()], curves[name].x
        )
        left.plot(x, curves[name].y, f"C{i}o", ms=4, mfc="none", label=name)
        root = np.linalg.cholesky(one.covariance[1:, 1:]) * np.sqrt(5.99)
        around = np.exp(root @ [circle.real, circle.imag])
        strength, gap = one.estimate[STRENGTH], one.estimate[GAP]
        right.loglog(strength * around[0], 1e3 * gap * around[1], f"C{i}", lw=1, label=name)
        for parameter, value in one.estimate.items():
            error_of = f"{100 * one.relative_errors[parameter]:.2g}"
            low, high = one.interval(parameter)
            numbers = (f"{number:.4g}" for number in (REPORT[parameter], value))
            lines.append((name, parameter, *numbers, error_of, f"{low:.3g} to {high:.3g}"))
    left.set(xlabel="punch [mm]", ylabel="force [N]", xlim=0, ylim=0)
    right.plot(REPORT[STRENGTH], 1e3 * REPORT[GAP], "k+", ms=12, label="report")
    right.set(xlabel="strength [MPa]", ylabel="critical gap [um]", title="95 % of measurements")
    for ax in (left, right):
        ax.legend()
    head = ("from", "parameter", "report", "fit", "standard error [%]", "95 % in")
    text = markdown(head, lines)
    report(out, "measured_pushout", text, figure)
    return found


if __name__ == "__main__":
    run(main)
