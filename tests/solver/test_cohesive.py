"""Laws through the solver: secant unloading under pressure with friction, and a plateau."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from support import bar
from support.scenes import LEFT, RIGHT, two_blocks

import vmdg

MU, PRESSURE = 0.5, 20.0
P_S, G_S = 60.0, 0.9
ZETA_S = 2 * G_S / P_S


def rubbed_way(corners):
    """Integral of d over a slip to and fro, both in units of ZETA_S."""
    total = d = 0.0
    for start, end in pairwise(corners):
        way, room = abs(end - start), d - start * np.sign(end - start)
        beyond = max(way - room, 0.0)
        total += d * (way - beyond) + ((d + beyond) ** 2 - d**2) / 2
        d += beyond
    return total


def test_pressed_blocks_that_slide_to_and_fro(comm):
    """T_T = K zeta + d mu p along the slip, d that of the largest slip; works by the areas.

    Both ends are clamped, so that there is no moment at the interface in the middle and all of its
    points are alike.
    """
    law = vmdg.MixedModeDebonding(
        *(40.0, P_S, 0.4, G_S, MU), criterion="BK", exponent=2.0, unloading="secant"
    )
    scene, E = two_blocks(comm, "quadrilateral"), 1e6
    body = vmdg.NeoHookean(E=E, nu=0.0)
    interface = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(
        scene.mesh, scene.cell_tags, {1: body, 2: body}, [interface], kinematics="small"
    )

    def moved(t):
        way = ZETA_S * np.interp(t, [1, 2, 3, 4], [0.0, 0.8, -0.5, 1.0])
        return [-2 * PRESSURE / E * min(t, 1.0), way]

    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0)
    problem.dirichlet(scene.facet_tags.find(RIGHT), moved)

    def monitor(problem):
        mean = problem.mean(interface)
        return {"pressure": -mean.traction[0], "shear": mean.traction[1], "slip": mean.gap[1]}

    loads = np.arange(10, 41) / 10
    history = vmdg.solve(problem, loads, monitor=monitor).history
    slip, shear = history["slip"] / ZETA_S, history["shear"]
    assert history["pressure"] == pytest.approx(PRESSURE, rel=1e-6)
    d = np.maximum.accumulate(np.abs(slip))
    slides = np.append(False, np.abs(np.diff(slip)) > 1e-6)
    assert slides.sum() > 20
    rubbed = d * MU * PRESSURE * np.sign(np.diff(slip, prepend=0.0))
    spring = (1 - d[slides]) / d[slides] * slip[slides] * P_S
    assert shear[slides] == pytest.approx(spring + rubbed[slides], rel=1e-6)

    out, back, last = (slip[history["load"].tolist().index(t)] for t in (2.0, 3.0, 4.0))
    assert 0.6 < out < last < 1
    assert back < -0.1
    energy = problem.energy()
    assert energy.damage == pytest.approx(G_S * last, rel=1e-6)
    way = rubbed_way([0.0, out, back, last])
    assert energy.friction == pytest.approx(MU * PRESSURE * ZETA_S * way, rel=1e-6)


@pytest.mark.parametrize("unloading", ["plastic", "secant"])
def test_plateau_of_a_bar(comm, unloading):
    """P_c while the gap is on the plateau, then down to zero; the snap is traced."""
    law = vmdg.TrapezoidalDebonding(bar.STRENGTH, 0.008, 0.02, unloading=unloading)
    problem = bar.with_law(comm, law, "small")
    options = vmdg.SolveOptions(relative_tolerance=1e-11, unstable="trace", max_share=0.05)
    history = vmdg.solve(problem, bar.LOADS, options, bar.means).history
    gap, traction = history["gap"], history["traction"]
    level, falls = (gap > 0) & (gap < 0.008), (gap > 0.008) & (gap < 0.02)
    assert level.sum() > 2
    assert falls.sum() > 2
    assert traction[level] == pytest.approx(bar.STRENGTH, rel=1e-9)
    assert traction[falls] == pytest.approx(bar.STRENGTH * (0.02 - gap[falls]) / 0.012, abs=1e-6)
    assert problem.energy().damage == pytest.approx(bar.STRENGTH * 0.014, rel=1e-4)
