"""Bonds that are damaged at the start, and cracks that are there already."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
from dolfinx.mesh import (
    compute_midpoints,
    locate_entities,
)
from support.checks import by_position
from support.scenes import box

import vmdg

LENGTH, CRACK, STRENGTH, FRICTION = 8.0, 3.0, 5.0, 0.4
#: Opened, then pressed together and sheared: (opening, shift) of the upper arm's left end [mm].
PROGRAMME = np.array([[0.0, 0.0], [0.1, 0.0], [0.16, 0.0], [-0.01, 0.02], [-0.02, 0.05]])


def law(unloading: str = "plastic") -> vmdg.Law:
    return vmdg.Debonding(
        STRENGTH, 0.05, FRICTION, unloading=unloading, gradual_friction=unloading == "secant"
    )


def cracked(x) -> np.ndarray:
    return np.where(x[0] < CRACK, 1.0, 0.0)


def rectangle(comm):
    return box(comm, [[0, -1], [LENGTH, 1]], [16, 4], lambda x: 1 + (x[1] > 0))


def middle(mesh, begin: float, end: float) -> np.ndarray:
    def inside(x):
        return np.isclose(x[1], 0) & (x[0] > begin - 1e-9) & (x[0] < end + 1e-9)

    return locate_entities(mesh, 1, inside)


def beams(comm, interfaces, mesh=None, tags=None) -> vmdg.Problem:
    """Two arms, held at the right end, led at the left end of the upper one."""
    if mesh is None:
        mesh, tags = rectangle(comm)
    material = vmdg.NeoHookean(E=1e3, nu=0.3)
    problem = vmdg.Problem(mesh, tags, {1: material, 2: material}, interfaces, kinematics="small")
    problem.dirichlet(lambda x: np.isclose(x[0], LENGTH), 0.0)
    problem.dirichlet(lambda x: np.isclose(x[0], 0) & (x[1] < 1e-9), 0.0)
    times = np.arange(len(PROGRAMME), dtype=float)

    def led(t, i):
        return float(np.interp(t, times, PROGRAMME[:, i]))

    top = (lambda x: np.isclose(x[0], 0) & (x[1] > -1e-9),)
    problem.dirichlet(*top, lambda t: led(t, 0), "y")
    problem.dirichlet(*top, lambda t: led(t, 1), "x")
    return problem


def forces(problem: vmdg.Problem) -> dict[str, float]:
    reaction = problem.reaction(lambda x: np.isclose(x[0], 0) & (x[1] > -1e-9))
    return {"x": reaction[0], "y": reaction[1]}


def run(problem: vmdg.Problem, loads=(0.5, 1.0, 2.0, 2.5, 3.0, 3.5, 4.0), **options):
    chosen = vmdg.SolveOptions(relative_tolerance=1e-11, energy=True, **options)
    return vmdg.solve(problem, list(loads), chosen, forces).history


@pytest.mark.parametrize("unloading", [pytest.param("plastic", marks=pytest.mark.long), "secant"])
def test_crack_that_is_there_already_is_contact(comm, unloading):
    """Equal to a crack with Contact(), opened, closed, pressed and rubbed.

    On the way no load is a limit point: a step that is too far for Newton's method is no snap.
    """
    bond = law(unloading)
    damaged = vmdg.Interface(between=(1, 2), law=bond, initial_damage=cracked, safety=4.0)
    mesh, tags = rectangle(comm)
    parts = [
        vmdg.Interface(middle(mesh, 0, CRACK), law=vmdg.Contact(FRICTION), safety=4.0),
        vmdg.Interface(middle(mesh, CRACK, LENGTH), law=bond, safety=4.0),
    ]
    one, two = run(beams(comm, [damaged])), run(beams(comm, parts, mesh, tags))
    # Both name the modes of a point that closes differently, and so take its friction by other
    # parts of the step: equal to what the balance misses.
    missed = max(np.abs(h["imbalance"]).max() for h in (one, two))
    for column in ("x", "y", "damage", "friction", "bulk"):
        scale = np.abs(two[column]).max()
        ends = [np.interp(range(1, 5), h["load"], h[column]) for h in (one, two)]
        most = missed if column == "friction" else 1e-7 * scale
        np.testing.assert_allclose(*ends, atol=most, err_msg=column)
    assert missed < 0.02 * one["external"].max()
    assert one["friction"][-1] > 0
    assert one["jump_steps"].sum() == two["jump_steps"].sum() == 0


def test_number_array_and_function_say_the_same(comm):
    """Per facet, whichever rank knows it; Q is that share of the strength."""
    mesh, tags = rectangle(comm)
    facets = middle(mesh, 0, LENGTH)
    mesh.topology.create_connectivity(1, 2)
    x = compute_midpoints(mesh, 1, facets).T
    for given, expected in (
        (0.25, lambda x: 0.25 + 0 * x[0]),
        (x[0] / LENGTH, lambda x: (np.floor(2 * x[0]) + 0.5) / 2 / LENGTH),
        (cracked, cracked),
    ):
        interface = vmdg.Interface(facets, law=law(), initial_damage=given)
        state = beams(comm, [interface], mesh, tags).state[0]
        points, softening = by_position(comm, state.points, state.softening)
        assert len(softening) == 2 * 16
        np.testing.assert_allclose(softening, STRENGTH * expected(points.T), rtol=1e-12)


def test_body_that_only_a_crack_holds_is_warned_of(comm):
    mesh, tags = rectangle(comm)
    material = vmdg.NeoHookean(E=1e3, nu=0.3)
    crack = vmdg.Interface(between=(1, 2), law=law(), initial_damage=1.0)
    problem = vmdg.Problem(mesh, tags, {1: material, 2: material}, [crack], kinematics="small")
    problem.dirichlet(lambda x: np.isclose(x[1], -1), 0.0)
    problem.dirichlet(lambda x: np.isclose(x[1], 1), -0.01, "y")
    # warnings come from rank 0
    words = "only contact constrains the body"
    with pytest.warns(vmdg.ModelWarning, match=words) if comm.rank == 0 else nullcontext():
        vmdg.solve(problem, [1.0])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"law": vmdg.Bonded(), "initial_damage": 1.0}, "has no bond to damage"),
        ({"law": vmdg.Contact(), "initial_damage": 0.5}, "has no bond to damage"),
        ({"initial_damage": 1.5}, r"must lie in \[0, 1\]"),
        ({"initial_damage": np.nan}, r"must lie in \[0, 1\]"),
        ({"initial_damage": [0.5, 0.5]}, "one value for every facet of facets="),
    ],
)
def test_mistakes_are_told(options, words):
    with pytest.raises(ValueError, match=words):
        vmdg.Interface(**({"between": (1, 2), "law": law()} | options))


def test_function_that_gives_no_damage_is_told(comm):
    interface = vmdg.Interface(between=(1, 2), law=law(), initial_damage=lambda x: x[0])
    with pytest.raises(ValueError, match=r"initial_damage gives .* from 0 to 1"):
        beams(comm, [interface])
