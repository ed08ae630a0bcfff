"""Warnings before a run: each where it is true, once, and not where it is not."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from itertools import product

from mpi4py import MPI

import numpy as np
import pytest
from support.problems import of_two
from support.scenes import box

import vmdg
from vmdg.checks.model import check_model
from vmdg.meshes import blocks

BODY = vmdg.NeoHookean(E=1e3, nu=0.2)


def told(problem: vmdg.Problem, loads=(0.5, 1.0)) -> list[str]:
    """What rank 0 is warned of before a run."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_model(problem, np.array(loads))
    return [str(warning.message) for warning in caught]


def expect(problem: vmdg.Problem, *words: str, **options) -> str:
    """The one warning, with these words; the other ranks are quiet."""
    found = told(problem, **options)
    assert len(found) == (problem.comm.rank == 0)
    assert all(word in message for word, message in product(words, found))
    return "".join(found)


# Loads that only bonds bear


def wall(comm: MPI.Comm, dim: int, law: vmdg.Law, load: Callable) -> vmdg.Problem:
    """Bricks of 2 x 1 mm in four rows of a running bond, whose lowest faces are held."""

    def brick(x):
        row = np.floor(x[1])
        return 10 * row + np.floor((x[0] + row % 2) / 2)

    mesh, tags = box(comm, [(0, 0, 0)[:dim], (6, 4, 1)[:dim]], (12, 8, 1)[:dim], brick)
    values = tags.values
    names = np.unique(np.concatenate(comm.allgather(np.unique(values))))
    problem = vmdg.Problem(
        mesh,
        tags,
        dict.fromkeys(names.tolist(), BODY),
        [vmdg.Interface(between="all", law=law)],
        kinematics="small",
    )
    problem.dirichlet(lambda x: np.isclose(x[1], 0), 0.0)
    load(problem, lambda along, up: np.array([along, up, 0.0])[:dim])
    return problem


def top(x: np.ndarray) -> np.ndarray:
    return np.isclose(x[1], 4)


MORTAR = vmdg.Debonding(strength=1.0, critical_gap=0.1, friction=0.5)
STANDS = {
    "pressed": lambda p, f: p.traction(top, lambda t: f(0, -t)),
    "under its weight": lambda p, f: p.body_force(lambda t: f(0, -1e-3 * t)),
    "under a pressure": lambda p, f: p.pressure(top, lambda t: t),
    "pushed a little": lambda p, f: p.traction(top, lambda t: f(0.2 * t, -t)),
}
FALLS = {
    "lifted": (lambda p, f: p.traction(top, lambda t: f(0, t)), "4 bodies of tags 30, 31, 32, 33"),
    "lifted at a corner": (
        lambda p, f: p.traction(lambda x: top(x) & (x[0] < 1.01), lambda t: f(0, t)),
        "the body of tag 30 carries a load",
    ),
    "pushed": (lambda p, f: p.traction(top, lambda t: f(0.7 * t, -t)), "bodies of tags 3"),
}


@pytest.mark.parametrize(("dim", "load"), [(3, "pressed"), *product((2,), STANDS)])
def test_wall_that_stands(comm, dim, load):
    """Bricks that are pressed on each other need no bond: nothing to warn of."""
    assert not told(wall(comm, dim, MORTAR, STANDS[load]))


@pytest.mark.parametrize(("dim", "load"), [(3, "pushed"), *product((2,), FALLS)])
def test_wall_that_falls(comm, dim, load):
    """One warning for all bricks that come free, and for no others."""
    lift, words = FALLS[load]
    expect(wall(comm, dim, MORTAR, lift), words, "only bonds constrain", "no step will converge")


def test_wall_without_mortar(comm):
    """So do bricks that nothing but contact holds."""
    dry = wall(comm, 2, vmdg.Contact(friction=0.5), STANDS["under its weight"])
    expect(dry, "only contact constrains 11 bodies of tags 10, 11, 12, 13, 20, 21, 22, 30, ...")


def test_softening_far_above_the_bodies(comm):
    """One warning, with the digits that it costs."""
    tagged = blocks(comm, "quadrilateral", (2, 2, 2))
    law = vmdg.Debonding(strength=100.0, critical_gap=1e-9)
    problem = of_two(tagged, law, (BODY,) * 2)
    problem.dirichlet(tagged.facet_tags.find("left"), 0.0)
    problem.dirichlet(tagged.facet_tags.find("right"), lambda t: [1e-4 * t, 0.0])
    expect(problem, "H = 1e+11 MPa/mm is far above", "Tractions lose 7 of their 16 digits")


# Loads


def moved(comm: MPI.Comm, value, law=MORTAR, **options) -> vmdg.Problem:
    """Two blocks of which one is held and one is moved by a value along x."""
    tagged = blocks(comm, "quadrilateral", (2, 2, 2))
    problem = of_two(tagged, law, (BODY,) * 2, {"name": "bond"}, kinematics="small", **options)
    problem.dirichlet(tagged.facet_tags.find("left"), 0.0)
    problem.dirichlet(tagged.facet_tags.find("right"), value, "x")
    problem.dirichlet(tagged.facet_tags.find("right"), 0.0, "y")
    return problem


def test_nothing_loaded(comm):
    """Zero is what is asked for, and what comes out; unless it is where a state comes back to."""
    expect(moved(comm, 0.0), "there is no load", "lambda t: 0.1 * t")
    expect(moved(comm, lambda t: 0.0 * t), "there is no load", loads=[1.0])
    problem = moved(comm, lambda t: 1e-3 * t)
    vmdg.solve(problem, [1.0])
    assert not told(problem, loads=[0.0])


def test_load_factors_that_a_run_does_not_come_to(comm):
    """A function that fails there, on one rank, ends no run before, and nothing is said of loads
    of which not all are known."""

    def move(t: float) -> float:
        if t == 0.5 and comm.rank == comm.size - 1:
            raise ZeroDivisionError("no such time")
        return 0.0

    problem = moved(comm, move)
    loads = [0.25, 0.5, 1.0]
    assert len(vmdg.solve(problem, loads, until=lambda problem: True).history) == 1
    with pytest.raises(ZeroDivisionError, match="no such time"):
        vmdg.solve(problem, loads)
    assert problem.t == 0.25


def test_no_load_that_changes(comm):
    """The same row again and again; one of them is a problem as any other."""
    expect(moved(comm, 1e-3), "no load depends on the load factor: all 2 steps end in the same")
    assert not told(moved(comm, 1e-3), loads=[1.0])
    assert not told(moved(comm, lambda t: 1e-3 * min(t, 0.5)))
    assert not told(moved(comm, 1e-3), loads=[1.0, 1.0])
    assert not told(moved(comm, 1e-3, eigenstrain={1: lambda t: 1e-4 * t}))
    # Equal at all load factors that are given, not between them.
    assert not told(moved(comm, lambda t: 1e-3 * np.sin(2 * np.pi * t)), loads=[1.0, 2.0, 3.0])


def test_what_changes_by_itself(comm):
    """By time, by cycles, by a fluid that spreads: constant loads are right."""
    slow = vmdg.Debonding(strength=1.0, critical_gap=0.1, viscosity=1.0)
    worn = vmdg.FatigueDebonding(1.0, 1.0, 0.05, 0.05)
    assert not told(moved(comm, 1e-3, law=slow))
    assert not told(moved(comm, 1e-3, law=worn))
    cracked = moved(comm, 1e-3)
    cracked.pressure("bond", 0.1, debonded=True)
    assert not told(cracked)
