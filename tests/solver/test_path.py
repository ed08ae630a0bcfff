"""The equilibrium path: softening, snap-backs and limit points of the bar of 7.1.1."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from support import bar
from support.bar import LOADS, STRENGTH
from support.budgets import over_budget
from support.scenes import box

import vmdg
from vmdg.meshes import blocks

SHARP = {"relative_tolerance": 1e-11, "energy": True}


def traced(problem: vmdg.Problem, loads=LOADS, **options) -> vmdg.Result:
    """The path of a bar, every snap-back followed."""
    chosen = vmdg.SolveOptions(**{"unstable": "trace"} | SHARP | options)
    return vmdg.solve(problem, loads, chosen, bar.means)


def misses(history: vmdg.History, critical_gap: float, kinematics: str) -> np.ndarray:
    """What every row is off the closed form [mm], tractions relative to the strength."""
    found = []
    for t, T, gap in zip(history["load"], history["traction"], history["gap"], strict=True):
        if gap >= critical_gap:
            found.append(max(abs(T) / STRENGTH, abs(gap - t)))
            continue
        expected = T if gap == 0 else STRENGTH * (1 - gap / critical_gap)
        end = 2 * (bar.stretch(expected, kinematics) - 1) + gap
        found.append(max(abs(T - expected) / STRENGTH, abs(end - t)))
    return np.array(found)


@pytest.mark.parametrize(
    ("critical_gap", "kinematics"),
    [(0.041, "small"), (0.02, "finite"), (0.005, "finite"), (0.005, "small")],
)
def test_snap_back_is_traced(comm, critical_gap, kinematics):
    """Every row on the closed form, within the budget; what the load does is stored or spent."""
    result = traced(bar.build(comm, critical_gap, kinematics))
    history = result.history
    assert misses(history, critical_gap, kinematics).max() < 1e-8
    assert history["spread"].max() < 1e-8
    assert not over_budget("bar that snaps back", result)
    assert not history["jump_steps"].any()
    assert set(LOADS) <= set(history["load"])
    if critical_gap < 0.04:
        peak = history["load"][history["load"] < LOADS[18]].max()
        assert peak == pytest.approx(2 * (bar.stretch(STRENGTH, kinematics) - 1), rel=1e-6)
        assert history["load"].tolist() != sorted(history["load"])
    spent = history["damage"] + history["bulk"] + history["interface"]
    elastic, softening = history["gap"] == 0, (history["gap"] > 0) & (history["traction"] > 1e-6)
    work = [bar.elastic_energy(T, kinematics) for T in history["traction"][elastic]]
    assert spent[elastic] == pytest.approx(work, abs=1e-8)
    for T, gap, energy in zip(
        history["traction"][softening], history["gap"][softening], spent[softening], strict=True
    ):
        bond = quad(lambda z: STRENGTH * (1 - z / critical_gap), 0.0, gap)[0]
        assert energy == pytest.approx(bar.elastic_energy(T, kinematics) + bond, abs=1e-8)
    assert spent[-1] == pytest.approx(STRENGTH * critical_gap / 2, abs=1e-8)
    assert np.abs(history["imbalance"]).max() < 1e-6 * history["external"].max()


@pytest.mark.filterwarnings("ignore::vmdg.ModelWarning")
@pytest.mark.parametrize("kinematics", [pytest.param("finite", marks=pytest.mark.long), "small"])
def test_force_control_past_the_peak(comm, kinematics):
    """Under a dead load the load factor is the traction: it rises to the strength and falls.

    Once the bond is gone there is no equilibrium: the run ends. Rows are compared until less than
    .01% of the bond is left, 1% of its strength: points may go one after the other then.
    """
    problem = bar.build(comm, 0.2, kinematics, dead=True)
    with pytest.raises(vmdg.StepFailure) as failure:
        traced(problem, [25.0, 50.0, 75.0, 99.0, 101.0])
    history = failure.value.result.history
    peak = history["load"].argmax()
    assert history["load"][peak] == pytest.approx(STRENGTH, rel=1e-6)
    assert (np.diff(history["load"][: peak + 1]) > 0).all()
    softens = history["gap"] > 0
    softens &= (history["load"] > 0.01 * STRENGTH) & (history["gap"] < 0.2)
    load, gap, traction = (history[name][softens] for name in ("load", "gap", "traction"))
    assert (np.diff(load) < 0).all()
    assert load[-1] < 0.5 * STRENGTH
    assert traction == pytest.approx(load, abs=1e-8 * STRENGTH)
    assert traction == pytest.approx(STRENGTH * (1 - gap / 0.2), abs=1e-8 * STRENGTH)


def test_given_load_factors(comm):
    """All are rows, in their order, each where the path passes it for the first time."""
    loads = [0.01, 0.03, 0.0379, 0.039, 0.05]
    history = traced(bar.build(comm, 0.02), loads).history
    places = [history["load"].tolist().index(load) for load in loads]
    assert places == sorted(places)
    assert history["gap"][places[2]] == 0
    assert (history["load"][: places[3]] < 0.039).all()


def test_energy_is_not_known_beyond_rounding(comm):
    """A bond so weak that rounding of what the blocks store is as much as it takes to break."""
    problem = bar.with_law(comm, vmdg.Debonding(2.4e-4, 1.1e-7))
    loads = 5e-7 * np.arange(1, 12) / 11
    result = vmdg.solve(problem, loads, monitor=bar.means)
    assert np.isin(loads, result.history["load"]).all()
    assert not result.failures
    assert abs(result.history["traction"][-1]) < 1e-6 * 2.4e-4


def test_load_control_never_follows(comm):
    """Rows at the given load factors only, or an error."""
    history = traced(bar.build(comm, 0.2), np.linspace(0.02, 0.22, 11), control="load").history
    assert np.array_equal(history["load"], np.linspace(0.02, 0.22, 11))
    with pytest.raises(vmdg.StepFailure):
        traced(bar.build(comm, 0.01), control="load", max_cuts=2)


def test_programme_that_is_not_straight(comm):
    """Loads that are not linear between two given load factors go by these."""
    mesh, cells, facets = blocks(comm, "quadrilateral", (2, 2))
    material = vmdg.NeoHookean(E=bar.E, nu=bar.NU)
    law = vmdg.Debonding(strength=STRENGTH, critical_gap=0.2)
    problem = vmdg.Problem(
        mesh, cells, {1: material, 2: material}, [vmdg.Interface(between=(1, 2), law=law)]
    )
    problem.dirichlet(facets.find(1), 0.0, "x")
    problem.dirichlet(facets.find(2), lambda t: 0.06 * np.sin(t), "x")
    problem.dirichlet(facets.find(5), 0.0, "y")
    loads = np.linspace(0.3, 6.0, 20)
    history = traced(problem, loads, control="dissipation").history
    assert np.array_equal(history["load"], loads)


# Rays


def loaded(comm, value, dead=None, eigenstrain=None) -> vmdg.Problem:
    """The bar with a displacement and a traction of the load factor."""
    mesh, cells, facets = blocks(comm, "quadrilateral")
    material = vmdg.NeoHookean(E=bar.E, nu=bar.NU)
    interface = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
    given = {} if eigenstrain is None else {"eigenstrain": {1: eigenstrain}}
    problem = vmdg.Problem(mesh, cells, {1: material, 2: material}, [interface], **given)
    problem.dirichlet(facets.find(1), 0.0)
    problem.dirichlet(facets.find(2), value, "y")
    if dead is not None:
        problem.traction(facets.find(2), dead)
    return problem


@pytest.mark.parametrize(
    ("value", "dead", "eigenstrain", "straight"),
    [
        (lambda t: 0.1 * t, None, None, True),
        (0.0, lambda t: (t, 0.0), None, True),
        (lambda t: 0.1 + 0.2 * t, lambda t: (1 - t, 0.0), None, True),
        (lambda t: 0.1 * t, None, lambda t: 0.01, True),
        (lambda t: 0.1 * t, None, lambda t: 0.01 * t, True),
        (lambda t: 0.1 * t, None, lambda t: 0.01 * t**2, False),
        (lambda t: t**2, None, None, False),
        (lambda t: min(t, 0.4), None, None, False),
        (lambda t: t, lambda t: (np.sin(t), 0.0), None, False),
        (0.0, None, None, False),
    ],
)
def test_rays(comm, value, dead, eigenstrain, straight):
    """Loads that are linear in the load factor and change; what they are and their rates."""
    loading = loaded(comm, value, dead, eigenstrain).loading
    assert loading.set_ray(0.0, 1.0) == straight
    assert (loading.ray is not None) == straight
    if straight:
        expected = loading.dirichlet.values(0.3)
        assert loading.prescribed_values(0.3) == pytest.approx(expected, abs=1e-14)
    loading.clear_ray()
    assert loading.ray is None
    assert not loading.set_ray(0.5, 0.5)


def test_a_ray_leaves_the_programme(comm):
    """Held before t = 0 and pulled behind: the ray of t = 0 to 1 has no loads for t < 0."""
    loading = loaded(comm, lambda t: 0.1 * max(t, 0.0), None, None).loading
    assert loading.set_ray(0.0, 1.0)
    assert all(loading.as_given(t) for t in (0.0, 0.3, 2.0))
    assert not loading.as_given(-0.3)


def test_until(comm):
    """A dead load that never comes back to its peak ends where the user says, in a state of the
    path."""
    problem = bar.build(comm, 0.1, dead=True)
    options = vmdg.SolveOptions(unstable="trace", **SHARP)
    result = vmdg.solve(
        problem,
        [2 * STRENGTH],
        options,
        bar.means,
        until=lambda problem: problem.mean(0).gap[0] > 0.05,
    )
    history = result.history
    assert 0.05 < history["gap"][-1] < 0.1
    assert (history["gap"][:-1] <= 0.05).all()
    assert history["load"].max() <= STRENGTH * (1 + 1e-9)
    assert problem.t == history["load"][-1]


def test_max_share(comm):
    """Steps of the path break no more than the user allows: more rows, the same path."""
    coarse, fine = (
        traced(bar.build(comm, 0.02), [0.06], max_share=share).history for share in (0.1, 0.02)
    )
    softening = [np.diff(h["damage"])[h["gap"][:-1] > 0] for h in (coarse, fine)]
    total = STRENGTH * 0.02 / 2
    assert softening[0].max() > 0.05 * total
    assert softening[1].max() <= 0.02 * total * (1 + 1e-6)
    assert misses(fine, 0.02, "finite").max() < 1e-8


def test_a_wall_that_slides(comm):
    """Bricks whose mortar goes while they slide: it bears the pressure times the friction then.

    Two courses come loose at a time, and no work on bonds nor way leads on: steps by load do.
    """
    width, height, courses, friction, weight = 200.0, 100.0, 3, 0.7, 20e3
    corner = (2 * width, courses * height)

    def brick(x):
        course = x[1] // height
        return 10 * course + (x[0] + course % 2 * width / 2) // width

    mesh, tags = box(comm, [(0, 0), corner], (8, 2 * courses), brick)
    mortar = vmdg.Debonding(0.3, 0.1, friction=friction, gradual_friction=True)
    brick = vmdg.NeoHookean(E=15e3, nu=0.2)
    numbers = set().union(*comm.allgather(tags.values.tolist()))
    joints = vmdg.Interface(between="all", law=mortar)
    problem = vmdg.Problem(
        mesh, tags, dict.fromkeys(numbers, brick), [joints], kinematics="small", thickness=100.0
    )

    def top(x: np.ndarray) -> np.ndarray:
        return np.isclose(x[1], corner[1])

    problem.dirichlet(lambda x: np.isclose(x[1], 0), 0.0)
    problem.dirichlet(top, lambda t: max(t - 1, 0.0), "x")
    problem.rigid_face(top, "y", force=lambda t: -weight * min(t, 1.0))
    loads = [0.5, 1.0, *np.linspace(1.05, 1.3, 6)]
    history = vmdg.solve(problem, loads, monitor=lambda p: {"shear": p.reaction(top)[0]}).history
    assert history["shear"][-1] == pytest.approx(friction * weight, rel=1e-9)
