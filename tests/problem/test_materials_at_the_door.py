"""Materials that a problem would not notice or that start with a stress, and values that vary."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
import ufl
from dolfinx import fem
from support.scenes import two_blocks

import vmdg


def problem(comm, material, **options) -> vmdg.Problem:
    scene = two_blocks(comm, "triangle", 2)
    steel = vmdg.NeoHookean(E=5000.0, nu=0.25)
    return vmdg.Problem(scene.mesh, scene.cell_tags, {1: steel, 2: material}, [], **options)


def stressed(F, p):
    """mu/2 tr(F^T.F) without the -mu ln J that takes its stress mu I at F = I away."""
    return p["mu"] / 2 * ufl.inner(F, F) + p["mu"] * (ufl.det(F) - 1) ** 2


def relaxed(F, p):
    return stressed(F, p) - p["mu"] * ufl.ln(ufl.det(F))


def root(F, p):
    """The length of a fibre by a root that has no derivative at F = I."""
    C = F.T * F
    return relaxed(F, p) + ufl.sqrt(C[0, 0] - 1) ** 3


MATERIALS = (
    vmdg.NeoHookean(E=1.0, nu=0.3),
    vmdg.Ogden(c=(1.0,), m=(2.0,), kappa=1.0),
    vmdg.Hyperelastic(relaxed, {"mu": 1.0}),
)


@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: type(m).__name__)
def test_parameters_do_not_change(material):
    """A value or all of them cannot be set anew; copies keep them."""
    name, before = next(iter(material.parameters)), dict(material.parameters)
    with pytest.raises(TypeError, match=f"'{name}' .* create a new material and a new Problem"):
        material.parameters[name] = 2.0
    with pytest.raises(
        AttributeError, match=r"set once, .* create a new material and a new Problem"
    ):
        material.parameters = {name: 2.0}
    assert material.parameters == before
    assert copy.deepcopy(material).parameters == before
    assert pickle.loads(pickle.dumps(material.parameters)) == before


@pytest.mark.parametrize("kinematics", ["finite", "small"])
def test_stress_at_rest(comm, kinematics):
    """An energy with a stress at F = I is refused on every rank, one without is not."""
    with pytest.raises(
        ValueError, match=r"tag 2 has the stress P = \[\[3.0, .* at F = I, .*-mu ln"
    ):
        problem(comm, vmdg.Hyperelastic(stressed, {"mu": 3.0}), kinematics=kinematics)
    problem(comm, vmdg.Hyperelastic(relaxed, {"mu": 3.0}), kinematics=kinematics)


def test_no_stress_at_rest(comm):
    """So is one that has no derivative there."""
    with pytest.raises(ValueError, match=r"the stress P = .*(nan|inf).* where it must vanish"):
        problem(comm, vmdg.Hyperelastic(root, {"mu": 3.0}))


@pytest.mark.parametrize("value", ["array", "function", "Constant", "Function"])
def test_values_that_vary(comm, value):
    """Moduli of Ogden's material are numbers; what varies says how it can be given."""
    mesh = two_blocks(comm, "triangle", 2).mesh
    given = {
        "array": np.ones(4),
        "function": lambda x: x[0],
        "Constant": fem.Constant(mesh, 1.0),
        "Function": fem.Function(fem.functionspace(mesh, ("DG", 0))),
    }[value]
    with pytest.raises(TypeError, match=r"must be one number; .* vmdg\.split_cells"):
        vmdg.Ogden(c=(1.0,), m=(2.0,), kappa=given)


@pytest.mark.parametrize(
    ("material", "message"),
    [
        (vmdg.NeoHookean(E=lambda x: x[0] - 9, nu=0.3), r"E = -7.\d+ must be positive and finite"),
        (vmdg.NeoHookean(E=1.0, nu=lambda x: x[0]), r"nu = 1\.\d+ must lie in"),
        (vmdg.NeoHookean(mu=1.0, lmbda=lambda x: -x[0]), r"lmbda = -1.\d+ must .* exceed"),
        (vmdg.NeoHookean(E=np.ones(3), nu=0.3), r"E: .* it has shape \(3,\)"),
        (vmdg.Hyperelastic(relaxed, {"mu": lambda x: np.nan * x[0]}), r"mu.*: not finite"),
    ],
)
def test_moduli_out_of_range(comm, material, message):
    """Found cell by cell, refused on every rank with the tag."""
    with pytest.raises(ValueError, match=f"(?s){message}"):
        problem(comm, material)
