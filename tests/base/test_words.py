"""Names that were meant, functions of one point, and what messages call an interface."""

from __future__ import annotations

import numpy as np
import pytest
from support.problems import couple
from support.scenes import two_blocks

import vmdg

LAW = vmdg.Debonding(strength=20.0, critical_gap=0.05)


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        ("rtol", "relative_tolerance"),
        ("relative_tol", "relative_tolerance"),
        ("max_iter", "max_iterations"),
        ("checkpoint_evry", "checkpoint_every"),
    ],
)
def test_options(wrong, meant):
    """By spelling, and by what PETSc and DOLFINx call them."""
    with pytest.raises(TypeError, match=f"SolveOptions: there is no {wrong}=. Did you .*'{meant}'"):
        vmdg.SolveOptions(**{wrong: 1})
    with pytest.raises(TypeError, match=r"there is no zzz=; it takes relative_tolerance, max_iter"):
        vmdg.SolveOptions(zzz=1)


@pytest.mark.parametrize(("wrong", "meant"), [("betwen", "between"), ("tag", "within")])
def test_interface(wrong, meant):
    """So does an interface."""
    with pytest.raises(TypeError, match=f"Interface: there is no {wrong}=. Did you mean '{meant}'"):
        vmdg.Interface(**{wrong: (1, 2)}, law=LAW)


def test_reading_a_mesh(comm):
    """So does the door of meshes, before the file is looked for."""
    with pytest.raises(TypeError, match=r"read_mesh: there is no mrge=\. Did you mean 'merge'"):
        vmdg.meshes.read_mesh(comm, "nowhere.msh", mrge=True)


def test_names_of_interfaces():
    """Short, whatever the law has; a repr says which side is 1."""
    law = vmdg.ExponentialDebonding(strength=lambda x: 1 + x[0], fracture_energy=lambda x: x[0])
    bond = vmdg.Interface(between=(2, 1), law=law, name="bond")
    assert str(bond) == "interface 'bond'"
    assert repr(bond).startswith(
        "Interface(between=(2, 1) <side 1: 1>, law=ExponentialDebonding(strength=<function>, "
        "fracture_energy=<function>, "
    )
    assert "<side 1: the lower tag>" in repr(vmdg.Interface(between=("a", "b"), law=law))
    facets = vmdg.Interface(np.arange(3), law=vmdg.Debonding(strength=np.ones(3), critical_gap=0.1))
    assert "facets=<3>, law=Debonding(strength=<3 values>," in repr(facets)


ONE_POINT = {
    "facets": lambda p, s: couple_at(s, facets=lambda x: np.isclose(x[0], 1) and x[1] < 1),
    "level set": lambda p, s: couple_at(s, level_set=lambda x: -1.0 if x[0] < 1 else 1.0),
    "dirichlet": lambda p, s: p.dirichlet(lambda x: 0 < x[0] < 1, 0.0),
    "dirichlet_points": lambda p, s: p.dirichlet_points(lambda x: not x[0] > 0, 0.0),
    "point_load": lambda p, s: p.point_load(lambda x: x[0] > 1 and x[1] < 1, 1.0, "x"),
    "traction": lambda p, s: p.traction(
        lambda x: np.isclose(x[0], 0), lambda x, t: (t if x[1] > 0 else 0.0, 0.0)
    ),
}


def couple_at(scene, **place) -> vmdg.Problem:
    """A problem with a bond at this place."""
    body = vmdg.NeoHookean(E=1e3, nu=0.3)
    bond = vmdg.Interface(law=LAW, **place)
    return vmdg.Problem(scene.mesh, scene.cell_tags, {1: body, 2: body}, [bond])


@pytest.mark.parametrize("what", ONE_POINT)
def test_functions_of_one_point(comm, what):
    """`and`, `if` and chains of < are answered by & and numpy.where, on every rank."""
    scene = two_blocks(comm, "quadrilateral", 4)
    with pytest.raises(ValueError, match=r"all points at once, .*\(0 < x\[0\]\) & \(x\[0\] "):
        ONE_POINT[what](couple(scene, LAW), scene)


@pytest.mark.parametrize("marks", [lambda x: True, lambda x: x[0]])
def test_predicates_that_are_none(comm, marks):
    """One truth value a point."""
    scene = two_blocks(comm, "quadrilateral", 2)
    with pytest.raises(ValueError, match=r"dirichlet: the predicate must return True or False for"):
        couple(scene, LAW).dirichlet(marks, 0.0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: vmdg.NeoHookean(1000.0, 0.3), r"by name, NeoHookean\(E=, nu="),
        (lambda: vmdg.NeoHookean(K=1000.0, G=300.0), r"NeoHookean: there is no K=: with the bulk"),
        (lambda: vmdg.Debonding(strenght=20.0), "there is no strenght=. Did you mean 'strength'"),
        (lambda: vmdg.meshes.pack(count="x", fraction=0.3), "pack: count = 'x' must be int"),
        (lambda: vmdg.History().append([1]), r"append: row = \[1\] must be Mapping"),
    ],
)
def test_calls(call, words):
    """What Python says of its own is said in words of the call."""
    with pytest.raises(TypeError, match=words):
        call()
