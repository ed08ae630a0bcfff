"""Runs with two random features are resumed at a random load factor: equal to the last bit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from support.problems import joined
from support.scenes import pairs_of_features, two_blocks

import vmdg

#: Largest difference of a column on several ranks, where sums are made in any order.
SAME = 1e-8
LOADS = np.linspace(0.02, 0.16, 8)
STRONG = {"strength": 40.0, "critical_gap": 0.12}
BODY = vmdg.NeoHookean(E=1000.0, nu=0.3)
LAWS = {
    "friction": vmdg.Debonding(**STRONG, friction=0.4),
    "exponential": vmdg.ExponentialDebonding(strength=40.0, fracture_energy=2.4),
    "trapezoidal": vmdg.TrapezoidalDebonding(**STRONG, plateau_gap=0.03),
    "viscous": vmdg.Debonding(**STRONG, viscosity=2.0),
    "rough": vmdg.Debonding(strength=lambda x: 30.0 + 20.0 * x[1], critical_gap=0.12),
    "worn": vmdg.FatigueDebonding(40.0, 40.0, 2.4, 2.4),
    "random": vmdg.Debonding(vmdg.Weibull(40.0, 8.0, seed=3), 0.12, 0.3),
}

#: What a run may have: arguments of the problem, of the interface, of the options, or loads.
FEATURES: Mapping[str, Mapping[str, Any]] = {
    **{name: {"law": law} for name, law in LAWS.items()},
    "metal": {"materials": (vmdg.J2(1000.0, 0.3, 30.0, hardening=100.0), BODY)},
    "soil": {"materials": (BODY, vmdg.DruckerPrager(1000.0, 0.3, 25.0, 20.0, hardening=80.0))},
    "fading": {
        "materials": (BODY, vmdg.J2(1000.0, 0.3, 20.0, kinematic=2000.0, recovery=100.0)),
        "problem": {"kinematics": "small"},
    },
    "creeping": {
        "materials": (BODY, vmdg.Viscoelastic(1000.0, 0.3, [(0.5, 0.05)], shift=lambda t: 1 + t)),
        "options": {"duration": 1.0},
    },
    "small": {"problem": {"kinematics": "small"}},
    "degree 2": {"problem": {"degree": 2}},
    "mean dilatation": {"problem": {"volumetric": "mean"}},
    "swelling": {"problem": {"eigenstrain": {2: lambda t: 0.05 * t}}},
    "thickness": {"problem": {"thickness": 2.5}},
    "of revolution": {"problem": {"symmetry": "axisymmetric"}},
    "plane stress": {"problem": {"plane": "stress"}},
    "thickness that is free": {"problem": {"plane": "generalized strain"}},
    "half broken": {"interface": {"initial_damage": lambda x: 1.0 * (x[1] < 0.5)}},
    "reference frame": {"interface": {"frame": "reference"}},
    "cracks anywhere": {"interface": {"between": None, "within": 2, "activate": "on-demand"}},
    "by dissipation": {"options": {"control": "dissipation"}},
    "traced": {"options": {"unstable": "trace"}},
    "fluid": {"load": lambda p, bond: p.pressure(bond, lambda t: 60 * t, debonded=True)},
    "fluid by width": {
        "load": lambda p, bond: p.pressure(
            bond, lambda t: 60 * t, debonded=True, share=lambda g: np.clip(g / 0.05, 0, 1)
        )
    },
    "springs": {"load": lambda p, _: p.spring(side(1), 80.0)},
    "traction": {"load": lambda p, _: p.traction(side(1), lambda t: (0.0, -20.0 * t))},
    "body force": {"load": lambda p, _: p.body_force(lambda t: (0.0, -30.0 * t))},
    "later support": {"later": lambda p: p.dirichlet(side(1), lambda t: 0.1 * t, "y", True)},
}


def side(y: float):
    return lambda x: np.isclose(x[1], y) & (x[0] > 1 + 1e-9)


#: Features that exclude each other, one of each row with any other of it.
PLANES = ("of revolution", "plane stress", "thickness that is free")
EXCLUDE = [
    {*LAWS},
    {*PLANES},
    {"fluid", "fluid by width"},
    {"small", "metal", "soil", "fading", "creeping"},
    *({"fading", other} for other in ("reference frame", "of revolution")),
    {"later support", "cracks anywhere"},
    *({"worn", by} for by in ("by dissipation", "traced")),
    *({"mean dilatation", other} for other in ("degree 2", *PLANES[1:])),
    *({fluid, plane} for fluid in ("fluid", "fluid by width") for plane in PLANES[1:]),
    {"of revolution", "thickness"},
]


def build(comm: MPI.Comm, pair: tuple[str, str], later: bool) -> vmdg.Problem:
    given: dict[str, Any] = {"law": LAWS["friction"], "problem": {}, "interface": {}}
    given["materials"] = vmdg.NeoHookean(E=4000.0, nu=0.25), BODY
    loads = []
    for name in pair:
        feature = FEATURES[name]
        given |= {kind: feature[kind] for kind in ("law", "materials") if kind in feature}
        for kind in ("problem", "interface"):
            given[kind] = given[kind] | feature.get(kind, {})
        loads += [feature["load"]] if "load" in feature else []
    scene = two_blocks(comm, "quadrilateral", n=2)
    turning = {"frame": "corotating"} | given["interface"]
    problem = joined(scene, given["law"], given["materials"], turning, **given["problem"])
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(scene.facet_tags.find(2), lambda t: t, "x")
    problem.dirichlet(scene.facet_tags.find(2), lambda t: 0.3 * t, "y")
    for load in loads:
        load(problem, problem.interfaces[0])
    if later:
        support(problem, pair)
    return problem


def support(problem: vmdg.Problem, pair: tuple[str, str]) -> None:
    for name in pair:
        FEATURES[name].get("later", lambda _: None)(problem)


def run(problem: vmdg.Problem, pair: tuple[str, str], loads, history=None, **options):
    """Solve with the options of the features; energies, forces and state in the table."""
    for name in pair:
        options |= FEATURES[name].get("options", {})
    if "worn" in pair:
        options["cycles"] = 1e3

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        held = problem.reaction(lambda x: np.isclose(x[0], 0))
        return {"x": held[0], "y": held[1], "softening": problem.mean(0).softening}

    given = vmdg.SolveOptions(relative_tolerance=1e-10, energy=True, **options)
    return vmdg.solve(problem, loads, given, monitor, history).history


@pytest.mark.filterwarnings("ignore::vmdg.ModelWarning")
@pytest.mark.parametrize("pair", pairs_of_features(FEATURES, EXCLUDE), ids=" and ".join)
def test_resumed(comm: MPI.Comm, out: Path, pair: tuple[str, str]) -> None:
    """The checkpoint of a random load factor, read by another problem, leads to the same rows."""
    random = np.random.default_rng(sum(map(ord, "".join(pair))))
    first, last = sorted(random.choice(np.arange(1, len(LOADS)), 2, replace=False))
    try:
        problem = build(comm, pair, later=False)
        history = run(problem, pair, LOADS[:first])
        support(problem, pair)
        history = run(problem, pair, LOADS[first:last], history, checkpoint=out)
        written = len(history)
        history = run(problem, pair, LOADS[last:], history)
    except vmdg.StepFailure as failure:
        pytest.skip(f"no equilibrium: {failure}")
    resumed = build(comm, pair, later=True)
    again = vmdg.read_checkpoint(resumed, out)
    assert len(again) == written
    again = run(resumed, pair, LOADS[last:], again)
    assert len(again) == len(history) > written
    assert history["softening"][-1] > 0, "nothing broke"
    for column in history.columns:
        expected, found = history[column], again[column]
        size = 0.0 if comm.size == 1 else SAME * max(np.abs(expected).max(), 1e-12)
        if column in ("residual", "iterations", "krylov", "jump_steps") and comm.size > 1:
            continue
        assert np.abs(found - expected).max() <= size, (column, first, last)
