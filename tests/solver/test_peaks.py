"""Peaks and onsets have rows, whatever the number of load steps."""

from __future__ import annotations

import numpy as np
import pytest
from support import bar
from support.bar import STRENGTH
from weak_links import bundle

import vmdg
from vmdg.solver.peak import Place, vertex

LAWS = {
    "ductile": vmdg.Debonding(STRENGTH, 0.1),
    "nearly snaps": vmdg.Debonding(STRENGTH, 0.041),
    "snaps": vmdg.Debonding(STRENGTH, 0.01),
    "exponential": vmdg.ExponentialDebonding(STRENGTH, 10.0),
    "plateau": vmdg.TrapezoidalDebonding(STRENGTH, 0.001, 0.1),
}


@pytest.mark.parametrize("name", LAWS)
def test_peak_of_a_bar(comm, name):
    """The force of a bar is largest at its strength, in any load steps, dead or prescribed."""
    rng = np.random.default_rng(sorted(LAWS).index(name))
    for steps in (1, 7, int(rng.integers(2, 40))):
        problem = bar.with_law(comm, LAWS[name], "small")
        ends = np.sort(rng.uniform(0.0, 0.15, steps - 1)).tolist()
        right = lambda x: np.isclose(x[0], 2.0)  # noqa: E731
        look = lambda p, right=right: {"force [N]": p.reaction(right)[0]}  # noqa: E731
        history = vmdg.solve(problem, [*ends, 0.15], monitor=look).history
        assert history.peak("force") == pytest.approx(STRENGTH, rel=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_peak_of_a_bundle(comm, seed):
    """Of brittle and of ductile bars the force is largest where one of them begins to fail."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 6))
    strengths = rng.uniform(3.0, 10.0, count)
    gaps = 2 * strengths / 1000 * rng.choice([0.3, 3.0], count)
    problem, look = bundle(
        comm, strengths, lambda x: gaps[np.floor(x[1] / 0.1).astype(int)], unloading="secant"
    )
    # Stress of unbroken bars at the onsets of all bars.
    steps = int(rng.integers(1, 25))
    loads = np.sort(np.append(rng.uniform(0.0, 1.1, steps), 1.1))
    history = vmdg.solve(problem, loads, monitor=look).history

    def carried(stress: float) -> float:
        soft = strengths * (1 - (stress - strengths) / (500 * gaps - strengths) * 1.0)
        soft = np.where(500 * gaps > strengths, np.maximum(soft, 0.0), 0.0)
        return np.where(stress <= strengths, stress, soft).sum()

    assert history.peak("force") == pytest.approx(max(map(carried, strengths)), rel=1e-5)


def test_derivatives_at_a_peak(comm):
    """The peak is the strength, whatever E is; its row moves with the onset."""
    problem = bar.with_law(comm, LAWS["ductile"], "small")
    right = lambda x: np.isclose(x[0], 2.0)  # noqa: E731
    look = lambda p: {"force [N]": p.reaction(right)[0]}  # noqa: E731
    names = ["Debonding.strength", "NeoHookean.E"]
    history = vmdg.solve(problem, [0.02, 0.05, 0.15], monitor=look, derivatives=names).history
    row = int(np.argmax(history["force"]))
    assert history["load"][row] not in (0.02, 0.05, 0.15)
    assert history["d force/d Debonding.strength"][row] == pytest.approx(1.0, rel=1e-6)
    # By a factor on both E.
    assert history["d force/d NeoHookean.E"][row] == pytest.approx(0.0, abs=1e-6 * STRENGTH)
    assert np.isin([0.02, 0.05, 0.15], history["load"]).all()


def test_vertex():
    """That of a parabola, exactly; without a maximum the last state."""
    for sign, expected in ((-1, Place(1.3, 7.0)), (1, Place(3.0, 7 + 1.7**2))):
        three = [Place(x, 7 + sign * (x - 1.3) ** 2) for x in (0.0, 1.0, 3.0)]
        assert vertex(three) == pytest.approx(expected, rel=1e-14)
